"""The problem of the line smoother: what was measured, the variables, and the readings that the
variables predict.

The variables are the pose of every step, every line, and the calibration of wheels and ranges. The
wheels drive exact arcs, so poses follow from motions.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from limslam_agent.config.consistent import RangeErrorConfig, SelfCalibrationConfig
from limslam_agent.config.presets import AgentConfig
from limslam_agent.kernels.beams import line_table, predict_readings
from limslam_agent.slam.core.contact import slip_covariances
from limslam_agent.slam.core.encoder_ticks import jitter_of, tick_variances, ticks_of
from limslam_agent.slam.core.motion import LEAST_VARIANCE
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.core.turn_meter import turns_of
from limslam_agent.slam.line_graph.factors import drive, motions_between
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import compose
from limslam_env.interface import NominalNoise, RobotSpec

LEAST_RANGE_STD = AgentConfig.min_range_std
ASIDE_STD = 1e-5
"""Motion aside, m, that keeps the equations regular, and adds up to less than a millimetre in a
run.
"""


_KNOWN = 1e-6  # standard deviation of what remains as it is known


def _prior(sizes: FloatArray, bias_std: float) -> FloatArray:
    """Inverse covariance (5, 5) by the covariance of the sizes (3, 3), and the standard deviation
    of a bias, m. The scale of the ranges remains as it is known.
    """
    of_ranges = np.diag([bias_std**2, _KNOWN**2])
    return np.asarray(np.linalg.inv(block_diag(sizes, of_ranges)), dtype=float)


_SIZES = SelfCalibrationConfig(uneven_std=0.03)

CALIBRATION_PRIOR = _prior(_SIZES.covariance, 0.02)
"""Inverse covariance (5, 5) of the prior of a robot's calibration: left wheel, right wheel, axle,
bias, scale of the ranges.
"""

HEADING_PRIOR = _prior(_SIZES.heading_covariance, _KNOWN)
"""The same for a robot with a heading sensor: size of the wheels, scale, drift, bias, scale of the
ranges.

The bias remains as it is known.
"""

RELATIVE_PRIOR = _prior(replace(_SIZES, size_std=_KNOWN).covariance, _KNOWN)
"""The same if wheels and ranges are taken to have no common error.

The deviations are so small that no readings make the common errors count in Wald's test.
"""


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of k beams, sorted by ``places``.

    Attributes
    ----------
    places
        Index (k,) of the pose of each reading. The pose of robot i at step s of t has the index i t
        + s.
    beams
        Index (k,) of the beam of each reading.
    distances
        Measured distances (k,), m.
    """

    places: IntArray
    beams: IntArray
    distances: FloatArray

    def __len__(self) -> int:
        return len(self.places)


class Expected(NamedTuple):
    """What k readings should be.

    Attributes
    ----------
    ranges
        Expected ranges (k,), m; negative behind the beam.
    by_pose, by_line
        Derivatives of the ranges by the poses (k, 3) and by the lines (k, 2).
    cosines
        Cosines (k,) of the angles between the rays that measure and the normals of the lines.
    """

    ranges: FloatArray
    by_pose: FloatArray
    by_line: FloatArray
    cosines: FloatArray

    @property
    def along(self) -> FloatArray:
        """Where the rays meet their lines (k,), m from the lines' anchors."""
        return np.asarray(-self.by_line[:, 1] / self.by_line[:, 0])


