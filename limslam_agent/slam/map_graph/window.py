"""The latest events, and the local frame: the last metres of driving, smoothed with the known
errors of odometry.

The constant errors of odometry are estimated in each window anew. A window alone says little about
them, and successive windows overlap. The information of all windows is therefore added up, each
with the share of driving that is new in it, and the sum is the prior of the next window.
"""

import math
from bisect import bisect_left
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from limslam_agent.config.graph import GraphConfig, OdometryErrorConfig, SmoothingConfig
from limslam_agent.slam.graph.factors import prior
from limslam_agent.slam.graph.graph import Graph
from limslam_agent.slam.map_graph.key_poses import (
    APART,
    ERRORS,
    KEY_DISTANCE,
    KEY_TURN,
    KeyPoses,
    LogData,
    Trajectory,
    choose_keys,
    corrected,
    event_poses,
    integrate,
    joined_bias,
    odometry_trajectory,
)
from limslam_agent.slam.map_graph.smoothing import (
    cautious_graph,
    motion_covariances,
    smooth_further,
    smooth_locally,
)
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import between, compose

_ITERATIONS = SmoothingConfig(link_iterations=3, line_iterations=5)
"""Fewer iterations than for a whole log: the errors of odometry are nearly known, and a window is
short.
"""
_CROWD = 500
"""Number of events near one place that are kept. Each further one takes the place of the last one:
a robot that stands or creeps sees nothing new.
"""


class _Event(NamedTuple):
    time: float  # s
    travel: float  # distance driven, m, with ``APART`` for each break of odometry
    move: FloatArray  # motion (3,) since the event before
    ranges: FloatArray  # (b,), m
    hit: BoolArray  # whether each beam has seen a wall (b,)
    break_stds: FloatArray | None  # standard deviations (3,) of the motion if it is unknown


class RecentEvents:
    """The latest events of a robot that reports poses of odometry, with their numbers since the
    beginning.

    Attributes
    ----------
    first
        Number of the first event that is still known.
    travel, turned, backwards
        Distance driven, m, with ``APART`` for each break of odometry, angle turned, rad, and
        distance driven backwards, m, by odometry up to the last event.
    last_motion
        Motion (3,) by odometry from the event before to the last event.
    """

    def __init__(self) -> None:
        self.first = 0
        self.travel = 0.0
        self.turned = 0.0
        self.backwards = 0.0
        self._odometry: FloatArray | None = None
        self.last_motion = np.zeros(3)
        # travel and turn of a place, and its events
        self._place = (0.0, 0.0)
        self._crowd = 0
        self._events = list[_Event]()

    @property
    def last(self) -> int:
        """Number of the last event."""
        return self.first + len(self._events) - 1

    def append(
        self,
        time: float,
        odometry: FloatArray,
        ranges: FloatArray,
        hit: BoolArray,
        break_stds: FloatArray | None = None,
    ) -> None:
        """Note an event: its time, s, pose of odometry (3,), ranges (b,), m, whether each saw a
        wall (b,), and the standard deviations (3,) of the motion before it if that is unknown.
        """
        move = np.zeros(3) if self._odometry is None else between(self._odometry, odometry)
        self._odometry = np.array(odometry)
        self.travel += math.hypot(move[0], move[1])
        if break_stds is not None:
            self.travel += APART
        self.turned += abs(float(move[2]))
        self.backwards -= min(float(move[0]), 0.0)
        self.last_motion = move.copy()
        travel, turned = self._place
        if self.travel - travel >= KEY_DISTANCE or self.turned - turned >= KEY_TURN:
            self._place = (self.travel, self.turned)
            self._crowd = 0
        self._crowd += 1
        if self._crowd > _CROWD:
            move = compose(self._events.pop().move, move)
        self._events.append(
            _Event(time, self.travel, move, np.array(ranges), np.array(hit), break_stds)
        )

    def at(self, travel: float) -> int:
        """Number of the first event at which this distance was driven, m, or of the last event."""
        number = bisect_left(self._events, travel, key=lambda event: event.travel)
        return min(self.first + number, self.last)

    def travel_at(self, event: int) -> float:
        """Distance driven up to an event, m."""
        return self._events[event - self.first].travel

    def motion_during(self, delay: float) -> FloatArray:
        """Motion (3,) by odometry in the last ``delay`` s before the last event."""
        motion = np.zeros(3)
        begin = self._events[-1].time - delay
        for event, before in pairwise(reversed(self._events)):
            span = event.time - before.time
            if event.time <= begin or span <= 0.0 or event.break_stds is not None:
                break
            motion = compose(min(1.0, (event.time - begin) / span) * event.move, motion)
        return motion

    def forget_before(self, event: int) -> None:
        """Forget the events before an event."""
        del self._events[: event - self.first]
        self.first = event

    def turn_round(self, begin: int, end: int) -> None:
        """Take the motions between two events as driven backwards."""
        for event in self._events[begin + 1 - self.first : end + 1 - self.first]:
            event.move[:2] *= -1.0

    def data(self, like: LogData) -> LogData:
        """The events as a log with the beams of another one."""
        events = self._events
        odometry = integrate(np.zeros(3), np.array([each.move for each in events])[1:])
        breaks = [row for row, each in enumerate(events) if row and each.break_stds is not None]
        return replace(
            like,
            time=np.array([each.time for each in events]),
            odometry=odometry,
            ranges=np.array([each.ranges for each in events]),
            hit=np.array([each.hit for each in events]),
            breaks=np.array(breaks, dtype=np.int64),
            break_stds=np.array([events[row].break_stds for row in breaks]).reshape(-1, 3),
        )


