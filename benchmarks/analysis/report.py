"""A report of all results of a folder as one self-contained page: no network access, other files or external fonts."""

import base64
import io
import json
import os
import platform
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from PIL import Image

from benchmarks.analysis.claims import Verdict, claims
from benchmarks.analysis.figure_style import Drawing, write_png
from benchmarks.analysis.plots import drawings
from benchmarks.analysis.sheets import render
from benchmarks.analysis.tables import cost_sheet, failure_sheet, number_sheets
from benchmarks.suite.store import Row, read_jobs
from limslam_agent.output.atomic_write import atomic_write
from limslam_agent.output.finished_run import part_of

_COLOURS = 96
_PIXELS = 96  # pixels per inch of a figure on the page
_KINDS = {
    "confirmed": ("confirmed", "\N{CHECK MARK}"),
    "partly": ("partly", "\N{ALMOST EQUAL TO}"),
    "undecided": ("undecided", "?"),
    "not confirmed": ("refuted", "\N{MULTIPLICATION X}"),
}


def report(folder: Path, out: Path) -> Path:
    """Write tables, figures, failures and the verdict on the paper's claims as one HTML file.

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
        If there are no rows, or a series is missing or damaged.
    """
    rows = read_jobs([folder])
    if not rows:
        raise ValueError(f"{folder}: no results: there is not one row to report")
    path = out if out.suffix.lower() in {".html", ".htm"} else out / "report.html"
    page = _page(rows, folder)
    with atomic_write(path) as beside:
        beside.write_text(page, encoding="utf-8")
    return path


