"""The tutorials as notebooks, made from pages of the documentation, which are installed, too."""

import json
import re
import shutil
from os import PathLike
from pathlib import Path
from typing import Any

HEADER = "---\nfile_format: mystnb\n"
"""With this a page begins that is a notebook."""

INSTALL = """from importlib.util import find_spec

if find_spec("limslam_agent") is None:  # as in Colab: pip install limslam
    get_ipython().run_line_magic("pip", "install limslam")"""
"""The first cell of each notebook."""

_CELL = re.compile(r"^```\{code-cell\}[^\n]*\n(?::[^\n]*\n)*(.*?)^```$", re.DOTALL | re.MULTILINE)
_PICTURE = re.compile(r"^!\[[^\]]*\]\([^)]*\)\n+", re.MULTILINE)
_LINK = re.compile(r"\[([^\[\]]*)\]\(([^)\s]+)\)")
_FORMULA = re.compile(r"^```math\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def folder_of_pages() -> Path:
    """Where the pages lie: inside of the installed package, or in the documentation of a
    checkout.
    """
    inside = Path(__file__).parent / "pages"
    return inside if inside.is_dir() else Path(__file__).parents[1] / "docs"


def notebook_pages() -> list[Path]:
    """The pages that are notebooks."""
    pages = sorted(folder_of_pages().rglob("*.md"))
    return [page for page in pages if page.read_text(encoding="utf-8").startswith(HEADER)]


def notebook_of(page: Path) -> dict[str, Any]:
    """The content of the notebook of a page, in Jupyter's format 4.5."""
    body = page.read_text(encoding="utf-8").split("---\n", 2)[2]
    cells = [("code", INSTALL)]
    notebooks = {path.resolve() for path in notebook_pages()}
    for number, part in enumerate(_CELL.split(body)):
        text = part.strip("\n") if number % 2 else _prose(part, page, notebooks).strip()
        if text:
            cells.append(("code" if number % 2 else "markdown", text))
    return {
        "nbformat": 4,
        "nbformat_minor": 5,
        "metadata": {
            "kernelspec": {"name": "python3", "language": "python", "display_name": "Python 3"},
            "language_info": {"name": "python"},
        },
        "cells": [_cell(kind, f"cell-{number}", text) for number, (kind, text) in enumerate(cells)],
    }


def _cell(kind: str, name: str, text: str) -> dict[str, Any]:
    cell = {"cell_type": kind, "id": name, "metadata": {}, "source": text}
    return cell | ({"execution_count": None, "outputs": []} if kind == "code" else {})


def _prose(text: str, page: Path, notebooks: set[Path]) -> str:
    """Text of a page as Jupyter shows it: without pictures, and with links to notebooks only."""

    def linked(link: re.Match[str]) -> str:
        target = link[2].partition("#")[0]
        if "://" in target:
            return link[0]
        is_notebook = target and (page.parent / target).resolve() in notebooks
        return f"[{link[1]}]({Path(target).stem}.ipynb)" if is_notebook else link[1]

    return _FORMULA.sub(r"$$\n\1$$", _LINK.sub(linked, _PICTURE.sub("", text)))


def write_notebooks(folder: str | PathLike[str], *, force: bool = False) -> list[Path]:
    """Write all notebooks into a folder. Raises a ValueError if one is there and is not to be
    replaced.
    """
    target = Path(folder)
    files = {target / f"{page.stem}.ipynb": notebook_of(page) for page in notebook_pages()}
    there = next((path for path in files if path.exists()), None)
    if there is not None and not force:
        raise ValueError(f"{there}: is there already; --force replaces it")
    target.mkdir(parents=True, exist_ok=True)
    for path, content in files.items():
        path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return list(files)


def write_drives(folder: str | PathLike[str] = "drives") -> None:
    """Write the recorded drives that ship: ``env1`` and ``square``, each with ``log.npz`` and the
    ``world.toml`` in which it was driven.

    Parameters
    ----------
    folder
        Where they go.

    Examples
    --------
    >>> import tempfile
    >>> from limslam_agent import read_log, write_drives
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_drives(folder)
    ...     log = read_log(f"{folder}/env1/log.npz")
    >>> log.ranges.shape[1]
    6
    """
    shutil.copytree(folder_of_pages() / "drives", folder, dirs_exist_ok=True)
