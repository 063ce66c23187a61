"""Writes a run as tables for spreadsheets and plotting programs."""

import math
from pathlib import Path

import numpy as np

from limslam_agent.output.formats.content import ExportedRun, Readings, suffix_of
from limslam_env.geometry import FloatArray


def write_csv(folder: Path, exported: ExportedRun) -> list[Path]:
    """Write ``trajectories.csv``, ``walls.csv`` and, where there are readings, ``log.csv``.

    Several robots have a table each. ``limslam replay log.csv --robot ...`` reads the table of readings.
    """
    run, robots = exported.run, len(exported.run.estimated)
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
    names, columns = ["t"], [run.time[:, None]]
    for kind, poses in exported.paths().items():
        names += [f"{kind}_{part}" for part in ("x", "y", "theta")]
        columns.append(poses[number])
    for kind, covariances in (("estimated", run.covariances), ("smoothed", run.smoothed_covariances)):
        if covariances:
            names += [f"{kind}_std_{part}" for part in ("x", "y", "theta")]
            columns.append(np.sqrt(np.maximum(np.diagonal(covariances[number], axis1=1, axis2=2), 0.0)))
    return names, np.hstack(columns)


def _log(time: FloatArray, readings: Readings, number: int) -> tuple[list[str], FloatArray]:
    beams = [f"r_{round(math.degrees(beam.angle), 6):g}" for beam in readings.robot.beams]
    return ["t", "left", "right", *beams], np.column_stack(
        (time, readings.wheels[:, number].astype(float), readings.ranges[:, number].astype(float))
    )


def _write(path: Path, names: list[str], table: FloatArray) -> None:
    # Nine digits tell any two float32 numbers apart.
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(names), comments="")
