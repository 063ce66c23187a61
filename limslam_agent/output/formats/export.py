"""Exports a finished run: all files of a call appear together, or none does."""

import shutil
import tempfile
from collections.abc import Collection
from enum import StrEnum
from pathlib import Path

from limslam_agent.output.formats.content import read_exported
from limslam_agent.output.formats.csv_tables import write_csv
from limslam_agent.output.formats.dxf import write_dxf
from limslam_agent.output.formats.geojson import write_geojson
from limslam_agent.output.formats.rerun_recording import write_rerun
from limslam_agent.output.formats.ros_bag import write_bag, write_mcap


class Format(StrEnum):
    """A format of other programs."""

    CSV = "csv"
    GEOJSON = "geojson"
    DXF = "dxf"
    BAG = "bag"
    MCAP = "mcap"
    RERUN = "rerun"


def export_run(
    folder: Path,
    target: Path,
    formats: Collection[Format],
    origin: tuple[float, float] | None = None,
    *,
    force: bool = False,
) -> list[Path]:
    """Write a finished run in some formats and return what was written.

    Parameters
    ----------
    folder
        Folder of the run.
    target
        Folder for the files; it is made if it is missing.
    formats
        The formats.
    origin
        Latitude and longitude, deg, of the point (0, 0), for GeoJSON.
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
        place, made = Path(beside), []
        for name, write in (
            (Format.CSV, write_csv), (Format.DXF, write_dxf), (Format.BAG, write_bag), (Format.MCAP, write_mcap),
            (Format.RERUN, write_rerun),
        ):  # fmt: skip
            if name in formats:
                made += write(place, exported)
        if Format.GEOJSON in formats:
            made += write_geojson(place, exported, origin)
        finals = [target / path.name for path in made]
        in_the_way = [path for path in finals if path.exists()]
        if in_the_way and not force:
            raise ValueError(f"{in_the_way[0]}: already exists; --force replaces it")
        for path in in_the_way:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        for path, final in zip(made, finals, strict=True):
            path.replace(final)
    return finals
