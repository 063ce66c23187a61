"""A report of all results of a folder as one self-contained page: no network access, other files or external fonts."""

import base64
import io
from html import escape
from pathlib import Path

from PIL import Image

from benchmarks.analysis.figures import drawings
from benchmarks.analysis.style import Drawing
from benchmarks.analysis.tables import sheets
from benchmarks.suite.store import read_rows, read_stamp
from limslam_agent.output.atomic_write import atomic_write

_COLOURS = 96  # of a figure, which is a third of the size without a visible difference
_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font: 1rem/1.5 system-ui, sans-serif; max-width: 80rem; margin: 0 auto; padding: 1rem; color: #1a1a1a; }}
div[role=region] {{ overflow-x: auto; }}
table {{ border-collapse: collapse; font-size: .85rem; white-space: nowrap; }}
caption {{ text-align: left; font-weight: bold; padding: .5rem 0; }}
th, td {{ padding: .2rem .6rem; border-bottom: 1px solid #ddd; text-align: left; }}
img {{ max-width: 100%; }}
figure {{ margin: 2rem 0; }}
</style>
</head>
<body>
<h1>{title}</h1>
<p>{about}</p>
<main>
{body}
</main>
</body>
</html>
"""


def report(folder: Path, out: Path) -> Path:
    """Write tables, figures and failures as one HTML file.

    Parameters
    ----------
    folder
        Of results.
    out
        The file, or a folder in which ``report.html`` is written.

    Returns
    -------
    Path
        The written file.

    Raises
    ------
    ValueError
        If there are no results, or a series is missing or damaged.
    """
    rows, stamp = read_rows(folder), read_stamp(folder)
    tables = "\n".join(sheet.html() for sheet in sheets(rows))
    figures = "\n".join(map(_figure, drawings(rows, folder)))
    versions = ", ".join(f"{name} {version}" for name, version in stamp.versions.items())
    about = f"{len(rows)} of {stamp.jobs} runs, commit {stamp.commit}; {versions}"
    title = escape(f"LimSLAM benchmark: {stamp.suite}")
    path = out if out.suffix.lower() in {".html", ".htm"} else out / "report.html"
    with atomic_write(path) as beside:
        page = _PAGE.format(title=title, about=escape(about), body=f"{tables}\n{figures}")
        beside.write_text(page, encoding="utf-8")
    return path


def _figure(drawing: Drawing) -> str:
    full, small = io.BytesIO(), io.BytesIO()
    drawing.figure.savefig(full, format="png", dpi=110, facecolor="white", metadata={"Software": None})
    with Image.open(full) as picture:
        picture.convert("RGB").quantize(_COLOURS).save(small, "PNG", optimize=True)
    source, title = base64.b64encode(small.getvalue()).decode("ascii"), escape(drawing.title)
    return f'<figure><img alt="{title}" src="data:image/png;base64,{source}"><figcaption>{title}</figcaption></figure>'
