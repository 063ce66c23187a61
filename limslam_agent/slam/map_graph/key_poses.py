"""Key poses: the poses of a log that are estimated, and the assignment of all events and points to
these poses.

A new key pose begins after some driving or turning. Between two key poses, the events follow
odometry. Odometry is corrected for its constant errors: a heading bias per metre, a scale of
distances, a gain of turns, the delay of the ranges (a scan is sent and given its time while
odometry is already newer), and the direction of driving (the beams may be mounted at an angle).
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from limslam_agent.config.graph import PointConfig
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
ANOTHER_VISIT = 13.5
"""After this distance driven, m, what is seen again is another visit of its place."""
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


@dataclass(frozen=True, eq=False)
class KeyPoses:
    """The constant part of the problem: m key poses, n events, p points."""

    # event_key, first_event: the key pose (n,) of each event, and the first event (m,) of each key
    # pose
    event_key: IntArray
    first_event: IntArray
    # offset, offset_forward: odometry pose (n, 3) of each event in the frame of its key pose;
    # distance (n,) driven forward since the key pose, m
    offset: FloatArray
    offset_forward: FloatArray
    share: FloatArray  # share (n,) of the way from its key pose to the next that lies before it
    # step, step_forward, step_variances: odometry motion (m - 1, 3) from each key pose to the next;
    # its distance (m - 1,), m, and its variances (m - 1, 3)
    step: FloatArray
    step_forward: FloatArray
    step_variances: FloatArray
    # offset_rate, step_rate: derivatives (n, 3) and (m - 1, 3) of ``offset`` and ``step`` by the
    # delay of the ranges, per s
    offset_rate: FloatArray
    step_rate: FloatArray
    # length (n,) of the path up to each event, m, with ``APART`` for each break of odometry
    travel: FloatArray
    # point_event, point_key, point_travel: event, key pose and travel (p,) of each point; points
    # are in the order of events
    point_event: IntArray
    point_key: IntArray
    point_travel: FloatArray
    # in_robot, origin_in_robot: each point (p, 2) and the origin of its beam (p, 2), in the robot's
    # frame at its event, m
    in_robot: FloatArray
    origin_in_robot: FloatArray

    def __len__(self) -> int:
        """The number of key poses."""
        return len(self.first_event)

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
    """The estimate: key poses (m, 3) and the ``bias`` (5,) of odometry.

    The bias is the missing heading per metre, rad/m, the share of distances, the share of turns,
    the delay of the ranges, s (a range was measured this long before its time), and the direction
    in which the robot drives when odometry says ahead, rad, in the frame of the beams.
    """

    poses: FloatArray
    bias: FloatArray

    def moved(self, motion: FloatArray) -> "Trajectory":
        """The trajectory after a motion (3,) of its frame."""
        return Trajectory(se2.compose(motion, self.poses), self.bias)


def choose_keys(data: LogData, config: PointConfig) -> KeyPoses:
    """Divide a log into key poses, and collect the points of its scans."""
    count = len(data.time)
    moves = np.zeros((count, 3))
    moves[1:] = se2.between(data.odometry[:-1], data.odometry[1:])
    length = np.hypot(moves[:, 0], moves[:, 1])
    turn = np.abs(moves[:, 2])
    variances = motion_variances(length, turn)
    variances[data.breaks] = data.break_stds**2
    way = length + data.apart
    driven = float(np.cumsum(length)[-1])
    # After a break, a key pose begins, and the beams see something new.
    key = _count_ups(way, turn, KEY_DISTANCE, KEY_TURN)
    first = np.searchsorted(key, np.arange(key[-1] + 1))
    travel = np.cumsum(way)
    forward = np.cumsum(moves[:, 0])
    first_of = first[key]
    offset_rate = _rates(data, first_of, np.arange(count))
    step_rate = _rates(data, first[:-1], first[1:])
    points = _spaced(data.hit, way, turn, _POINT_DISTANCE, _POINT_TURN)
    event, beam = np.nonzero(_thinned(points, max(driven, 1.0) * config.points_per_metre))
    direction = np.column_stack((np.cos(data.angles), np.sin(data.angles)))
    return KeyPoses(
        event_key=key,
        first_event=first,
        offset=se2.between(data.odometry[first_of], data.odometry),
        offset_forward=forward - forward[first_of],
        share=_shares(length / KEY_DISTANCE + turn / KEY_TURN, data.breaks, key, first),
        step=se2.between(data.odometry[first[:-1]], data.odometry[first[1:]]),
        step_forward=np.diff(forward[first]),
        step_variances=np.diff(np.cumsum(variances, axis=0)[first], axis=0),
        offset_rate=offset_rate,
        step_rate=step_rate,
        travel=travel,
        point_event=event,
        point_key=key[event],
        point_travel=travel[event],
        in_robot=data.origins[beam] + data.ranges[event, beam][:, None] * direction[beam],
        origin_in_robot=data.origins[beam],
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


def _rates(data: LogData, first: IntArray, second: IntArray) -> FloatArray:
    """Derivatives (k, 3) of the motions between events (k,) by the delay of the ranges, per s."""
    if not _has_times(data):
        return np.zeros((len(first), 3))
    later, earlier = (delayed(data, sign * _DELAY_STEP).odometry for sign in (1.0, -1.0))
    change = se2.between(later[first], later[second]) - se2.between(earlier[first], earlier[second])
    change[:, 2] = se2.wrap_angle(change[:, 2])
    return np.asarray(change / (2.0 * _DELAY_STEP))


def _has_times(data: LogData) -> bool:
    """Whether the times tell apart the events between which the robot moved. Some logs give many
    events the same time.
    """
    moved = (np.abs(np.diff(data.odometry, axis=0)) > STANDING).any(axis=1)
    later = np.diff(data.time)[moved] > 0.0
    return bool(later.mean() > _LEAST_NEW_TIMES) if len(later) else False


def delayed(data: LogData, delay: float) -> LogData:
    """The log with the odometry poses of ``delay`` s before the times of its events, by linear
    interpolation.

    A log whose times do not tell its events apart stays as it is. Of several events with one time,
    each keeps its own pose, to which the motion during the delay is added.
    """
    if not delay or not _has_times(data):
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


def calibrated_steps(keys: KeyPoses, bias: FloatArray) -> FloatArray:
    """Odometry motions (m - 1, 3) from each key pose to the next, corrected for the constant
    errors.
    """
    return _calibrated(keys.step + bias[3] * keys.step_rate, keys.step_forward, bias)


def calibrated_rates(keys: KeyPoses, bias: FloatArray) -> FloatArray:
    """Derivatives (m - 1, 3) of the corrected motions from each key pose to the next by the delay,
    per s.
    """
    rates = _calibrated(keys.step_rate, keys.step_forward, bias)
    rates[:, 2] -= bias[0] * keys.step_forward
    return rates


def event_offsets(keys: KeyPoses, bias: FloatArray) -> FloatArray:
    """Poses (n, 3) of all events in the frames of their key poses, by corrected odometry."""
    return _calibrated(keys.offset + bias[3] * keys.offset_rate, keys.offset_forward, bias)


def calibrated_motion(motion: FloatArray, bias: FloatArray) -> FloatArray:
    """A short motion (3,) by odometry without delay, corrected for the constant errors."""
    return np.asarray(_calibrated(motion[None], motion[None, 0], bias)[0])


def _calibrated(motion: FloatArray, forward: FloatArray, bias: FloatArray) -> FloatArray:
    """Correct a motion. Its direction is rotated by half of the missing heading and by the error of
    the direction.
    """
    turn, scale, gain, _, direction = bias
    half = 0.5 * turn * forward + direction
    cos = np.cos(half)
    sin = np.sin(half)
    x = (1.0 + scale) * (cos * motion[:, 0] - sin * motion[:, 1])
    y = (1.0 + scale) * (sin * motion[:, 0] + cos * motion[:, 1])
    return np.column_stack((x, y, (1.0 + gain) * motion[:, 2] + turn * forward))


def corrected(data: LogData, bias: FloatArray) -> LogData:
    """The log with its odometry corrected for the constant errors."""
    odometry = delayed(data, bias[3]).odometry
    moves = se2.between(odometry[:-1], odometry[1:])
    return replace(data, odometry=integrate(odometry[0], _calibrated(moves, moves[:, 0], bias)))


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
    bias = np.zeros(ERRORS)
    return Trajectory(integrate(start, calibrated_steps(keys, bias)), bias)


def points_in_keys(keys: KeyPoses, bias: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points and the origins of their beams, both (p, 2) m, in the frames of their key poses."""
    offset = event_offsets(keys, bias)[keys.point_event]
    return to_world(offset, keys.in_robot), to_world(offset, keys.origin_in_robot)


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
    ridden = se2.compose(poses[key], event_offsets(keys, trajectory.bias))
    arrival = np.vstack(
        (se2.compose(poses[:-1], calibrated_steps(keys, trajectory.bias)), poses[-1:])
    )
    gap = np.vstack((poses[1:], poses[-1:])) - arrival
    gap[:, 2] = se2.wrap_angle(gap[:, 2])
    ridden += keys.share[:, None] * gap[key]
    ridden[:, 2] = se2.wrap_angle(ridden[:, 2])
    return np.asarray(ridden)


@kernel
def _count_ups(length: FloatArray, turn: FloatArray, distance: float, angle: float) -> IntArray:
    """The number of times, up to each event, that the accumulated driving or turning has reached
    its threshold.
    """
    out = np.zeros(len(length), np.int64)
    driven = turned = 0.0
    count = 0
    for row in range(1, len(length)):
        driven += length[row]
        turned += turn[row]
        if driven >= distance or turned >= angle:
            count += 1
            driven = turned = 0.0
        out[row] = count
    return out


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
