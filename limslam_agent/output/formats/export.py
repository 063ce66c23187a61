"""Exports a finished run as tables, as a drawing for CAD programs, and as a bag: all files appear
together, or none.
"""

import math
import shutil
import tempfile
from collections.abc import Collection
from pathlib import Path

import numpy as np

from limslam_agent.output.formats.content import ExportedRun, Readings, read_exported
from limslam_agent.output.formats.ros_bag import write_bag
from limslam_agent.output.tum import suffix_of
from limslam_env.geometry import FloatArray

_COLOURS = {
    "walls": 1,
    "true": 8,
    "estimated": 5,
    "smoothed": 4,
    "odometry": 30,
}  # AutoCAD's colour index


def write_csv(folder: Path, exported: ExportedRun) -> list[Path]:
    """Write ``trajectories.csv``, ``walls.csv`` and, where there are readings, ``log.csv``.

    Several robots have a table each. ``limslam replay log.csv --robot ...`` reads the table of
    readings.
    """
    run = exported.run
    robots = len(exported.run.estimated)
    written = [folder / "walls.csv"]
    _write(written[0], ["x1", "y1", "x2", "y2"], run.segments)
    for number in range(robots):
        suffix = suffix_of(number, robots)
        written.append(folder / f"trajectories{suffix}.csv")
        _write(written[-1], *_poses(exported, number))
        if exported.readings is not None:
            written.append(folder / f"log{suffix}.csv")
            _write(written[-1], *_log(run.time, exported.readings, number))
    return written


def _poses(exported: ExportedRun, number: int) -> tuple[list[str], FloatArray]:
    run = exported.run
    names = ["t"]
    columns = [run.time[:, None]]
    for kind, poses in exported.paths().items():
        names += [f"{kind}_{part}" for part in ("x", "y", "theta")]
        columns.append(poses[number])
    for kind, covariances in (
        ("estimated", run.covariances),
        ("smoothed", run.smoothed_covariances),
    ):
        if covariances:
            names += [f"{kind}_std_{part}" for part in ("x", "y", "theta")]
            columns.append(
                np.sqrt(np.maximum(np.diagonal(covariances[number], axis1=1, axis2=2), 0.0))
            )
    return names, np.hstack(columns)


def _log(time: FloatArray, readings: Readings, number: int) -> tuple[list[str], FloatArray]:
    beams = [f"r_{round(math.degrees(beam.angle), 6):g}" for beam in readings.robot.beams]
    return ["t", "left", "right", *beams], np.column_stack(
        (time, readings.wheels[:, number].astype(float), readings.ranges[:, number].astype(float))
    )


def _write(path: Path, names: list[str], table: FloatArray) -> None:
    # Nine digits tell any two float32 numbers apart.
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(names), comments="")


def write_dxf(folder: Path, exported: ExportedRun) -> list[Path]:
    """Write ``map.dxf`` for CAD programs, in metres, with a layer for the walls and one for each
    path. Raises a ValueError if ezdxf is not installed.
    """
    try:
        from ezdxf import units
        from ezdxf.document import Drawing
    except ImportError as error:
        raise ValueError('a .dxf is written with ezdxf: pip install "limslam[export]"') from error
    drawing = Drawing.new("R2010")
    drawing.units = units.M
    space = drawing.modelspace()
    drawing.layers.add("walls", color=_COLOURS["walls"])
    for x1, y1, x2, y2 in exported.run.segments.tolist():
        space.add_line((x1, y1), (x2, y2), dxfattribs={"layer": "walls"})
    for kind, each in exported.paths().items():
        for number, poses in enumerate(each):
            layer = f"path_{kind}{suffix_of(number, len(each))}"
            drawing.layers.add(layer, color=_COLOURS[kind])
            space.add_lwpolyline(poses[:, :2].tolist(), dxfattribs={"layer": layer})
    path = folder / "map.dxf"
    drawing.saveas(path)
    return [path]


FORMATS = {"csv": write_csv, "dxf": write_dxf, "bag": write_bag}
"""What writes each format."""


def export_run(
    folder: Path, target: Path, formats: Collection[str], *, force: bool = False
) -> list[Path]:
    """Write a finished run into a target folder in some of the ``FORMATS``, and return what was
    written. Raises a ValueError if the folder is not that of a run, a file exists that ``force``
    does not replace, or a package that a format needs is not installed.
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
