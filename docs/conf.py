"""Settings of the documentation site: ``sphinx-build -W docs docs/_build``."""

import os
import re
import subprocess
import sys
import tempfile
from importlib.metadata import version as version_of
from importlib.util import find_spec
from pathlib import Path

import nbformat
from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx

from limslam_agent.notebooks import HEADER, write_notebooks

project = "LimSLAM"
author = "The LimSLAM authors"
project_copyright = "The LimSLAM authors"
release = version = version_of("limslam")

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["_build", "images/*.py", "paper"]
html_theme = "furo"
html_title = "LimSLAM"
# MathJax comes from an installed package and is part of the site, which needs no other host.
MATHJAX = Path(str(find_spec("sphinx-mathjax-offline").origin)).parent / "static/mathjax/tex-svg.js"
html_static_path = ["_static", str(MATHJAX)]
mathjax_path = MATHJAX.name
html_css_files = ["style.css"]
html_js_files = ["accessibility.js"]
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#1f5f99", "color-brand-content": "#1f5f99"},
    "dark_css_variables": {"color-brand-primary": "#7fb6e6", "color-brand-content": "#7fb6e6"},
}

# The pages are written for GitHub's Markdown as well, where a formula is a block of code named
# math.
myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 4

nb_execution_mode = "cache"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True

autosummary_generate = True
autodoc_typehints = "none"
autodoc_default_options = {"members": True, "show-inheritance": False}
# Members are listed by autodoc; numpydoc would list them a second time.
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

# Pages of the repository that lie outside of this folder, and the pages of the site that hold them.
PAGES_ELSEWHERE = {
    "benchmarks/RESULTS.md": "/compare/results.md",
    "CHANGELOG.md": "/reference/changelog.md",
    "CONTRIBUTING.md": "/reference/contributing.md",
    "README.md": "/index.md",
}
FOLDER = Path(__file__).parent
NOTEBOOKS = "notebooks"
OUTSIDE = "outside-of-the-site"
EXAMPLE = "inspector-example.html"


def rewrite_links(text: str, folder: Path) -> str:
    """The links of a text in ``folder`` as they are seen in the site."""

    def rewritten(match: re.Match[str]) -> str:
        target, _, anchor = match[1].partition("#")
        path = (folder / target).resolve()
        outside = (
            path.relative_to(FOLDER.parent).as_posix() if path.is_relative_to(FOLDER.parent) else ""
        )
        if not target or "://" in target or not path.exists():
            return match[0]
        if outside == "README.md":
            return "](/index.md)"  # the front page has other headings
        if outside in PAGES_ELSEWHERE:
            return f"]({PAGES_ELSEWHERE[outside]}{'#' * bool(anchor)}{anchor})"
        if path.is_relative_to(FOLDER) and path.suffix == ".md":
            return f"](/{path.relative_to(FOLDER).as_posix()}{'#' * bool(anchor)}{anchor})"
        is_page = path.suffix == ".md"
        if path.is_relative_to(FOLDER) or (outside and path.is_file() and not is_page):
            # A file outside of the site, such as an example, becomes a download.
            return f"](/{Path(os.path.relpath(path, FOLDER)).as_posix()})"
        return f"]({OUTSIDE})"

    text = re.sub(r"\]\(([^)\s]+)\)", rewritten, text)
    # Folders and other pages outside of the site are named and not linked.
    return re.sub(rf"\[([^\[\]]*)\]\({OUTSIDE}\)", r"\1", text)


def markdown_of_docstring(
    _app: Sphinx, _what: str, _name: str, _obj: object, _options: object, lines: list[str]
) -> None:
    """Change what is Markdown in a docstring, as in Gymnasium, to reStructuredText: headings,
    tables and code.
    """
    changed: list[str] = []
    inside = False
    for line in lines:
        # Code stands in single backquotes, unless they belong to a role or are two already.
        text = re.sub(r"(?<![:`])`([^`]+)`(?!`)", r"``\1``", line.strip())
        is_row = text.startswith("|") and text.endswith("|")
        indent = " " * (len(line) - len(line.lstrip()))
        if is_row and not inside:
            changed += ["", f"{indent}.. list-table::", f"{indent}   :header-rows: 1", ""]
        if is_row and not set(text) <= set("|-: "):
            cells = [cell.strip() for cell in text[1:-1].split("|")]
            changed += [
                f"{indent}   {'* -' if number == 0 else '  -'} {cell}"
                for number, cell in enumerate(cells)
            ]
        elif text.startswith("## "):
            changed += ["", f"{indent}.. rubric:: {text[3:]}", ""]
        elif not is_row:
            changed += [""] * inside + [indent + text]
        inside = is_row
    lines[:] = changed


def make_example(app: Sphinx, error: Exception | None) -> None:
    """Write the page of a short run that the pages for students link to, once for each folder of
    the site.
    """
    target = Path(app.outdir) / EXAMPLE
    if error is not None or app.builder.name != "html" or target.exists():
        return
    drive = (
        "--world",
        "env1",
        "--noise",
        "0.02",
        "--seed",
        "100",
        "--until",
        "seen",
        "--max-time",
        "120",
    )
    with tempfile.TemporaryDirectory() as place:
        run = Path(place) / "run"
        for arguments in (("run", *drive, "--out", run), ("inspect", run, "--out", target)):
            command = [sys.executable, "-m", "limslam_agent.cli.main", *arguments]
            subprocess.run(command, check=True, capture_output=True)  # noqa: S603 (the project's own command)


def with_download(text: str, name: str) -> str:
    """A page that is a notebook with a link to the notebook below its title."""
    if not text.startswith(HEADER):
        return text
    target = f"{name.count('/') * '../'}{NOTEBOOKS}/{name.rpartition('/')[2]}.ipynb"
    link = (
        f'<p class="notebook"><a href="{target}" download>Download this page as a notebook</a></p>'
    )
    return re.sub(
        r"^# .*$", lambda title: f"{title[0]}\n\n{link}", text, count=1, flags=re.MULTILINE
    )


def write_downloads(app: Sphinx, error: Exception | None) -> None:
    """Write the notebooks that users get into the site, and check that the site has executed all of
    their cells.
    """
    if error is not None or app.builder.name != "html":
        return
    executed = Path(app.outdir).parent / "jupyter_execute"
    for path in write_notebooks(Path(app.outdir) / NOTEBOOKS, force=True):
        notebook = nbformat.read(path, as_version=4)
        nbformat.validate(notebook)
        (done,) = executed.rglob(path.name)
        here, there = (
            [cell.source for cell in each.cells if cell.cell_type == "code"]
            for each in (notebook, nbformat.read(done, as_version=4))
        )
        if here[1:] != there:  # the first cell installs LimSLAM
            raise ValueError(f"{path.name} has other cells than the page that was executed")


def setup(app: Sphinx) -> None:
    """Connect what changes links, what makes the example of the inspector, and the notebooks."""

    def on_source(app: Sphinx, name: str, content: list[str]) -> None:
        content[0] = rewrite_links(content[0], Path(app.env.doc2path(name)).parent)
        content[0] = with_download(content[0], name)

    def on_include(_app: Sphinx, path: Path, _parent: str, content: list[str]) -> None:
        content[0] = rewrite_links(content[0], FOLDER / path.parent)

    app.connect("source-read", on_source)
    app.connect("include-read", on_include)
    app.connect("build-finished", make_example)
    app.connect("build-finished", write_downloads)
    app.connect("autodoc-process-docstring", markdown_of_docstring)
    app.add_lexer("csv", TextLexer)
