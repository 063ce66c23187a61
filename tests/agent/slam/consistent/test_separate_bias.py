"""Constant errors that are estimated beside the filter: as if they had been in its state, and only where needed."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.drives import FOUR_BEAMS, laps_of_square
from support.readings import Readings, keep_clones, observe

from limslam_agent import LineSlam, Mapper, preset
from limslam_agent.config.consistent import SelfCalibrationConfig
from limslam_agent.config.presets import self_calibrating
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.clone_filter import line_at
from limslam_agent.slam.consistent.separate_bias import OdometryErrors
from limslam_agent.slam.core.motion import AS_SPECIFIED, OdometryCalibration, calibrated, motion_from_wheels
from limslam_env import NominalNoise, Observation, RobotSpec
from limslam_env.geometry import FloatArray, se2

ROBOT, NOISE, QUIET = RobotSpec(), NominalNoise(0.02), NominalNoise(0.0, 0.0)
WALLS = np.array([[0.6, 0.5 * math.pi], [-0.6, 0.5 * math.pi]])
SIDES = ([0, 1], [4, 5])
# So small that no curvature counts: the filters are compared where they are linear.
SMALL = 1e-5
PRIOR = SMALL**2 * SelfCalibrationConfig().covariance / 1e-4


def range_to(pose: FloatArray, beam: int, line: FloatArray) -> float:
    """The exact range of a beam to an endless wall (r, theta)."""
    origin = se2.transform_points(pose, ROBOT.beam_origins[[beam]])[0]
    heading = pose[2] + ROBOT.beam_angles[beam]
    normal = np.array([math.cos(line[1]), math.sin(line[1])])
    return float((line[0] - normal @ origin) / (normal @ [math.cos(heading), math.sin(heading)]))


class Corridor:
    """A drive between two walls by filters that get the same motions and readings."""

    def __init__(self, filters: list[CloneEKF], true: OdometryCalibration, seed: int = 0) -> None:
        self.filters, self.true, self.pose = filters, true, np.zeros(3)
        self.generator = np.random.default_rng(seed)

    def move(self, left: float, right: float, assumed: OdometryCalibration) -> None:
        reported = motion_from_wheels(np.array([left, right]), ROBOT, QUIET)
        self.pose = se2.compose(self.pose, calibrated(reported, ROBOT.axle, self.true).increment)
        for ekf in self.filters:
            found = ekf.calibration()
            motion = calibrated(reported, ROBOT.axle, OdometryCalibration(*found[0]) if found else assumed)
            is_estimated = found is not None or ekf.calibration_evidence is not None
            ekf.predict(motion if is_estimated else replace(motion, by_calibration=None))

    def look(self, side: int) -> None:
        ranges = [range_to(self.pose, beam, WALLS[side]) for beam in SIDES[side]]
        ranges += SMALL * 0.02 * self.generator.standard_normal(len(ranges))
        for ekf in self.filters:
            clone = ekf.clone()
            if ekf.num_lines <= side:
                line = ekf.add_line(float(WALLS[side, 1]), np.array([0.0, WALLS[side, 0]]))
                part = slice(line_at(ekf.arrays.counts, line), line_at(ekf.arrays.counts, line) + 2)
                ekf.P[part, part] = SMALL**2 * np.eye(2)
            sources = np.array([[0, beam] for beam in SIDES[side]])
            readings = Readings(
                np.full(2, clone), ROBOT.beam_origins[SIDES[side]], ROBOT.beam_angles[SIDES[side]], ranges, sources
            )
            observe(ekf, readings, side, SMALL * 0.02, 2, 0.0)
            if side == 1:
                keep_clones(ekf, set())

    def drive(self, assumed: OdometryCalibration = AS_SPECIFIED) -> None:
        for step in range(40):
            self.move(0.02, 0.021 + 0.01 * math.sin(0.3 * step), assumed)
            if step % 4 == 3:
                self.look(step // 4 % 2)


def test_the_filter_and_its_separate_bias_know_what_a_filter_with_the_bias_in_its_state_knows() -> None:
    separate, joint = CloneEKF(np.zeros(3), PRIOR), CloneEKF(np.zeros(3), PRIOR)
    joint.calibrate()
    Corridor([separate, joint], OdometryCalibration(2e-5, -1e-5, 3e-5)).drive()
    assert separate.calibration() is None
    separate.calibrate()
    for ekf in (separate, joint):
        assert ekf.calibration_evidence is None
    (found, covariance), (expected, expected_covariance) = separate.calibration(), joint.calibration()  # type: ignore[misc]
    stds = np.sqrt(np.diag(expected_covariance))
    np.testing.assert_allclose(found / stds, expected / stds, atol=1e-3)
    np.testing.assert_allclose(covariance / np.outer(stds, stds), expected_covariance / np.outer(stds, stds), atol=1e-3)
    scale = np.sqrt(np.diag(joint.P))
    np.testing.assert_allclose((separate.x - joint.x) / scale, 0.0, atol=2e-3)
    np.testing.assert_allclose(separate.P / np.outer(scale, scale), joint.P / np.outer(scale, scale), atol=2e-3)
    np.testing.assert_allclose(separate.P, separate.P.T, rtol=1e-12)


def test_the_derivative_by_the_errors_is_that_of_filters_with_other_odometry() -> None:
    def state(ekf: CloneEKF, assumed: OdometryCalibration) -> FloatArray:
        Corridor([ekf], AS_SPECIFIED).drive(assumed)
        return ekf.x.copy()

    ekf = CloneEKF(np.zeros(3), PRIOR)
    state(ekf, AS_SPECIFIED)
    for column in range(3):
        above, below = (
            state(CloneEKF(np.zeros(3)), OdometryCalibration(*(step * np.eye(3)[column]))) for step in (SMALL, -SMALL)
        )
        np.testing.assert_allclose(ekf.by_errors[:, column], (above - below) / (2.0 * SMALL), atol=2e-3)


def test_the_evidence_is_the_bayes_factor_of_the_two_hypotheses() -> None:
    generator, prior = np.random.default_rng(1), np.diag([1e-4, 4e-4, 9e-4])
    errors, jacobian = OdometryErrors(1, prior), generator.normal(size=(5, 3))
    innovation, noise = 0.02 * generator.normal(size=5), 1e-4 * np.eye(5)
    errors.learn(100.0 * jacobian, 100.0 * innovation)
    wide = noise + jacobian @ prior @ jacobian.T
    chi_squares = [innovation @ np.linalg.solve(each, innovation) for each in (noise, wide)]
    sizes = [np.linalg.slogdet(each)[1] for each in (noise, wide)]
    assert errors.evidence == pytest.approx(chi_squares[0] - chi_squares[1] + sizes[0] - sizes[1])


def observed(uneven: float, *, seed: int = 5, laps: float = 1.0) -> tuple[list[Observation], FloatArray]:
    """Observations along the square with one wheel larger and the other smaller, and the true poses."""
    log = laps_of_square(0.02, seed=seed, laps=laps)
    counted = np.array([1.0 + 0.5 * uneven, 1.0 - 0.5 * uneven])
    return [{**seen, "wheels": (counted * seen["wheels"]).astype(np.float32)} for seen in log.observations], log.poses


def test_a_robot_as_specified_is_estimated_as_if_nothing_were_calibrated() -> None:
    observations, poses = observed(0.0)
    plain, watching = (
        LineSlam(FOUR_BEAMS, self_calibrating(preset("consistent", NOISE), when), poses[0])
        for when in ("never", "if_needed")
    )
    for seen in observations:
        plain.step(seen)
        watching.step(seen)
        np.testing.assert_array_equal(watching.pose, plain.pose)
        np.testing.assert_array_equal(watching.covariance, plain.covariance)
    assert watching.odometry_calibrations == [None]


def test_a_robot_with_uneven_wheels_knows_its_way() -> None:
    errors = []
    for seed in (5, 6, 7):
        observations, poses = observed(0.04, seed=seed)
        mapper, off = Mapper(FOUR_BEAMS, self_calibrating(preset("consistent", NOISE), "if_needed"), poses[0]), []
        for seen, true in zip(observations, poses, strict=True):
            mapper.step(seen)
            off.append(float(np.hypot(*(mapper.slam.pose - true)[:2])))
        errors.append(math.sqrt(np.mean(np.square(off))))
    assert np.median(errors) < 0.2


def test_a_mapper_finds_uneven_wheels_and_starts_again() -> None:
    uneven = 0.04
    observations, poses = observed(uneven)
    mapper, always = (
        Mapper(FOUR_BEAMS, self_calibrating(preset("consistent", NOISE), when), poses[0])
        for when in ("if_needed", "always")
    )
    slams = [mapper.slam]
    for seen in observations:
        mapper.step(seen)
        always.step(seen)
        if mapper.slam is not slams[-1]:
            slams.append(mapper.slam)
    assert len(slams) == 2
    # What was mapped before is mapped again, and nothing of it is left.
    np.testing.assert_array_equal(mapper.slam.pose, always.slam.pose)
    np.testing.assert_array_equal(mapper.slam.segments, always.slam.segments)
    np.testing.assert_array_equal(mapper.grid.values, always.grid.values)
    found = mapper.slam.odometry_calibration
    assert found is not None
    turns, std = np.array([-1.0, 1.0, 0.0]), math.sqrt(np.array([-1, 1, 0]) @ found[1] @ np.array([-1, 1, 0]))
    assert turns @ np.array(found[0]) == pytest.approx(uneven, abs=4.0 * std)