@dataclass(frozen=True, eq=False)
class Problem:
    """The measurements of n robots in t steps, and their standard deviations."""

    robot: RobotSpec  # body and beams of each robot. The beams are those that are assumed.
    starts: FloatArray  # known poses (n, 3) of the first step, m and rad
    # wheels, roots: reported motions (n, t - 1, 3), m, of which the last column is the motion
    # aside, and roots (n, t - 1, 3, 3) of their inverse covariances
    wheels: FloatArray
    roots: FloatArray
    # readings, looks: the readings of walls; and these with the beams that met no wall, each with
    # the length of its free path
    readings: Readings
    looks: Readings
    # how the ranges are measured, which are corrected for it. A calibration is what is left.
    sensor: RangeSensor
    # the ticks (n, 2) of the wheels' encoders, m, as ``encoder_ticks.tick_by`` finds them
    ticks: FloatArray
    prior: FloatArray | None = None  # inverse covariance of a robot's calibration, or None
    # Motions (n, t - 1, 3) of carried robots, m, of which the wheels say nothing; None if no robot
    # was carried
    jumps: FloatArray | None = None
    # turns, heading_jitters: of robots with heading sensors, the turns (n, t - 1, 2) that these
    # have measured, rad, and for how long, s, both 0 where the wheels give the turn; and the
    # variances (n, t) of the headings about the sum of all turns, rad^2
    turns: FloatArray | None = None
    heading_jitters: FloatArray | None = None

    @property
    def steps(self) -> int:
        """Number of steps t."""
        return int(self.wheels.shape[1]) + 1

    @cached_property
    def beams(self) -> FloatArray:
        """The readings (k, 6) as rows of :mod:`~limslam_agent.kernels.beams`."""
        return self._beams_of(self.readings)

    @cached_property
    def look_beams(self) -> FloatArray:
        """The looks (k, 6) as such rows."""
        return self._beams_of(self.looks)

    @cached_property
    def is_hit(self) -> BoolArray:
        """Which of the looks (k,) met a wall."""
        return np.asarray(self.looks.distances < self.robot.too_far[self.looks.beams])

    @property
    def range_std(self) -> float:
        """Standard deviation of a reading of usual length, m."""
        return max(self.sensor.usual_std(float(self.robot.max_ranges.max())), LEAST_RANGE_STD)

    def jitters(self, state: "State") -> FloatArray:
        """Covariances (n, t, 3, 3) of the poses about what the encoders have reported:
        ``encoder_ticks.jitter_of``.
        """
        turns = np.tile(np.eye(3), (*state.poses.shape[:2], 1, 1))
        turns[..., 0, 0] = turns[..., 1, 1] = np.cos(state.poses[..., 2])
        turns[..., 1, 0] = np.sin(state.poses[..., 2])
        turns[..., 0, 1] = -turns[..., 1, 0]
        own = np.array([jitter_of(ticks, self.robot.axle) for ticks in self.ticks])[:, None]
        if self.heading_jitters is not None:
            own = np.tile(np.diag([1.0, 1.0, 0.0]) * own, (1, self.steps, 1, 1))
            own[..., 2, 2] = self.heading_jitters
        return np.asarray(turns @ own @ np.swapaxes(turns, -1, -2))

    @cached_property
    def stds(self) -> FloatArray:
        """Standard deviation of each reading (k,) by its sensor, m."""
        return np.maximum(self.sensor.stds(self.readings.distances), LEAST_RANGE_STD)

    def variances(self, state: "State", found: Expected) -> FloatArray:
        """Variance of each reading (k,), m^2, by the sensor and by the jitter of its pose, from
        what it should be.
        """
        jitters = self.jitters(state).reshape(-1, 3, 3)[self.readings.places]
        return np.asarray(
            self.stds**2 + np.einsum("ki,kij,kj->k", found.by_pose, jitters, found.by_pose)
        )

    @cached_property
    def prior_calibration(self) -> FloatArray:
        """The likeliest calibration (5,) before the drive. That of a scale that was found is 0 in
        all.
        """
        return np.array([0.0, 0.0, 0.0, 0.0, -self.sensor.scale])

    @cached_property
    def information(self) -> FloatArray:
        """The inverse covariance of a robot's calibration, also of a scale that was found."""
        assert self.prior is not None  # noqa: S101 (only a calibration has one)
        found = self.prior.copy()
        if self.sensor.scale_std:
            found[4, 4] = RangeErrorConfig().scale_std ** -2
        return found

    def true(self, ranges: FloatArray, places: IntArray, calibration: FloatArray) -> FloatArray:
        """The distances (k,), m, at which ranges of walls were measured from poses with numbers
        (k,), by the calibration (n, 5).
        """
        _, _, _, bias, scale = calibration[places // self.steps].T
        return np.asarray((ranges - bias) / (1.0 + scale))

    def axle(self, calibration: FloatArray) -> float:
        """The distance between the wheels (m) of a robot with a calibration (5,)."""
        return self.robot.axle * (1.0 if self.turns is not None else 1.0 + float(calibration[2]))

    @cached_property
    def by_sizes(self) -> FloatArray:
        """Derivatives (n, t - 1, 3, 3) of the measured motions by the first three numbers of the
        calibration.
        """
        found = np.zeros((*self.wheels.shape, 3))
        if self.turns is None:
            found[..., 0, 0] = self.wheels[..., 0]
            found[..., 1, 1] = self.wheels[..., 1]
            return found
        lever = 0.5 * self.robot.axle * self.turns * (1.0, -1.0)
        found[..., :2, 0] = self.wheels[..., :2].mean(axis=-1, keepdims=True)
        found[..., 0, 1:] = -lever
        found[..., 1, 1:] = lever
        return found

    def sizes(self, calibration: FloatArray) -> FloatArray:
        """By what motions by the calibration (n, 5) are larger than the reported ones (n, 1, 3)."""
        sizes = np.ones((len(self.wheels), 1, 3))
        if self.turns is None:
            sizes[:, 0, :2] += calibration[:, :2]
        return sizes

    def motions(self, calibration: FloatArray) -> FloatArray:
        """The measured motions (n, t - 1, 3), m, by the calibration (n, 5) of the wheels."""
        if self.turns is None:
            found = self.wheels * self.sizes(calibration)
        else:
            found = self.wheels + np.einsum("ntij,nj->nti", self.by_sizes, calibration[:, :3])
        return found if self.jumps is None else found + self.jumps

    def whitened(self, errors: FloatArray) -> FloatArray:
        """Errors of the motions (n, t - 1, 3), m, or derivatives of them (n, t - 1, 3, k), in
        standard deviations.
        """
        return np.asarray(np.einsum("ntij,ntj...->nti...", self.roots, errors))

    def _beams_of(self, readings: Readings) -> FloatArray:
        beams = readings.beams
        origins = self.robot.beam_origins[beams]
        angles = self.robot.beam_angles[beams]
        cones = np.full(len(beams), self.sensor.cone)
        return np.column_stack((origins, angles, readings.distances, cones, beams))


@dataclass(frozen=True, eq=False)
class State:
    """The variables of the least-squares problem.

    Attributes
    ----------
    motions, poses
        Motions (n, t - 1, 3), m, and the poses (n, t, 3) that follow from them, m and rad; headings
        are not wrapped.
    lines, anchors
        Lines (m, 2) as (d, alpha) about one anchor point each, m and rad, and the anchors (m, 2),
        m.
    calibration
        Calibration (n, 5): relative excess of left wheel, right wheel and axle, or with a heading
        sensor the numbers of ``HeadingCalibration``; and the bias, m, and the scale of all ranges
        beside those of the sensor.
    """

    motions: FloatArray
    poses: FloatArray
    lines: FloatArray
    anchors: FloatArray
    calibration: FloatArray

    @property
    def flat_poses(self) -> FloatArray:
        """All poses (n t, 3), sorted by robot and then by step."""
        return self.poses.reshape(-1, 3)

    @property
    def line_rows(self) -> FloatArray:
        """The lines (m, 5) as rows of :mod:`~limslam_agent.kernels.beams`."""
        return line_table(self.lines, self.anchors)

    def rays(self, places: IntArray, beams: FloatArray, lengths: FloatArray) -> FloatArray:
        """Beams on the bodies at these poses (k,), with these lengths, m, as rows (k, 5) of a table
        of rays.
        """
        x, y, heading = compose(self.flat_poses[places], beams[:, :3]).T
        return np.column_stack((x, y, np.cos(heading), np.sin(heading), lengths))


def make_problem(
    robot: RobotSpec,
    noise: NominalNoise,
    starts: FloatArray,
    wheels: FloatArray,
    ranges: FloatArray,
    usable: BoolArray | None = None,
    prior: FloatArray | None = None,
    first_step: int = 0,
    sensor: RangeSensor | None = None,
    ticks: FloatArray | None = None,
    yaw: FloatArray | None = None,
    unknown: FloatArray | None = None,
) -> Problem:
    """Collect the measurements of a run.

    Parameters
    ----------
    robot, noise
        Body and beams of each of the n robots, and the specified noise. The standard deviation of
        ranges is taken to be at least 5 mm.
    starts
        Known poses (n, 3), m and rad.
    wheels, ranges
        Observations (t, n, 2) and (t, n, n_beams), m; row 0 is the observation at the reset.
    usable
        Mask (t, n, n_beams) of the readings that may be used; None for all. Readings without a wall
        are always left out. So are old readings that a slow sensor repeats.
    prior
        ``CALIBRATION_PRIOR`` if wheels, axle and bias are to be estimated, or None.
    first_step
        Step of the drive that row 0 belongs to. It decides which readings a slow sensor repeats.
    sensor
        How the ranges are measured, if that is known to differ from ``robot`` and ``noise``.
    ticks
        The ticks (n, 2) of the encoders, m; by the wheels if left out.
    yaw
        Headings (t, n) by inertial measurement units, rad, NaN without a reading; None without such
        sensors.
    unknown
        Variances (t, n, 2) of the wheels' travel beyond the noise of encoders, m^2.
    """
    wheels = np.asarray(wheels, dtype=float)
    unknown = np.zeros_like(wheels) if unknown is None else unknown
    reported = np.moveaxis(wheels, 0, 1)[:, 1:]
    motions = np.concatenate((reported, np.zeros_like(reported[..., :1])), axis=-1)
    ranges = np.asarray(ranges, dtype=float)
    fresh = np.array([robot.measures(first_step + row) for row in range(len(ranges))])[:, None]
    measured = fresh & np.isfinite(ranges) & (True if usable is None else usable)
    sensor = sensor or RangeSensor(noise.range_std, cone=robot.cone)
    measured[..., list(sensor.broken)] = False
    ranges = sensor.corrected(ranges, robot)
    looked = measured & (ranges > robot.too_near)
    readings = _listed(looked & (ranges < robot.too_far), ranges)
    looks = _listed(looked, np.minimum(ranges, robot.max_ranges))
    ticks = ticks_of(np.where(unknown, 0.0, wheels)) if ticks is None else ticks
    covariances = slip_covariances(
        robot, max(noise.range_std, LEAST_RANGE_STD), reported, ranges, measured
    )
    covariances[..., 2, 2] += ASIDE_STD**2
    steered = None if yaw is None else _by_headings(robot, noise, yaw, wheels, unknown)
    if steered is None:
        covariances[..., [0, 1], [0, 1]] += (
            noise.wheel_variance * np.abs(reported)
            + LEAST_VARIANCE
            + np.moveaxis(unknown, 0, 1)[:, 1:]
        )
    else:
        motions[..., :2] = steered.motions
        covariances[..., :2, :2] += steered.covariances
    if not first_step:  # see ``encoder_ticks.first_jitter``
        covariances[:, 0, [0, 1], [0, 1]] += tick_variances(ticks)
    roots = np.linalg.inv(np.linalg.cholesky(covariances))
    starts = np.asarray(starts, dtype=float)
    return Problem(
        sensor.mounted(robot),
        starts,
        motions,
        roots,
        readings,
        looks,
        sensor,
        ticks,
        prior,
        turns=None if steered is None else steered.turns,
        heading_jitters=None if steered is None else steered.jitters,
    )


class _Steered(NamedTuple):
    """The motions of n robots with heading sensors in t steps.

    Attributes
    ----------
    motions, covariances
        Travel (n, t - 1, 2) of wheels that do not slip in turns, m, and covariances (n, t - 1, 2,
        2).
    turns, jitters
        ``Problem.turns`` and ``Problem.heading_jitters``.
    """

    motions: FloatArray
    covariances: FloatArray
    turns: FloatArray
    jitters: FloatArray


def _by_headings(
    robot: RobotSpec,
    noise: NominalNoise,
    yaw: FloatArray,
    wheels: FloatArray,
    unknown: FloatArray,
) -> _Steered:
    """The motions by headings (t, n), rad, and the travel (t, n, 2) of the wheels, m, with its
    further variances, m^2.
    """
    travel = np.moveaxis(wheels, 0, 1)
    more = unknown.sum(axis=-1).T
    table = np.array(
        [
            [(each.angle, each.variance, each.jitter, each.measured, each.seconds) for each in own]
            for own in (
                turns_of(robot, noise, *each) for each in zip(yaw.T, travel, more, strict=True)
            )
        ]
    )
    angles = table[:, 1:, 0, None, None]
    variances = table[:, 1:, 1, None, None]
    distances = 0.5 * travel[:, 1:].sum(axis=-1)
    of_distances = 0.25 * (noise.wheel_variance * np.abs(travel).sum(axis=-1) + more)[:, 1:]
    by_turn = 0.5 * robot.axle * np.array([[-1.0], [1.0]])
    covariances = (of_distances + 0.5 * LEAST_VARIANCE)[..., None, None] * np.ones((2, 2))
    return _Steered(
        distances[..., None] + (angles * by_turn)[..., 0],
        covariances + variances * (by_turn @ by_turn.T),
        table[:, 1:, 3:],
        table[..., 2],
    )


def _listed(kept: BoolArray, ranges: FloatArray) -> Readings:
    """The ranges (t, n, n_beams) that are kept, in the order of poses."""
    number, step, beam = np.nonzero(np.moveaxis(kept, 0, 1))
    return Readings(number * len(ranges) + step, beam, ranges[step, number, beam])


def state_from_poses(problem: Problem, poses: FloatArray) -> State:
    """A state without lines at poses (t, n, 3). The first pose is the known start; headings may be
    wrapped.
    """
    calibration = np.zeros((len(problem.starts), len(CALIBRATION_PRIOR)))
    chains = np.moveaxis(np.asarray(poses, dtype=float), 0, 1).copy()
    chains[..., 2] = np.unwrap(chains[..., 2], axis=1)
    motions = np.array(
        [
            motions_between(chain, problem.axle(sizes))
            for chain, sizes in zip(chains, calibration, strict=True)
        ]
    )
    return moved(problem, motions, np.zeros((0, 2)), np.zeros((0, 2)), calibration)


def moved(
    problem: Problem,
    motions: FloatArray,
    lines: FloatArray,
    anchors: FloatArray,
    calibration: FloatArray,
) -> State:
    """The state with motions (n, t - 1, 3), and with the poses that follow from these motions."""
    chains = zip(problem.starts, motions, calibration, strict=True)
    poses = np.array([drive(start, chain, problem.axle(sizes)) for start, chain, sizes in chains])
    return State(motions, poses, lines, anchors, calibration)


def expected(problem: Problem, state: State, labels: IntArray) -> Expected:
    """What each reading (k,) should be, given its line (k,). Those of readings without a line, -1,
    mean nothing.
    """
    places = problem.readings.places
    rows = np.empty((len(labels), 7))
    predict_readings(state.flat_poses, places, problem.beams, state.line_rows, labels, rows)
    *_, bias, scale = state.calibration[places // problem.steps].T
    longer = 1.0 + scale
    rows[:, :6] *= longer[:, None]
    return Expected(rows[:, 0] + bias, rows[:, 1:4], rows[:, 4:6], rows[:, 6])
