"""Key poses: the poses of a log that are estimated, and the assignment of all events and points to
these poses.

A new key pose begins after some driving or turning. Between two key poses, the events follow
odometry, corrected for its constant errors.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_env.compilation import entry_of
from limslam_env.geometry import BoolArray, FloatArray, IntArray, se2

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)

KEY_DISTANCE = 0.25
KEY_TURN = math.radians(12.0)
"""A new key pose begins after this distance driven, m, or this turn, rad."""

# m, rad: a beam gives its next point after this motion since its last one
_POINT_DISTANCE = 0.015
_POINT_TURN = math.radians(1.0)
# Standard deviations of the motion by odometry along, across and of the heading: m, m, rad per
# square root of a metre driven, and of a radian turned.
_PER_METRE = 0.05, 0.05, math.radians(2.0)
_PER_RADIAN = 0.03, 0.03, math.radians(6.0)
_DELAY_STEP = 0.05  # s, of the derivatives by the delay
_LEAST_NEW_TIMES = 0.9
STANDING = 1e-6
"""Smaller motions between two events, m and rad, are rounding errors."""
ERRORS = 5
"""Number of constant errors of odometry that are estimated."""
APART = 1000.0
"""Distance driven, m, that is taken to lie between two logs that are solved as one, and at a break
of odometry in a log.
"""
_WAY_ACROSS = 1e6  # of a break, in the way between two key poses: no event lies on it


@dataclass(frozen=True, eq=False)
class LogData:
    """A recorded log with one row for each event."""

    time: FloatArray  # (n,), s
    odometry: FloatArray  # absolute odometry poses (n, 3) in the frame of odometry; m, m, rad
    # ranges, hit: ranges (n, b), m, and whether each beam has measured a wall
    ranges: FloatArray
    hit: BoolArray
    # origins, angles: origins (b, 2), m, and directions (b,), rad, of the beams in the robot's
    # frame
    origins: FloatArray
    angles: FloatArray
    max_range: float  # longest range, m
    range_std: float = 0.0  # specified standard deviation of a range, m
    # breaks, break_stds: events (k,) before which odometry does not tell the motion, and standard
    # deviations (k, 3) of these motions along, across and of the heading, m and rad
    breaks: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    break_stds: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def apart(self) -> FloatArray:
        """Distance (n,), m, that is added to the path before each event: ``APART`` at a break."""
        apart = np.zeros(len(self.time))
        apart[self.breaks] = APART
        return apart

    @cached_property
    def moves(self) -> FloatArray:
        """Motions (n - 1, 3) of odometry from event to event."""
        return se2.between(self.odometry[:-1], self.odometry[1:])

    @cached_property
    def has_times(self) -> bool:
        """Whether the times tell apart the events between which the robot moved. Some logs give
        many events the same time.
        """
        moved = (np.abs(np.diff(self.odometry, axis=0)) > STANDING).any(axis=1)
        later = np.diff(self.time)[moved] > 0.0
        return bool(later.mean() > _LEAST_NEW_TIMES) if len(later) else False

    @cached_property
    def shifted(self) -> tuple[FloatArray, FloatArray]:
        """Odometry poses (n, 3) with ranges that are a little later, and a little earlier."""
        later, earlier = (delayed(self, sign * _DELAY_STEP).odometry for sign in (1.0, -1.0))
        return later, earlier

    @cached_property
    def points(self) -> FloatArray:
        """What the beams have met (n, b, 2), m, in the robot's frame."""
        rays = np.column_stack((np.cos(self.angles), np.sin(self.angles)))
        return np.asarray(self.origins + self.ranges[..., None] * rays)