def _page(rows: Sequence[Row], folder: Path) -> str:
    suite = _suite(folder)
    title = f"LimSLAM benchmark: {suite.get('suite', folder.name)}"
    sections = {
        "Summary": _summary(rows, suite),
        "Tables": "\n".join(render(sheet, "html") for sheet in number_sheets(rows)),
        "Figures": "\n".join(_figure(drawing) for drawing in drawings(rows, folder)) or "<p>Nothing to draw.</p>",
        "Claims of the paper": _claims(claims(rows, folder)),
        "Failures": _failures(rows),
        "How it was made": _making(rows, suite),
    }
    links = "".join(f'<li><a href="#{_anchor(name)}">{escape(name)}</a></li>' for name in sections)
    body = "\n".join(
        f'<section id="{_anchor(name)}"><h2>{escape(name)}</h2>\n{content}\n</section>'
        for name, content in sections.items()
    )
    here = Path(__file__)
    style, script = (here.with_name(f"page.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>
{style}</style>
</head>
<body>
<a class="skip" href="#summary">Skip to the results</a>
<header><h1>{escape(title)}</h1>
<p class="soft">SLAM with six beams, an extended Kalman filter and the Hough transform, measured again.</p>
<nav aria-label="Sections"><ul>{links}</ul></nav></header>
<main>
{body}
</main>
<footer class="soft">Medians with 95 % bootstrap intervals; failed runs are counted, never dropped.</footer>
<script>
{script}</script>
</body>
</html>
"""


def _suite(folder: Path) -> dict[str, Any]:
    """The content of ``suite.json``; empty if the file does not exist."""
    try:
        content = json.loads((folder / "suite.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _summary(rows: Sequence[Row], suite: dict[str, Any]) -> str:
    failed = sum(row.error is not None for row in rows)
    asked = suite.get("jobs")
    missing = asked - len(rows) if isinstance(asked, int) else 0
    spent = sum(row.cost.get("job_s", row.cost.get("wall_clock_s", 0.0)) for row in rows)
    tiles = [
        ("runs", str(len(rows)), False),
        ("failed", str(failed), failed > 0),
        ("not run yet", str(max(missing, 0)), missing > 0),
        ("worlds", str(len({row.world for row in rows})), False),
        ("seeds", str(len({row.seed for row in rows})), False),
        ("time of all runs", f"{spent / 60.0:.1f} min", False),
        ("commit", ", ".join(sorted({row.commit[:10] for row in rows})), False),
    ]
    cells = "".join(
        f"{'<div class=alarm>' if alarm else '<div>'}<dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>"
        for name, value, alarm in tiles
    )
    return f'<dl class="tiles">{cells}</dl>'


def _claims(verdicts: Sequence[Verdict]) -> str:
    counts = {outcome: sum(each.outcome == outcome for each in verdicts) for outcome in _KINDS}
    tried = sum(counts.values())
    words = ", ".join(f"{count} {outcome}" for outcome, count in counts.items() if count)
    items = "\n".join(_claim(each) for each in verdicts if each.outcome in _KINDS)
    untried = [each.claim for each in verdicts if each.outcome not in _KINDS]
    counted = f"{tried} were tried{': ' if words else ''}{words}"
    intro = (
        f"Of {len(verdicts)} claims {counted}. Judged on the rows of the published method. The paper gives no "
        "numbers: what counts as confirmed is our choice, and said beside each. Undecided: the 95 % interval holds "
        "both answers, and more runs would tell."
    )
    cards = f'\n<ul class="claims">\n{items}\n</ul>' if tried else ""
    return f"<p>{escape(intro)}</p>{cards}{_untried(untried)}"


def _untried(claims: Sequence[str]) -> str:
    """The claims that these rows do not test, in a collapsed section."""
    if not claims:
        return ""
    items = "".join(f"<li>{escape(claim)}</li>" for claim in claims)
    words = f"{len(claims)} claims were not tried in these rows" if len(claims) > 1 else "1 claim was not tried"
    return f'\n<details class="untried"><summary>{words}</summary><ul>{items}</ul></details>'


def _claim(verdict: Verdict) -> str:
    kind, mark = _KINDS.get(verdict.outcome, ("untried", "\N{EN DASH}"))
    return (
        f'<li class="{kind}"><p class="words">{escape(verdict.claim)}</p>'
        f'<p><span class="outcome"><span aria-hidden="true">{mark}</span> {escape(verdict.outcome)}</span> '
        f'<span class="soft">(section {escape(verdict.source)})</span></p>'
        f'<p class="evidence soft">{escape(verdict.evidence)}</p></li>'
    )


def _figure(drawing: Drawing) -> str:
    source = base64.b64encode(_small_png(drawing)).decode("ascii")
    title = escape(drawing.title)
    # The figure is shown at most at its original width, so that a narrow sheet is not enlarged.
    width = round(drawing.figure.get_figwidth() * _PIXELS)
    return (
        f'<figure><div class="picture" role="region" tabindex="0" aria-label="{title}">'
        f'<img style="max-width:{width}px;min-width:min(40rem,{width}px)" '
        f'alt="{escape(drawing.alt)}" src="data:image/png;base64,{source}"></div>'
        f"<figcaption>{title}</figcaption></figure>"
    )


def _small_png(drawing: Drawing) -> bytes:
    """A figure as PNG with a palette, a third of the size without a visible difference."""
    full, small = io.BytesIO(), io.BytesIO()
    write_png(drawing, full)
    with Image.open(full) as picture:
        picture.convert("RGB").quantize(_COLOURS).save(small, "PNG", optimize=True)
    return small.getvalue()


def _failures(rows: Sequence[Row]) -> str:
    sheet = failure_sheet(rows)
    return "<p>No run failed.</p>" if sheet is None else render(sheet, "html")


def _making(rows: Sequence[Row], suite: dict[str, Any]) -> str:
    names = dict.fromkeys(name for row in rows for name in row.versions)
    versions = {name: _all(row.versions.get(name) for row in rows) for name in names}
    made = {
        "suite": str(suite.get("suite", "unknown")),
        "digest of the suite": str(suite.get("digest", "unknown")),
        "commit": _all(row.commit for row in rows),
        "settings and worlds": f"{len({row.config for row in rows if row.config})} digests",
        **{f"machine: {name}": str(value) for name, value in part_of(suite, "machine").items()},
    }
    here = {"system": platform.platform(), "processors": str(os.cpu_count()), "Python": platform.python_version()}
    cost = cost_sheet(rows)
    return (
        f"{_facts(made)}<details open><summary>Versions that made the results</summary>{_facts(versions)}</details>"
        f"<details open><summary>Machine on which this page was made</summary>{_facts(here)}</details>"
        f"{'' if cost is None else render(cost, 'html')}"
    )


def _facts(facts: dict[str, str]) -> str:
    return (
        '<dl class="facts">'
        + "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in facts.items())
        + "</dl>"
    )


def _all(values: Iterable[str | None]) -> str:
    return ", ".join(sorted({value for value in values if value}))


def _anchor(name: str) -> str:
    return name.lower().replace(" ", "-")
