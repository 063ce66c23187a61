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
from limslam_agent.slam.core.motion import LEAST_VARIANCE, corrected_heading, corrected_wheels
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.core.turn_meter import turns_of
from limslam_agent.slam.line_graph.motions import drive, motion_jacobians, motions_between
from limslam_agent.slam.line_graph.run import FOUND_STDS, FilteredRun
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import compose, wrap_angle
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
    # motions, roots: reported motions (n, t - 1, 3), which are not aside, and roots (n, t - 1, 3,
    # 3) of their inverse covariances
    motions: FloatArray
    roots: FloatArray
    # jumps: motions (n, t - 1, 3) of carried robots, of which nothing is reported, else 0
    jumps: FloatArray
    # readings, looks: the readings of walls; and these with the beams that met no wall, each with
    # the length of its free path
    readings: Readings
    looks: Readings
    # how the ranges are measured, which are corrected for it. A calibration is what is left.
    sensor: RangeSensor
    # covariances (n, t, 3, 3) of the poses, in their frames, about what was reported
    own_jitters: FloatArray
    prior: FloatArray | None = None  # inverse covariance of a robot's calibration, or None
    # turns: of robots with heading sensors, the turns (n, t - 1, 2) that these have measured, rad,
    # and for how long, s, both 0 where the wheels give the turn
    turns: FloatArray | None = None

    @property
    def steps(self) -> int:
        """Number of steps t."""
        return int(self.motions.shape[1]) + 1

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
        return np.asarray(turns @ self.own_jitters @ np.swapaxes(turns, -1, -2))

    @cached_property
    def stds(self) -> FloatArray:
        """Standard deviation of each reading (k,) by its sensor, m."""
        return np.maximum(self.sensor.stds(self.readings.distances), LEAST_RANGE_STD)

    def variances(self, state: "State", expected: Expected) -> FloatArray:
        """Variance of each reading (k,), m^2, by the sensor and by the jitter of its pose, from
        what it should be.
        """
        jitters = self.jitters(state).reshape(-1, 3, 3)[self.readings.places]
        return np.asarray(
            self.stds**2 + np.einsum("ki,kij,kj->k", expected.by_pose, jitters, expected.by_pose)
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
        information = self.prior.copy()
        if self.sensor.scale_std:
            information[4, 4] = RangeErrorConfig().scale_std ** -2
        return information

    def true(self, readings: Readings, calibration: FloatArray) -> FloatArray:
        """The distances (k,), m, at which walls were measured, by the calibration (n, 5)."""
        bias, scale = calibration[readings.places // self.steps, 3:].T
        return np.asarray((readings.distances - bias) / (1.0 + scale))

    def reports(
        self, motions: FloatArray, calibration: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What robots with a calibration (n, 5) report of motions (n, t - 1, 3), and its
        derivatives by the motions (n, 1, 3, 3) and by the calibration (n, t - 1, 3, 5).

        The noise is that of the reports. If it grew with the wheels, it would be least in the
        smallest map.
        """
        errors = tuple(calibration[:, :3].T[..., None])
        motions = motions - self.jumps
        inverse = np.tile(np.eye(3), (len(motions), 1, 1, 1))
        if self.turns is None:
            left, right, axle = errors
            back = (-left / (1.0 + left), -right / (1.0 + right), 0.0)
            own = self.robot.axle
            inverse[..., 0, 0], inverse[..., 2, 0], _ = corrected_wheels(1.0, 0.0, own, back)
            inverse[..., 0, 2], inverse[..., 2, 2], _ = corrected_wheels(0.0, 1.0 + axle, own, back)
            reports = (inverse @ motions[..., None])[..., 0]
            rows = corrected_wheels(reports[..., 0], reports[..., 2], own, errors)[2]
        else:
            turns = (self.turns[..., 0], self.turns[..., 1])
            _, more, rows = corrected_heading(motions[..., 0], 0.0, turns, errors)
            motions[..., 2] -= more
            inverse[..., 0, 0] = 1.0 / (1.0 + errors[0])
            reports = (inverse @ motions[..., None])[..., 0]
            rows = corrected_heading(reports[..., 0], 0.0, turns, errors)[2]
        by_errors = np.zeros((*motions.shape, calibration.shape[1]))
        for part, row in zip((0, 2), rows, strict=True):
            for column, value in enumerate(row):
                by_errors[..., part, column] = value
        return reports, inverse, -inverse @ by_errors

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
        Motions (n, t - 1, 3), and the poses (n, t, 3) that follow from them, m and rad; headings
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

    def select(self, lines: IntArray) -> "State":
        """The state with some of its lines."""
        return replace(self, lines=self.lines[lines], anchors=self.anchors[lines])

    def moved(self, motions: FloatArray, lines: FloatArray, calibration: FloatArray) -> "State":
        """The state after changes of motions, lines and calibration. The poses follow."""
        motions = self.motions + motions
        poses = drive(self.poses[:, 0], motions)
        return State(
            motions, poses, self.lines + lines, self.anchors, self.calibration + calibration
        )


def make_problem(run: FilteredRun, prior: FloatArray | None = None) -> Problem:
    """Collect the measurements of a run.

    The standard deviation of ranges is taken to be at least 5 mm. Readings without a wall are left
    out, and old readings that a slow sensor repeats. ``prior`` is ``CALIBRATION_PRIOR`` if wheels,
    axle and bias are to be estimated, or None.
    """
    robot = run.robot
    noise = run.noise
    wheels = np.moveaxis(np.asarray(run.wheels, dtype=float), 0, 1)
    unknown = np.moveaxis(run.unknown, 0, 1)
    ranges = np.asarray(run.ranges, dtype=float)
    steps = run.first_step + np.arange(len(ranges))
    fresh = np.array([robot.measures(step) for step in steps.tolist()])[:, None]
    measured = fresh & np.isfinite(ranges) & run.usable
    sensor = run.sensor or RangeSensor(noise.range_std, cone=robot.cone)
    measured[..., list(sensor.broken)] = False
    ranges = sensor.corrected(ranges, robot)
    looked = measured & (ranges > robot.too_near)
    ticks = run.ticks
    if ticks is None:
        ticks = ticks_of(np.where(np.moveaxis(unknown, 0, 1), 0.0, np.moveaxis(wheels, 0, 1)))
    jitters = np.array([jitter_of(own, robot.axle) for own in ticks])
    jitters = np.tile(jitters[:, None], (1, len(ranges), 1, 1))
    std = max(noise.range_std, LEAST_RANGE_STD)
    covariances = slip_covariances(robot, std, wheels[:, 1:], ranges, measured)
    covariances[..., 1, 1] += ASIDE_STD**2
    variances = noise.wheel_variance * np.abs(wheels) + LEAST_VARIANCE + unknown
    by_wheels = _by_wheels(np.eye(2), robot.axle).T
    reported = (by_wheels * variances[:, 1:, None]) @ by_wheels.T
    motions = _by_wheels(wheels[:, 1:], robot.axle)
    turns = None
    if run.headings is not None:
        more = unknown.sum(axis=-1)
        table = np.array(
            [_turns(robot, noise, *own) for own in zip(run.headings.T, wheels, more, strict=True)]
        )
        motions[..., 2] = table[:, 1:, 0]
        turns = table[:, 1:, 2:4].copy()
        reported[..., 2, :] = reported[..., :, 2] = 0.0
        reported[..., 2, 2] = table[:, 1:, 1]
        jitters[..., 2, :] = jitters[..., :, 2] = 0.0
        jitters[..., 2, 2] = table[..., 4]
    covariances += reported
    if not run.first_step:  # see ``encoder_ticks.first_jitter``
        covariances[:, 0] += (by_wheels * tick_variances(ticks)[:, None]) @ by_wheels.T
    problem = Problem(
        robot=sensor.mounted(robot),
        starts=np.asarray(run.poses[0], dtype=float),
        motions=motions,
        roots=np.linalg.inv(np.linalg.cholesky(covariances)),
        jumps=np.zeros_like(motions),
        readings=_listed(looked & (ranges < robot.too_far), ranges),
        looks=_listed(looked, np.minimum(ranges, robot.max_ranges)),
        sensor=sensor,
        own_jitters=jitters,
        prior=prior,
        turns=turns,
    )
    for number, step in run.breaks:
        _break(problem, run, number, step)
    return problem


def _break(problem: Problem, run: FilteredRun, number: int, step: int) -> None:
    """Let a carried robot come to where the filter found it in a step: nothing was reported of that
    motion.

    The filter has found it by hundreds of readings, of which the associations of the run hold a few
    only.
    """
    poses = run.poses[step - 1 : step + 1, number].copy()
    before, after = run.covariances[step - 1 : step + 1, number]
    poses[1, 2] = poses[0, 2] + wrap_angle(float(poses[1, 2] - poses[0, 2]))
    place = (number, step - 1)
    problem.motions[place] = 0.0
    problem.jumps[place] = motions_between(poses)[0]
    if problem.turns is not None:
        problem.turns[place] = 0.0
    jacobian = motion_jacobians(poses)[0]
    both = block_diag(before, after + np.diag(FOUND_STDS**2))
    problem.roots[place] = np.linalg.inv(np.linalg.cholesky(jacobian @ both @ jacobian.T))


def _by_wheels(wheels: FloatArray, axle: float) -> FloatArray:
    """Motions (..., 3) by the travel (..., 2) of the wheels, m."""
    left = wheels[..., 0]
    right = wheels[..., 1]
    return np.stack((0.5 * (left + right), np.zeros_like(left), (right - left) / axle), axis=-1)


def _turns(
    robot: RobotSpec, noise: NominalNoise, yaw: FloatArray, wheels: FloatArray, more: FloatArray
) -> list[tuple[float, ...]]:
    """The turns (t, 5) of a robot by ``turn_meter.turns_of``: angle and its variance, what the
    heading sensor has measured and for how long, and the variance of the heading.
    """
    turns = turns_of(robot, noise, yaw, wheels, more)
    return [(each.angle, each.variance, each.measured, each.seconds, each.jitter) for each in turns]


def _listed(kept: BoolArray, ranges: FloatArray) -> Readings:
    """The ranges (t, n, n_beams) that are kept, in the order of poses."""
    number, step, beam = np.nonzero(np.moveaxis(kept, 0, 1))
    return Readings(number * len(ranges) + step, beam, ranges[step, number, beam])


def state_from_poses(poses: FloatArray) -> State:
    """A state without lines at poses (t, n, 3). The first pose is the known start; headings may be
    wrapped.
    """
    chains = np.moveaxis(np.asarray(poses, dtype=float), 0, 1).copy()
    chains[..., 2] = np.unwrap(chains[..., 2], axis=1)
    return state_from_motions(chains[:, 0], motions_between(chains))


def state_from_motions(starts: FloatArray, motions: FloatArray) -> State:
    """A state without lines, with motions (n, t - 1, 3) from starts (n, 3)."""
    nothing = np.zeros((0, 2))
    calibration = np.zeros((len(starts), len(CALIBRATION_PRIOR)))
    return State(motions, drive(starts, motions), nothing, nothing, calibration)


def expected(problem: Problem, state: State, labels: IntArray) -> Expected:
    """What each reading (k,) should be, given its line (k,). Those of readings without a line, -1,
    mean nothing.
    """
    places = problem.readings.places
    rows = np.empty((len(labels), 7))
    predict_readings(state.flat_poses, places, problem.beams, state.line_rows, labels, rows)
    bias, scale = state.calibration[places // problem.steps, 3:].T
    rows[:, :6] *= (1.0 + scale)[:, None]
    return Expected(rows[:, 0] + bias, rows[:, 1:4], rows[:, 4:6], rows[:, 6])
