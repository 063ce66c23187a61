"""Two logs are replayed each by itself, and then both become one map if they fit together at one
place only.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.places.localisation import KnownPlaces
from limslam_agent.replay.record import Replay
from limslam_agent.replay.replay import replay_log
from limslam_agent.replay.smoothing import draw_grid
from limslam_agent.slam.line_graph.run import FilteredRun, beside
from limslam_agent.slam.line_graph.smoother import smooth_with_unknown_start
from limslam_agent.slam.map_graph.stages import Report, saying
from limslam_agent.status.known_map import MATCH_COVARIANCE
from limslam_agent.status.status import Status, smoothed_status
from limslam_agent.two_logs.by_graph import joined_by_graph
from limslam_agent.two_logs.joint import JointReplay, Replays, frame_of
from limslam_agent.two_logs.place import place_in, sensor_of
from limslam_env.geometry import FloatArray, se2

_FURTHEST = 0.4, np.radians(10.0)
"""The smoothed start of the second log, and the path of each log, differ by at most this from the
match, m and rad.
"""


def check_logs(logs: Sequence[RecordedLog], config: AgentConfig) -> None:
    """Refuse logs that cannot be joined.

    Raises
    ------
    ValueError
        If there are not two of them, they hold different kinds of odometry, or the settings do not
        smooth logs.
    """
    if len(logs) != 2:
        raise ValueError(f"{len(logs)} logs: one log is replayed, or two logs are joined")
    first, second = logs
    if (first.wheels is None) != (second.wheels is None):
        raise ValueError(
            "one log has wheel travel and the other one odometry poses: both logs must have the "
            "same"
        )
    if first.wheels is not None and first.robot != second.robot:
        raise ValueError("logs of wheel travel can be joined only if the same robot recorded both")
    smoothing = config.smoothing if first.wheels is None else config.run_smoothing
    if smoothing is None or not config.can_recover:
        raise ValueError(
            "two logs are joined by what is known at their end: this needs the preset graph"
        )


def replay_logs(
    logs: Sequence[RecordedLog],
    config: AgentConfig,
    progress: Callable[[int], None] | None = None,
    report: Report = lambda _: None,
) -> JointReplay:
    """Map from each of two logs by itself, and join the maps if they fit together at one place
    only.

    Parameters
    ----------
    logs
        Two logs, of one robot or two robots.
    config
        Settings; those of the preset ``graph``.
    progress
        Called after each event with the number of events of both logs that are done.
    report
        Called at the start of each stage of the smoothing with the stage in words.

    Raises
    ------
    ValueError
        If the logs cannot be joined.
    """
    check_logs(logs, config)
    first = replay_log(logs[0], config, progress, saying("log 1", report))
    after = None if progress is None else lambda done: progress(len(logs[0]) + done)
    second = replay_log(logs[1], config, after, saying("log 2", report))
    begin = time.process_time()
    joint = joined((first, second), report)
    return replace(joint, seconds=time.process_time() - begin)


def joined(replays: Replays, report: Report) -> JointReplay:
    """Join two replayed logs if their maps fit together at one place only."""
    first, second = replays
    if first.smoothed is None or second.smoothed is None:
        return _apart(replays, "one of the logs could not be smoothed")
    if any(each.places.unplaced is not None for each in replays):
        return _apart(replays, "the robot of one log was lost at its end")
    report("both logs, the place of the second one")
    place = place_in(
        KnownPlaces(first.segments, first.grid, sensor_of(first)), second, second.smoothed.poses
    )
    match = {"match": place.record}
    if place.fit is None or place.refusal:
        return _apart(replays, place.refusal, match)
    found = (joined_by_lines if first.log.odometry is None else joined_by_graph)(
        replays, place.fit.pose, report
    )
    if isinstance(found, str):
        return _apart(replays, f"joined and taken back: {found}", match)
    told = {
        "event": "joined",
        "reason": "the readings fit in one place only",
        "start": found.poses[1][0].tolist(),
    }
    return replace(found, record={**told, **match, **found.record})


def _apart(replays: Replays, reason: str, match: dict[str, Any] | None = None) -> JointReplay:
    """Two logs that were not joined. The files of the first log's map are those of the result."""
    first = replays[0]
    one, other = (
        each.estimated if each.smoothed is None else each.smoothed.poses for each in replays
    )
    status = Status("unsure", f"the logs were not joined: {reason}")
    record = {"event": "not joined", "reason": reason, **(match or {})}
    return JointReplay(
        replays, (one, other), first.landmarks, first.segments, first.grid, status, record
    )


def joined_by_lines(replays: Replays, frame: FloatArray, report: Report) -> JointReplay | str:
    """Smooth two logs as one run, with the frame of the second one at about a pose (3,); or why
    they do not fit.

    The joining is taken back if the result is not ``ok``, if the place or a path moves far, or if
    the second log also fits in the shared map at a second place.
    """
    settings = replays[0].config.run_smoothing
    assert settings is not None  # noqa: S101 (the caller has looked)
    report("both logs, all poses and walls")
    second = _run_of(replays[1])
    second = replace(second, covariances=second.covariances + MATCH_COVARIANCE)
    run = beside(_run_of(replays[0]), second, frame)
    smoothed = smooth_with_unknown_start(run, settings)
    if smoothed is None:
        return "the logs could not be smoothed together"
    one, other = (len(each.log) for each in replays)
    poses = smoothed.poses[:one, 0], smoothed.poses[:other, 1]
    shifts = np.hypot(*(smoothed.poses - run.poses)[..., :2].T)
    moved = max(float(np.sqrt((part**2).mean())) for part in (shifts[0, :one], shifts[1, :other]))
    off = se2.between(frame, frame_of(replays[1], poses[1]))
    if float(np.hypot(*off[:2])) > _FURTHEST[0] or abs(float(off[2])) > _FURTHEST[1]:
        return "the readings lead away from the matched place"
    if moved > _FURTHEST[0]:
        return f"smoothing both logs together moves the path of one of them by {moved:.2f} m"
    status = smoothed_status(smoothed.contradictions, smoothed.covariances)
    if status.level != "ok":
        return status.reason
    grid = draw_grid(replays, poses, smoothed.robot, smoothed.ranges)
    again = place_in(
        KnownPlaces(smoothed.segments, grid, sensor_of(replays[0])), replays[1], poses[1]
    )
    if again.refusal:
        return again.refusal
    doubts = (each.places.doubt for each in replays)
    return JointReplay(
        replays,
        poses,
        smoothed.landmarks,
        smoothed.segments,
        grid,
        next((doubt for doubt in doubts if doubt.reason), status),
        {},
        {"smoothed_contradictions": smoothed.contradictions},
    )


def _run_of(replay: Replay) -> FilteredRun:
    """The run that a log was smoothed from, with its smoothed poses."""
    smoothed = replay.smoothed
    assert smoothed is not None and isinstance(smoothed.basis, FilteredRun)  # noqa: PT018, S101 (the caller has looked)
    return replace(smoothed.basis, poses=smoothed.poses[: len(smoothed.basis.poses), None])