class Motions(NamedTuple):
    """Motions by odometry (k, 3), which have constant errors.

    The errors (5,) are the missing heading per metre, rad/m, the share of distances, the share of
    turns, the delay of the ranges, s (a scan is sent and given its time while odometry is already
    newer), and the direction in which the robot drives when odometry says ahead, rad, in the frame
    of the beams (which may be mounted at an angle).
    """

    reported: FloatArray
    forward: FloatArray  # distances (k,) driven forward, m
    by_delay: FloatArray  # derivatives (k, 3) by the delay of the ranges, per s

    def calibrated(self, errors: FloatArray) -> FloatArray:
        """The motions (k, 3), corrected. Their directions are rotated by half of the missing
        heading and by the error of the direction.
        """
        turn, scale, gain, delay, direction = errors
        x, y, heading = (self.reported + delay * self.by_delay).T
        half = 0.5 * turn * self.forward + direction
        cos = np.cos(half)
        sin = np.sin(half)
        return np.column_stack(
            (
                (1.0 + scale) * (cos * x - sin * y),
                (1.0 + scale) * (sin * x + cos * y),
                (1.0 + gain) * heading + turn * self.forward,
            )
        )

    def by_errors(self, errors: FloatArray) -> FloatArray:
        """Derivatives (k, 3, 5) of the corrected motions by the errors."""
        motions = self.calibrated(errors)
        aside = np.column_stack((-motions[:, 1], motions[:, 0]))
        by_errors = np.zeros((len(motions), 3, ERRORS))
        # Half the missing heading rotates the motion.
        by_errors[:, :2, 0] = 0.5 * self.forward[:, None] * aside
        by_errors[:, 2, 0] = self.forward
        by_errors[:, :2, 1] = motions[:, :2] / (1.0 + errors[1])
        by_errors[:, 2, 2] = self.reported[:, 2] + errors[3] * self.by_delay[:, 2]
        by_errors[:, :, 3] = self._replace(reported=self.by_delay).calibrated(
            errors * (1.0, 1.0, 1.0, 0.0, 1.0)
        )
        by_errors[:, 2, 3] -= errors[0] * self.forward
        by_errors[:, :2, 4] = aside
        return by_errors


