"""Two logs of wheel travel as one run of the line smoother, if the map of one fits in the map of the other."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from limslam_agent.grid.occupancy import GridView, OccupancyGrid
from limslam_agent.places.localisation import KnownPlaces, agree, localise
from limslam_agent.places.search import other_place
from limslam_agent.replay.replay import Replay
from limslam_agent.slam.core.diagnostics import AssociationRecord
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.line_graph.smoother import FilteredRun, SmoothedRun, smooth_run
from limslam_agent.status.rays import moved, rays_of
from limslam_agent.status.smoothed_status import smoothed_status
from limslam_agent.status.status import LEVELS, Status
from limslam_env.geometry import FloatArray, se2
from limslam_env.interface import RobotSpec

_ROCKING = 0.01
"""Wheel travel to and fro of a robot that waits, m: wheels that stand still for minutes make the equations singular."""

_FURTHEST = 0.4, np.radians(10.0)
"""The smoothed start of the second log, and the path of each log, differ by at most this from the match, m and rad."""


@dataclass(frozen=True, eq=False)
class NotJoined:
    """Why two logs are not joined, for ``result.json``."""

    record: dict[str, Any]


@dataclass(frozen=True, eq=False)
class JoinedLines:
    """Two logs of wheel travel that were joined.

    Attributes
    ----------
    smoothed
        Both logs as a run of two robots, of which the shorter one waits at its end.
    record
        The joining.
    poses
        Smoothed poses of all steps, (n, 3) and (m, 3), in the frame of the first log.
    frame
        Pose (3,) of the second log's frame in the frame of the first log.
    grid
        The occupancy grid of both logs.
    status
        Whether the smoothed paths and the map can be trusted.
    """

    smoothed: SmoothedRun
    record: dict[str, Any]
    poses: tuple[FloatArray, FloatArray]
    frame: FloatArray
    grid: GridView
    status: Status


def joined_by_lines(replays: tuple[Replay, Replay]) -> JoinedLines | NotJoined:
    """Match the maps of two logs, and smooth both logs as one run if one map fits in the other at one place only.

    The joining is taken back if the readings contradict the shared map, or if the map of one log fits in the shared map
    at a second place.
    """
    one = replays[0]
    settings = one.config.run_smoothing
    if not one.config.can_recover or settings is None:
        raise ValueError("two logs of wheel travel are joined by the preset graph only")
    runs = [_run_of(each) for each in replays]
    sensor = runs[0].sensor or RangeSensor(one.config.range_std)
    rays = _rays_of(runs[1])
    decision = localise(KnownPlaces(one.segments, one.grid, sensor), rays)
    if decision.fit is None or not agree(decision, decision):
        return _not_joined(decision.refusal or "too few readings fit in one place only", decision.record)
    matched = decision.fit.pose
    run = joined_run(runs, matched)
    smoothed = smooth_run(run, settings)
    if smoothed is None:
        return _not_joined("the logs could not be smoothed together", decision.record)
    poses = _own_steps(smoothed, replays)
    frame = se2.compose(poses[1][0], se2.inverse(replays[1].log.start_pose))
    grid = grid_of(replays, poses, smoothed.robot)
    status = _status_of(run, smoothed, replays)
    shift = max(
        _shift(smoothed.poses[: len(each.log), number], run.poses[:, number]) for number, each in enumerate(replays)
    )
    shared = KnownPlaces(smoothed.segments, grid, sensor)
    reason = _contradiction(status, frame, matched, shift) or other_place(shared, moved(rays, frame))
    if reason:
        return _not_joined(f"joined and taken back: {reason}", decision.record)
    if status.level == "ok":
        status = next((each.places.doubt for each in replays if each.places.doubt.reason), status)
    record = {**decision.record, "event": "joined", "start": poses[1][0].tolist()}
    return JoinedLines(smoothed, record, poses, frame, grid, status)


def _status_of(run: FilteredRun, smoothed: SmoothedRun, replays: Sequence[Replay]) -> Status:
    """Whether both logs as one run can be trusted, by the poses before and after they were smoothed together."""
    counts = [len(each.log) for each in replays]
    filtered, found = (
        (_held(poses, counts)[1:], _held(covariances, counts)[1:])
        for poses, covariances in ((run.poses, run.covariances), (smoothed.poses, smoothed.covariances))
    )
    while_driving = LEVELS[int(max(each.levels.max() for each in replays))]
    return smoothed_status(smoothed.contradictions, filtered, found, while_driving=while_driving)


def _not_joined(reason: str, match: dict[str, Any]) -> NotJoined:
    return NotJoined({"event": "not joined", "reason": reason, "match": match})


def _shift(poses: FloatArray, alone: FloatArray) -> float:
    """Distance of a log's path (n, 3) from its path alone (m, 3), m >= n, at the matched place: root mean square, m."""
    off = poses[:, :2] - alone[: len(poses), :2]
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def _contradiction(status: Status, frame: FloatArray, matched: FloatArray, shift: float) -> str:
    """Why a joining is wrong by what the readings of both logs say together; empty if it may be right."""
    off = se2.between(matched, frame)
    if float(np.hypot(*off[:2])) > _FURTHEST[0] or abs(float(off[2])) > _FURTHEST[1]:
        return "the readings lead away from the matched place"
    if shift > _FURTHEST[0]:
        return f"smoothing both logs together moves the path of one of them by {shift:.2f} m"
    return status.reason if status.level != "ok" else ""


class _Seen(NamedTuple):
    """Pose (3,) and readings (n_beams,) of a step. The latter are NaN where there is no new reading."""

    pose: FloatArray
    ranges: FloatArray


def _rays_of(run: FilteredRun) -> FloatArray:
    """The latest rays (n, 7) of a log, in its own smoothed frame."""
    ranges = np.where(run.usable, run.ranges, np.nan)[:, 0]
    return rays_of([_Seen(*each) for each in zip(run.poses[:, 0], ranges, strict=True)], run.robot, run.sensor)


def _run_of(replay: Replay) -> FilteredRun:
    """The run that a log was smoothed from, with its smoothed poses."""
    smoothed = replay.smoothed
    if smoothed is None or not isinstance(smoothed.basis, FilteredRun):
        raise ValueError("a log of wheel travel was not smoothed by the line smoother")
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


def _own_steps(smoothed: SmoothedRun, replays: tuple[Replay, Replay]) -> tuple[FloatArray, FloatArray]:
    """The smoothed poses of each log. The first pose of the second log follows from its second pose."""
    one, other = (smoothed.poses[: len(each.log), number].copy() for number, each in enumerate(replays))
    alone = replays[1].smoothed
    if alone is not None and len(other) > 1:
        other[0] = se2.compose(other[1], se2.between(alone.poses[1], alone.poses[0]))
    return one, other


def grid_of(replays: Sequence[Replay], poses: Sequence[FloatArray], robot: RobotSpec | None = None) -> GridView:
    """The occupancy grid of the readings of several logs from poses (n, 3) of each, by their own or another robot."""
    grid = OccupancyGrid(replays[0].config.grid)
    for replay, path in zip(replays, poses, strict=True):
        log = replay.log
        rows = np.flatnonzero(log.has_scan)
        ranges = log.ranges[rows].astype(np.float64)
        grid.draw(robot or log.robot, path[rows, None], ranges[:, None], np.isfinite(ranges)[:, None])
    return grid.view
