"""Two logs of odometry poses as one log, between which odometry does not tell the motion.

Distances driven tell visits of a place apart. Those of the second log therefore begin far beyond
those of the first one, and every match between the logs is a loop like every other.
"""

from typing import Any

import numpy as np
from scipy.linalg import block_diag

from limslam_agent.replay.record import Replay
from limslam_agent.replay.smoothing import draw_grid, draw_walls, ends_of, loop_records
from limslam_agent.replay.trust import path_signals
from limslam_agent.slam.map_graph.agreement import visit_counts
from limslam_agent.slam.map_graph.key_poses import (
    ERRORS,
    LogData,
    Trajectory,
    choose_keys,
    corrected,
    odometry_trajectory,
)
from limslam_agent.slam.map_graph.loops import KEPT
from limslam_agent.slam.map_graph.point_links import point_cloud
from limslam_agent.slam.map_graph.smoothing import smooth_locally
from limslam_agent.slam.map_graph.stages import (
    GraphResult,
    Report,
    hop_covariances,
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
_PAUSE = 1000.0  # s, between the logs
_LEAST_LOOPS = 3  # between the logs
_MOST_CONTRADICTED = (
    0.2  # share of the points of one log that the other one contradicts, of those that it has seen
)


def joined_by_graph(replays: Replays, frame: FloatArray, report: Report) -> JointReplay | str:
    """Smooth two logs as one graph, with the frame of the second one at about a pose (3,); or why
    they do not fit.

    The joining is taken back if few loops between the logs are left, or one of them looks through
    walls of the other.
    """
    config = replays[0].config.smoothing
    assert config is not None  # noqa: S101 (the caller has looked)
    (one, first), (other, second) = (_smoothed(each) for each in replays)
    second = se2.compose(frame, second)
    data = _one_log(one, other, se2.between(first[-1], second[0]))
    keys = choose_keys(data, config)
    local = smooth_locally(keys, odometry_trajectory(keys, first[0]))
    start = Trajectory(np.vstack((first, second))[keys.first_event], np.zeros(ERRORS))
    joint = smooth_with_loops(
        keys, hop_covariances(keys, local), start, saying("both logs", report)
    )
    seam = int(keys.event_key[len(first)])
    is_second = joint.chunk_keys >= seam
    between = [each for each in joint.loops if is_second[each.first] != is_second[each.second]]
    visits = visit_counts(keys, joint.trajectory, seam)
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
    poses = joint.poses
    paths = (poses[: len(first)], poses[len(first) :])
    landmarks = draw_walls(point_cloud(keys, joint.trajectory), data.range_std)
    since = np.concatenate([each.time - each.time[0] for each in (one, other)])
    signals = path_signals(joint, since, seam)
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


def _smoothed(replay: Replay) -> tuple[LogData, FloatArray]:
    """A smoothed log with its odometry corrected for the errors that were found, and its poses
    (n, 3).
    """
    smoothed = replay.smoothed
    assert smoothed is not None  # noqa: S101 (the caller has looked)
    assert isinstance(smoothed.basis, GraphResult) and smoothed.data is not None  # noqa: PT018, S101
    return corrected(smoothed.data, smoothed.basis.errors), smoothed.poses


def _one_log(first: LogData, second: LogData, seam: FloatArray) -> LogData:
    """Both logs as one, with a motion (3,) between them. Each beam belongs to one of the logs."""
    start = se2.compose(first.odometry[-1], seam)
    later = se2.compose(start, se2.between(second.odometry[0], second.odometry))
    begin = len(first.time)
    return LogData(
        time=np.append(first.time, second.time - second.time[0] + first.time[-1] + _PAUSE),
        odometry=np.vstack((first.odometry, later)),
        ranges=block_diag(first.ranges, second.ranges),
        hit=block_diag(first.hit, second.hit),
        origins=np.vstack((first.origins, second.origins)),
        angles=np.append(first.angles, second.angles),
        max_range=max(first.max_range, second.max_range),
        range_std=max(first.range_std, second.range_std),
        breaks=np.concatenate((first.breaks, [begin], second.breaks + begin)),
        break_stds=np.vstack((first.break_stds, _SEAM_STD, second.break_stds)),
    )


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