@dataclass(frozen=True, eq=False)
class KeyPoses:
    """The constant part of the problem: m key poses, n events, p points.

    Attributes
    ----------
    data, config
        The log, and the settings.
    event_key, first_event
        The key pose (n,) of each event, and the first event (m,) of each key pose.
    share
        Share (n,) of the way from its key pose to the next that lies before each event.
    step_variances
        Variances (m - 1, 3) of the odometry from each key pose to the next.
    travel
        Length (n,) of the path up to each event, m, with ``APART`` for each break of odometry.
    point_event, point_beam
        Event and beam (p,) of each point, in the order of events.
    """

    data: LogData
    config: GraphConfig
    event_key: IntArray
    first_event: IntArray
    share: FloatArray
    step_variances: FloatArray
    travel: FloatArray
    point_event: IntArray
    point_beam: IntArray

    def __len__(self) -> int:
        """The number of key poses."""
        return len(self.first_event)

    @cached_property
    def steps(self) -> Motions:
        """The motions from each key pose to the next."""
        return _motions(self.data, self.first_event[:-1], self.first_event[1:])

    @cached_property
    def offsets(self) -> Motions:
        """The motions from its key pose to each event."""
        events = np.arange(len(self.event_key))
        return _motions(self.data, self.first_event[self.event_key], events)

    @property
    def point_key(self) -> IntArray:
        """The key pose (p,) of each point."""
        return np.asarray(self.event_key[self.point_event])

    @property
    def key_travel(self) -> FloatArray:
        """Length (m,) of the path up to each key pose, m."""
        return np.asarray(self.travel[self.first_event])

    @property
    def breaks(self) -> IntArray:
        """Key poses (k,) before which odometry does not tell the motion, and with which a second
        log begins.
        """
        return np.flatnonzero(np.diff(self.key_travel, prepend=0.0) >= APART)

    @property
    def key_driven(self) -> FloatArray:
        """Distance (m,) that was driven up to each key pose in all logs, m."""
        steps = np.diff(self.key_travel, prepend=0.0)
        return np.asarray(np.cumsum(np.where(steps < APART, steps, steps - APART)))

    @property
    def driven(self) -> float:
        """Distance that was driven in all logs, m."""
        steps = np.diff(self.travel, prepend=0.0)
        return float(steps[steps < APART].sum())


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The estimate: key poses (m, 3) and the constant errors ``bias`` (5,) of odometry, those of
    :class:`Motions`.
    """

    poses: FloatArray
    bias: FloatArray

    def moved(self, motion: FloatArray) -> "Trajectory":
        """The trajectory after a motion (3,) of its frame."""
        return Trajectory(se2.compose(motion, self.poses), self.bias)


def choose_keys(data: LogData, config: GraphConfig) -> KeyPoses:
    """Divide a log into key poses, and choose the points of its scans."""
    moves = np.vstack((np.zeros(3), data.moves))
    length = np.hypot(moves[:, 0], moves[:, 1])
    turn = np.abs(moves[:, 2])
    variances = motion_variances(length, turn)
    variances[data.breaks] = data.break_stds**2
    # After a break, a key pose begins, and the beams see something new.
    way = length + data.apart
    everywhere = np.ones((len(way), 1), dtype=np.bool_)
    key = np.cumsum(_spaced(everywhere, way, turn, KEY_DISTANCE, KEY_TURN)) - 1
    first = np.searchsorted(key, np.arange(key[-1] + 1))
    points = _spaced(data.hit, way, turn, _POINT_DISTANCE, _POINT_TURN)
    most = max(float(np.cumsum(length)[-1]), 1.0) * config.keys.points_per_metre
    event, beam = np.nonzero(_thinned(points, most))
    return KeyPoses(
        data=data,
        config=config,
        event_key=key,
        first_event=first,
        share=_shares(length / KEY_DISTANCE + turn / KEY_TURN, data.breaks, key, first),
        step_variances=np.diff(np.cumsum(variances, axis=0)[first], axis=0),
        travel=np.cumsum(way),
        point_event=event,
        point_beam=beam,
    )


def _thinned(hit: BoolArray, most: float) -> BoolArray:
    """The hits (n, b) of every k-th beam, other beams in each scan; k is the least that leaves
    about ``most`` hits.
    """
    every = max(1, math.ceil(hit.sum() / most))
    scans = np.cumsum(hit.any(axis=1))
    return np.asarray(hit & ((scans[:, None] + np.arange(hit.shape[1])) % every == 0))


def _shares(way: FloatArray, breaks: IntArray, key: IntArray, first: IntArray) -> FloatArray:
    """Share (n,) of the way from the key pose of each event to the next that lies before the event.

    ``way`` (n,) is the way from the event before, ``key`` (n,) the key pose of each event, and
    ``first`` (m,) the first event of each key pose. Events before a break follow the key pose
    before it.
    """
    way = way.copy()
    way[breaks] = _WAY_ACROSS
    total = np.cumsum(way)
    ends = np.append(total[first[1:]], total[-1])
    whole = np.maximum(ends - total[first], 1e-9)
    return np.asarray((total - total[first[key]]) / whole[key])


def motion_variances(length: FloatArray, turn: FloatArray) -> FloatArray:
    """Variances (k, 3) of motions by odometry of ``length`` (k,), m, and ``turn`` (k,), rad."""
    return np.asarray(
        length[:, None] * np.array(_PER_METRE) ** 2 + turn[:, None] * np.array(_PER_RADIAN) ** 2
    )


def _motions(data: LogData, first: IntArray, second: IntArray) -> Motions:
    """The motions between events (k,)."""
    forward = np.cumsum(np.append(0.0, data.moves[:, 0]))
    by_delay = np.zeros((len(first), 3))
    if data.has_times:
        later, earlier = (se2.between(poses[first], poses[second]) for poses in data.shifted)
        by_delay = later - earlier
        by_delay[:, 2] = se2.wrap_angle(by_delay[:, 2])
        by_delay /= 2.0 * _DELAY_STEP
    reported = se2.between(data.odometry[first], data.odometry[second])
    return Motions(reported, forward[second] - forward[first], by_delay)


def delayed(data: LogData, delay: float) -> LogData:
    """The log with the odometry poses of ``delay`` s before the times of its events, by linear
    interpolation.

    A log whose times do not tell its events apart stays as it is. Of several events with one time,
    each keeps its own pose, to which the motion during the delay is added.
    """
    if not delay or not data.has_times:
        return data
    time = np.maximum.accumulate(data.time)
    odometry = data.odometry
    nodes, chosen = np.unique(time, return_index=True)
    columns = np.column_stack((odometry[:, :2], np.unwrap(odometry[:, 2])))
    changes = [
        np.interp(time - delay, nodes, each) - np.interp(time, nodes, each)
        for each in columns[chosen].T
    ]
    poses = columns + np.column_stack(changes)
    poses[:, 2] = se2.wrap_angle(poses[:, 2])
    return replace(data, odometry=poses)


def calibrated(moves: FloatArray, errors: FloatArray) -> FloatArray:
    """Short motions (k, 3) by odometry without delay, corrected for the constant errors."""
    return Motions(moves, moves[:, 0], np.zeros_like(moves)).calibrated(errors)


def corrected(data: LogData, errors: FloatArray) -> LogData:
    """The log with its odometry corrected for the constant errors."""
    data = delayed(data, errors[3])
    return replace(data, odometry=integrate(data.odometry[0], calibrated(data.moves, errors)))


def joined_bias(first: FloatArray, second: FloatArray) -> FloatArray:
    """The constant errors (5,) of odometry that is corrected for the first errors and then for the
    second ones.
    """
    scale, gain = (1.0 + first[1:3]) * (1.0 + second[1:3]) - 1.0
    turn = (1.0 + second[2]) * first[0] + (1.0 + first[1]) * second[0]
    return np.array([turn, scale, gain, *(first[3:] + second[3:])])


def integrate(start: FloatArray, steps: FloatArray) -> FloatArray:
    """Poses (m, 3) that follow from motions (m - 1, 3) and the first pose ``start`` (3,)."""
    headings = start[2] + np.append(0.0, np.cumsum(steps[:, 2]))
    cos = np.cos(headings[:-1])
    sin = np.sin(headings[:-1])
    x = start[0] + np.append(0.0, np.cumsum(cos * steps[:, 0] - sin * steps[:, 1]))
    y = start[1] + np.append(0.0, np.cumsum(sin * steps[:, 0] + cos * steps[:, 1]))
    return np.column_stack((x, y, se2.wrap_angle(headings)))


def odometry_trajectory(keys: KeyPoses, start: FloatArray) -> Trajectory:
    """The trajectory by odometry alone."""
    return Trajectory(integrate(start, keys.steps.reported), np.zeros(ERRORS))


def points_in_keys(keys: KeyPoses, bias: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points and the origins of their beams, both (p, 2) m, in the frames of their key poses."""
    offset = keys.offsets.calibrated(bias)[keys.point_event]
    points = keys.data.points[keys.point_event, keys.point_beam]
    return to_world(offset, points), to_world(offset, keys.data.origins[keys.point_beam])