_ERROR_NAMES = [each.name for each in fields(OdometryErrorConfig)]


@dataclass(frozen=True, eq=False)
class OdometryErrors:
    """What is known of the constant errors of odometry: their mean (5,) and its information matrix
    (5, 5).
    """

    mean: FloatArray
    information: FloatArray

    @classmethod
    def unknown(cls, config: OdometryErrorConfig) -> "OdometryErrors":
        """The prior of the settings."""
        return cls(np.zeros(ERRORS), np.diag(np.array(config.stds) ** -2.0))

    def prior(self, config: OdometryErrorConfig) -> OdometryErrorConfig:
        """The settings for odometry that is corrected for the mean errors: only what is unknown
        remains.
        """
        stds = np.sqrt(np.diag(np.linalg.inv(self.information))).tolist()
        return replace(config, **dict(zip(_ERROR_NAMES, stds, strict=True)))

    def after(
        self, remaining: FloatArray, information: FloatArray, share: float
    ) -> "OdometryErrors":
        """What is known after a window.

        Parameters
        ----------
        remaining, information
            Estimate (5,) of the errors that remained in the window after the correction, and its
            information (5, 5) with the prior of the window.
        share
            Weight of the window's own information.
        """
        prior = np.diag(1.0 / np.diag(np.linalg.inv(self.information)))
        total = self.information + share * (information - prior)
        found = np.asarray(share * np.linalg.solve(total, information @ remaining))
        return OdometryErrors(joined_bias(self.mean, found), 0.5 * (total + total.T))


@dataclass(frozen=True, eq=False)
class LocalFrame:
    """A smoothed window, in the frame of its first event.

    Attributes
    ----------
    keys, trajectory
        The key poses of the window and their trajectory, for the corrected odometry.
    first
        Number of the first event of the window.
    poses
        Poses (n, 3) of all events of the window.
    """

    keys: KeyPoses
    trajectory: Trajectory
    first: int
    poses: FloatArray

    @cached_property
    def _graph(self) -> Graph:
        return cautious_graph(self.keys, self.trajectory)

    def covariances(self, keys: IntArray) -> FloatArray:
        """Covariances (k - 1, 3, 3) of the motions between successive key poses ``keys`` (k,)."""
        return motion_covariances(self._graph, self.trajectory.poses, keys)

    def learned(self, errors: OdometryErrors, share: float) -> OdometryErrors:
        """What is known of the errors of odometry after the window, of which a share was in no
        earlier window.
        """
        remaining = self.trajectory.bias
        known = prior("errors", remaining[None], np.eye(ERRORS))
        information = np.linalg.inv(self._graph.covariances(known)[0])
        return errors.after(remaining, information, share)


def smooth_window(
    data: LogData,
    first: int,
    errors: OdometryErrors,
    config: GraphConfig,
    earlier: LocalFrame | None,
) -> LocalFrame | None:
    """Smooth a window of driving that begins with the event ``first``; None if it holds no two key
    poses or no points.

    An ``earlier`` window has smoothed all but the last metres.
    """
    config = replace(config, motion=errors.prior(config.motion), smoothing=_ITERATIONS)
    keys = choose_keys(corrected(data, errors.mean), config)
    if len(keys) < 2 or not len(keys.point_event):
        return None
    trajectory = odometry_trajectory(keys, np.zeros(3))
    if earlier is None:
        trajectory = smooth_locally(keys, trajectory)
    else:
        before = earlier.poses[first - earlier.first :]
        odometry = keys.data.odometry[len(before) - 1 :]
        after = compose(before[-1], between(odometry[0], odometry[1:]))
        poses = between(before[0], np.vstack((before, after)))[keys.first_event]
        trajectory = smooth_further(keys, replace(trajectory, poses=poses))
    return LocalFrame(keys, trajectory, first, event_poses(keys, trajectory))
