"""Exports a finished run: all files of a call appear together, or none does."""

import shutil
import tempfile
from collections.abc import Collection
from pathlib import Path

from limslam_agent.output.formats.content import read_exported
from limslam_agent.output.formats.csv_tables import write_csv
from limslam_agent.output.formats.dxf import write_dxf
from limslam_agent.output.formats.ros_bag import write_bag

FORMATS = {"csv": write_csv, "dxf": write_dxf, "bag": write_bag}
"""What writes each format."""


def export_run(folder: Path, target: Path, formats: Collection[str], *, force: bool = False) -> list[Path]:
    """Write a finished run in some formats and return what was written.

    Parameters
    ----------
    folder
        Folder of the run.
    target
        Folder for the files; it is made if it is missing.
    formats
        Names of formats, as in ``FORMATS``.
    force
        Replace files of the same names.

    Raises
    ------
    ValueError
        If the folder is not that of a run, a file exists, or a package that a format needs is not installed.
    """
    exported = read_exported(folder)
    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target, prefix=".export-") as beside:
        made = [path for name in formats for path in FORMATS[name](Path(beside), exported)]
        finals = [target / path.name for path in made]
        in_the_way = [path for path in finals if path.exists()]
        if in_the_way and not force:
            raise ValueError(f"{in_the_way[0]}: already exists; --force replaces it")
        for path in in_the_way:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        for path, final in zip(made, finals, strict=True):
            path.replace(final)
    return finals