def to_world(poses: FloatArray, points: FloatArray) -> FloatArray:
    """Transform points (p, 2) from the frames of poses (p, 3), one pose for each point, into the
    frame of the poses.
    """
    cos = np.cos(poses[:, 2])
    sin = np.sin(poses[:, 2])
    x = poses[:, 0] + cos * points[:, 0] - sin * points[:, 1]
    return np.column_stack((x, poses[:, 1] + sin * points[:, 0] + cos * points[:, 1]))


def event_poses(keys: KeyPoses, trajectory: Trajectory) -> FloatArray:
    """Poses (n, 3) of all events.

    The difference between odometry and the next key pose is distributed over the path between two
    key poses.
    """
    poses = trajectory.poses
    key = keys.event_key
    driven = se2.compose(poses[key], keys.offsets.calibrated(trajectory.bias))
    arrival = se2.compose(poses[:-1], keys.steps.calibrated(trajectory.bias))
    gap = np.vstack((poses[1:] - arrival, np.zeros(3)))
    gap[:, 2] = se2.wrap_angle(gap[:, 2])
    driven += keys.share[:, None] * gap[key]
    driven[:, 2] = se2.wrap_angle(driven[:, 2])
    return np.asarray(driven)


@kernel
def _spaced(
    hit: BoolArray, length: FloatArray, turn: FloatArray, distance: float, angle: float
) -> BoolArray:
    """The hits (n, b) before which the robot has driven or turned far enough since the last hit of
    the same beam that was chosen, in whichever rows of the log the motion stands.
    """
    out = np.zeros(hit.shape, np.bool_)
    driven = np.full(hit.shape[1], np.inf)
    turned = np.zeros(hit.shape[1])
    for row in range(len(hit)):
        for beam in range(hit.shape[1]):
            driven[beam] += length[row]
            turned[beam] += turn[row]
            if hit[row, beam] and (driven[beam] >= distance or turned[beam] >= angle):
                out[row, beam] = True
                driven[beam] = turned[beam] = 0.0
    return out
