"""Two logs of wheel travel as one run of the line smoother, in which a second robot starts at an unknown place."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from limslam_agent.places.localisation import KnownPlaces
from limslam_agent.replay.replay import Replay
from limslam_agent.slam.core.diagnostics import AssociationRecord
from limslam_agent.slam.graph.smooth import Report
from limslam_agent.slam.line_graph.smoother import FilteredRun, SmoothedRun, smooth_run
from limslam_agent.status.smoothed_status import smoothed_status
from limslam_agent.status.status import LEVELS, Status
from limslam_agent.two_logs.joint import JointReplay, Replays, frame_of, grid_of
from limslam_agent.two_logs.place import place_in, sensor_of
from limslam_env.geometry import FloatArray, se2

_ROCKING = 0.01
"""Wheel travel to and fro of a robot that waits, m: wheels that stand still for minutes make the equations singular."""

_FURTHEST = 0.4, np.radians(10.0)
"""The smoothed start of the second log, and the path of each log, differ by at most this from the match, m and rad."""


def joined_by_lines(replays: Replays, frame: FloatArray, report: Report) -> JointReplay | str:
    """Smooth two logs as one run, with the frame of the second one at about a pose (3,); or why they do not fit.

    The joining is taken back if the result is not ``ok``, if the place or a path moves far, or if the second log also
    fits in the shared map at a second place.
    """
    settings = replays[0].config.run_smoothing
    assert settings is not None  # noqa: S101 (the caller has looked)
    report("both logs, all poses and walls")
    run = joined_run([_run_of(each) for each in replays], frame)
    smoothed = smooth_run(run, settings)
    if smoothed is None:
        return "the logs could not be smoothed together"
    poses = _own_steps(smoothed, replays)
    found = frame_of(replays[1], poses[1])
    moved = max(
        _shift(smoothed.poses[: len(each.log), number], run.poses[:, number]) for number, each in enumerate(replays)
    )
    off, status = se2.between(frame, found), _status_of(run, smoothed, replays)
    if float(np.hypot(*off[:2])) > _FURTHEST[0] or abs(float(off[2])) > _FURTHEST[1]:
        return "the readings lead away from the matched place"
    if moved > _FURTHEST[0]:
        return f"smoothing both logs together moves the path of one of them by {moved:.2f} m"
    if status.level != "ok":
        return status.reason
    grid = grid_of(replays, poses, smoothed.robot)
    again = place_in(KnownPlaces(smoothed.segments, grid, sensor_of(replays[0])), replays[1], poses[1])
    if again.refusal:
        return again.refusal
    doubts = (each.places.doubt for each in replays)
    return JointReplay(
        replays, poses, smoothed.landmarks, smoothed.segments, grid,
        next((doubt for doubt in doubts if doubt.reason), status), {},
        {"smoothed_contradictions": smoothed.contradictions},
    )  # fmt: skip


def _status_of(run: FilteredRun, smoothed: SmoothedRun, replays: Replays) -> Status:
    """Whether both logs as one run can be trusted, by the poses before and after they were smoothed together."""
    counts = [len(each.log) for each in replays]
    filtered, found = (
        (_held(poses, counts)[1:], _held(covariances, counts)[1:])
        for poses, covariances in ((run.poses, run.covariances), (smoothed.poses, smoothed.covariances))
    )
    while_driving = LEVELS[int(max(each.levels.max() for each in replays))]
    return smoothed_status(smoothed.contradictions, filtered, found, while_driving=while_driving)


def _shift(poses: FloatArray, alone: FloatArray) -> float:
    """Distance of a log's path (n, 3) from its path alone (m, 3), m >= n, at the matched place: root mean square, m."""
    off = poses[:, :2] - alone[: len(poses), :2]
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def _run_of(replay: Replay) -> FilteredRun:
    """The run that a log was smoothed from, with its smoothed poses."""
    smoothed = replay.smoothed
    assert smoothed is not None and isinstance(smoothed.basis, FilteredRun)  # noqa: PT018, S101 (the caller has looked)
    return replace(smoothed.basis, poses=smoothed.poses[: len(smoothed.basis.poses), None])


def joined_run(runs: Sequence[FilteredRun], frame: FloatArray) -> FilteredRun:
    """Two runs of one robot as a run of two robots. The start of the second one is unknown.

    The shorter run waits at its end, without readings. ``frame`` (3,) is the pose of the second run's frame in that of
    the first run.
    """
    first, second = runs
    second = replace(
        second,
        poses=se2.compose(frame, second.poses),
        covariances=se2.turned(second.covariances, float(frame[2])),
    )
    steps = max(len(each.poses) for each in runs)
    columns: dict[str, Any] = {
        name: np.concatenate([_padded(getattr(each, name), steps, fill) for each in (first, second)], axis=1)
        for name, fill in (("wheels", 0), ("ranges", np.nan), ("usable", False), ("poses", None), ("covariances", None))
    }
    columns["usable"][0, 1] = False
    for number, each in enumerate((first, second)):
        waiting = columns["wheels"][len(each.poses) :, number]
        waiting[:] = _ROCKING * (-1.0) ** np.arange(len(waiting))[:, None]
    apart = 1 + max((record.landmark for record in first.associations), default=-1)
    others = [
        AssociationRecord(record.landmark + apart, record.is_new, record.readings, 1) for record in second.associations
    ]
    closures = [replace(each, older=each.older + apart, younger=each.younger + apart) for each in second.closures]
    breaks = (*first.breaks, *((1, step) for _, step in second.breaks), (1, 1))
    longer = max(runs, key=lambda each: len(each.poses))  # its readings say more about the sensor
    return FilteredRun(
        robot=first.robot, noise=first.noise, associations=[*first.associations, *others],
        closures=[*first.closures, *closures], breaks=breaks, sensor=longer.sensor, **columns,
    )  # fmt: skip


def _padded(rows: FloatArray, steps: int, fill: float | None) -> FloatArray:
    """Rows (t, 1, ...) with more rows at the end, up to a number of steps: of a value, or of the last row."""
    more = np.repeat(rows[-1:], steps - len(rows), axis=0)
    return np.concatenate((rows, more if fill is None else np.full_like(more, fill)))


def _held(rows: FloatArray, counts: Sequence[int]) -> FloatArray:
    """Rows (t, 2, ...) of two robots, in which the waiting of the shorter log repeats its last own row."""
    held = rows.copy()
    for number, count in enumerate(counts):
        held[count:, number] = rows[count - 1, number]
    return held


def _own_steps(smoothed: SmoothedRun, replays: Replays) -> tuple[FloatArray, FloatArray]:
    """The smoothed poses of each log. The first pose of the second log follows from its second pose."""
    one, other = (smoothed.poses[: len(each.log), number].copy() for number, each in enumerate(replays))
    alone = replays[1].smoothed
    if alone is not None and len(other) > 1:
        other[0] = se2.compose(other[1], se2.between(alone.poses[1], alone.poses[0]))
    return one, other
