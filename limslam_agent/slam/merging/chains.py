"""Two logs as one graph: two chains of key poses, of which the second begins at a pose that is hardly known.

Distances driven tell visits of a place apart. Those of the second log therefore begin far beyond those of the first
one, and every match between the logs is a match of two visits.
"""

from dataclasses import dataclass, replace

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.key_poses import (
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
from limslam_agent.slam.graph.local_smoothing import smooth_locally
from limslam_agent.slam.graph.smooth import GraphResult, LogProblem
from limslam_env.geometry import FloatArray, se2

_SEAM_STD = np.array([30.0, 30.0, np.pi])
"""Standard deviations of the motion from the last pose of the first log to the first pose of the second log, m and rad.

Only loops hold the second log. A smaller value bends its beginning where the first placement was wrong there.
"""


@dataclass(frozen=True, eq=False)
class Chain:
    """One log that was smoothed by itself, with its odometry corrected for the errors that were found.

    Attributes
    ----------
    data
        The log.
    keys
        Its key poses.
    local, smoothed
        Trajectories without and with loops. They begin at the same pose.
    """

    data: LogData
    keys: KeyPoses
    local: Trajectory
    smoothed: Trajectory

    @classmethod
    def of(cls, data: LogData, found: GraphResult, config: GraphConfig) -> "Chain":
        """The chain of a smoothed log."""
        poses = found.poses
        data = corrected(data, found.errors)
        keys = choose_keys(data, config.keys)
        poses = poses[keys.first_event]
        local = smooth_locally(keys, odometry_trajectory(keys, poses[0]), config, data.range_std)
        return cls(data, keys, local, Trajectory(poses, np.zeros(ERRORS)))

    def moved(self, motion: FloatArray) -> "Chain":
        """The chain after a motion (3,) of its frame."""
        return replace(self, local=self.local.moved(motion), smoothed=self.smoothed.moved(motion))


def joined_problem(first: Chain, second: Chain, config: GraphConfig) -> tuple[LogProblem, Trajectory]:
    """Both logs as one problem, and the trajectory that begins with their smoothed ones."""
    data = replace(
        first.data,
        max_range=max(first.data.max_range, second.data.max_range),
        range_std=max(first.data.range_std, second.data.range_std),
    )
    # Between the trajectories without loops lies the motion of the smoothed trajectories.
    seam = se2.between(first.smoothed.poses[-1], second.smoothed.poses[0])
    start = se2.compose(first.local.poses[-1], seam)
    moved = second.local.moved(se2.compose(start, se2.inverse(second.local.poses[0])))
    problem = LogProblem(joined_keys(first, second), _one_after_another(first.local, moved), data, config)
    return problem, _one_after_another(first.smoothed, second.smoothed)


def _one_after_another(first: Trajectory, second: Trajectory) -> Trajectory:
    """The trajectory of both chains, whose odometry has no constant errors that are known."""
    return Trajectory(np.vstack((first.poses, second.poses)), np.zeros(ERRORS))


def joined_keys(first: Chain, second: Chain) -> KeyPoses:
    """The key poses of both chains. The motion between the chains is that of the smoothed trajectories."""
    one, other = first.keys, second.keys
    events, keys, travel = len(one.event_key), len(one), one.travel[-1] + APART
    seam = se2.between(first.smoothed.poses[-1:], second.smoothed.poses[:1])
    return KeyPoses(
        event_key=np.append(one.event_key, other.event_key + keys),
        first_event=np.append(one.first_event, other.first_event + events),
        offset=np.vstack((one.offset, other.offset)),
        offset_forward=np.append(one.offset_forward, other.offset_forward),
        step=np.vstack((one.step, seam, other.step)),
        step_forward=np.concatenate((one.step_forward, [0.0], other.step_forward)),
        step_variances=np.vstack((one.step_variances, _SEAM_STD[None] ** 2, other.step_variances)),
        offset_rate=np.vstack((one.offset_rate, other.offset_rate)),
        step_rate=np.vstack((one.step_rate, np.zeros((1, 3)), other.step_rate)),
        travel=np.append(one.travel, other.travel + travel),
        point_event=np.append(one.point_event, other.point_event + events),
        point_key=np.append(one.point_key, other.point_key + keys),
        point_travel=np.append(one.point_travel, other.point_travel + travel),
        in_robot=np.vstack((one.in_robot, other.in_robot)),
        origin_in_robot=np.vstack((one.origin_in_robot, other.origin_in_robot)),
    )


def divided(joined: Trajectory, first: Chain) -> tuple[Trajectory, Trajectory]:
    """The trajectory of each log, from the trajectory of both chains."""
    count = len(first.keys)
    return Trajectory(joined.poses[:count], joined.bias), Trajectory(joined.poses[count:], joined.bias)


def poses_of_both(joined: Trajectory, first: Chain, second: Chain) -> tuple[FloatArray, FloatArray]:
    """Poses of all events of each log, (n, 3) and (m, 3), from the trajectory of both chains."""
    one, other = divided(joined, first)
    return event_poses(first.keys, one), event_poses(second.keys, other)
