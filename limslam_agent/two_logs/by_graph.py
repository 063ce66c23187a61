"""Two logs of odometry poses as one graph of local maps: two chains of key poses, with an unknown
step between them.

Distances driven tell visits of a place apart. Those of the second log therefore begin far beyond
those of the first one, and every match between the logs is a loop like every other.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.replay.record import Replay
from limslam_agent.replay.smoothing import draw_grid, draw_walls, ends_of, loop_records
from limslam_agent.replay.trust import path_signals
from limslam_agent.slam.map_graph.agreement import visit_counts
from limslam_agent.slam.map_graph.chunk_graph import KEPT
from limslam_agent.slam.map_graph.key_poses import (
    APART,
    ERRORS,
    KeyPoses,
    LogData,
    Trajectory,
    choose_keys,
    corrected,
    event_poses,
    odometry_trajectory,
)
from limslam_agent.slam.map_graph.point_links import point_cloud
from limslam_agent.slam.map_graph.smoothing import smooth_locally
from limslam_agent.slam.map_graph.stages import (
    GraphResult,
    LogProblem,
    Report,
    saying,
    smooth_with_loops,
)
from limslam_agent.two_logs.joint import JointReplay, Replays
from limslam_env.geometry import BoolArray, FloatArray, se2

_SEAM_STD = np.array([30.0, 30.0, np.pi])
"""Standard deviations of the motion from the last pose of the first log to the first pose of the
second log, m and rad.

Only loops hold the second log. A smaller value bends its beginning where the place that was found
is wrong there.
"""
_LEAST_LOOPS = 3  # between the logs
_MOST_CONTRADICTED = (
    0.2  # share of the points of one log that the other one contradicts, of those that it has seen
)


@dataclass(frozen=True, eq=False)
class _Chain:
    """A log with its odometry corrected for the errors that were found, and its paths without and
    with loops.
    """

    data: LogData
    keys: KeyPoses
    local: Trajectory
    smoothed: Trajectory

    @classmethod
    def of(cls, replay: Replay, config: GraphConfig) -> "_Chain":
        """The chain of a smoothed log. Both paths begin at the same pose."""
        smoothed = replay.smoothed
        assert smoothed is not None  # noqa: S101 (the caller has looked)
        assert isinstance(smoothed.basis, GraphResult) and smoothed.data is not None  # noqa: PT018, S101
        data = corrected(smoothed.data, smoothed.basis.errors)
        keys = choose_keys(data, config.keys)
        poses = smoothed.poses[keys.first_event]
        local = smooth_locally(keys, odometry_trajectory(keys, poses[0]), config, data.range_std)
        return cls(data, keys, local, Trajectory(poses, np.zeros(ERRORS)))


def joined_by_graph(replays: Replays, frame: FloatArray, report: Report) -> JointReplay | str:
    """Smooth two logs as one graph, with the frame of the second one at about a pose (3,); or why
    they do not fit.

    The joining is taken back if few loops between the logs are left, or one of them looks through
    walls of the other.
    """
    config = replays[0].config.smoothing
    assert config is not None  # noqa: S101 (the caller has looked)
    first, second = (_Chain.of(each, config) for each in replays)
    joint = smooth_with_loops(*_problem(first, second, frame, config), saying("both logs", report))
    keys = joint.keys
    path = joint.trajectory
    seam = len(first.keys)
    std, reach = (
        max(getattr(each.data, name) for each in (first, second))
        for name in ("range_std", "max_range")
    )
    is_second = joint.chunk_keys >= seam
    between = [each for each in joint.loops if is_second[each.first] != is_second[each.second]]
    visits = visit_counts(keys, path, config, reach, seam)
    confirmed = int(visits.confirmed.sum())
    contradicted = int(visits.contradicted.sum())
    record = {
        "loops_between": sum(each.reason == KEPT for each in between),
        "loops_between_found": len(between),
        "confirmed_points": confirmed,
        "contradicted_points": contradicted,
    }
    share = contradicted / max(confirmed + contradicted, 1)
    if record["loops_between"] < _LEAST_LOOPS:
        return f"only {record['loops_between']} loops between the logs are left"
    if share > _MOST_CONTRADICTED:
        return f"one log looks through {share:.0%} of the walls that the other log has seen"
    paths = (
        event_poses(first.keys, Trajectory(path.poses[:seam], path.bias)),
        event_poses(second.keys, Trajectory(path.poses[seam:], path.bias)),
    )
    landmarks = draw_walls(point_cloud(keys, path, std), std)
    since = np.concatenate([each.data.time - each.data.time[0] for each in (first, second)])
    signals = path_signals(joint, since, config, (reach, std), seam=seam)
    return JointReplay(
        replays,
        paths,
        landmarks,
        ends_of(landmarks),
        draw_grid(replays, paths),
        signals.status,
        record,
        signals.figures,
        _loops(joint, replays, is_second),
    )


def _problem(
    first: _Chain, second: _Chain, frame: FloatArray, config: GraphConfig
) -> tuple[LogProblem, Trajectory]:
    """Both logs as one problem, and the trajectory that begins with their smoothed ones."""
    data = replace(
        first.data,
        max_range=max(first.data.max_range, second.data.max_range),
        range_std=max(first.data.range_std, second.data.range_std),
    )
    smoothed = second.smoothed.moved(frame)
    seam = se2.between(first.smoothed.poses[-1], smoothed.poses[0])
    # Between the paths without loops lies the motion of the smoothed paths.
    start = se2.compose(first.local.poses[-1], seam)
    local = second.local.moved(se2.compose(start, se2.inverse(second.local.poses[0])))
    problem = LogProblem(
        _keys(first.keys, second.keys, seam), _both(first.local, local), data, config
    )
    return problem, _both(first.smoothed, smoothed)


def _both(first: Trajectory, second: Trajectory) -> Trajectory:
    """One path after the other. Their odometry has no constant errors that are known."""
    return Trajectory(np.vstack((first.poses, second.poses)), np.zeros(ERRORS))


def _keys(first: KeyPoses, second: KeyPoses, seam: FloatArray) -> KeyPoses:
    """The key poses of both logs, with a motion (3,) between them."""
    step = {
        "step": seam,
        "step_forward": 0.0,
        "step_variances": _SEAM_STD**2,
        "step_rate": np.zeros(3),
    }
    events = len(first.event_key)
    keys = len(first)
    travel = first.travel[-1] + APART
    later = {
        "event_key": keys,
        "first_event": events,
        "travel": travel,
        "point_event": events,
        "point_key": keys,
        "point_travel": travel,
    }
    columns = {}
    for name in (field.name for field in fields(KeyPoses)):
        one = getattr(first, name)
        other = getattr(second, name) + later.get(name, 0)
        columns[name] = np.concatenate(
            (one, *([np.asarray(step[name])[None]] if name in step else []), other)
        )
    return KeyPoses(**columns)


def _loops(joint: GraphResult, replays: Replays, is_second: BoolArray) -> list[dict[str, Any]]:
    """All loops of both logs, with the log of each of their ends."""
    records = loop_records(joint, np.concatenate([each.log.time for each in replays]))
    return [
        {
            "first_log": int(is_second[each.first]),
            "second_log": int(is_second[each.second]),
            **record,
        }
        for each, record in zip(joint.loops, records, strict=True)
    ]
