"""Errors of sensors and of odometry that the consistent filter estimates while it drives."""

import json
import math
import re
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.command_line import limslam
from support.data import data_folder
from support.drives import FOUR_BEAMS, ROBOT, along, drive, laps_of_square, ranges_at, room
from support.readings import Readings, expected_rows, keep_clones, observe

from limslam_agent import AgentConfig, LineSlam, Mapper, preset, read_log, replay_log
from limslam_agent.config.consistent import (
    ConsistentConfig,
    RangeErrorConfig,
    SelfCalibrationConfig,
)
from limslam_agent.config.presets import self_calibrating
from limslam_agent.kernels.tables import line_at
from limslam_agent.mapping import mapper as mapper_module
from limslam_agent.output.summary import record_summary, sensor_record
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.range_noise import RangeNoise
from limslam_agent.slam.consistent.separate_bias import (
    DELAY,
    OdometryErrors,
    RangeErrors,
    SeenWall,
    by_range_errors,
)
from limslam_agent.slam.core.motion import (
    AS_SPECIFIED,
    OdometryCalibration,
    calibrated,
    motion_from_wheels,
)
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env import NominalNoise, Observation, RobotSpec
from limslam_env.geometry import FloatArray, se2

NOISE = 0.02
WALLS = np.vstack((room(-0.5, -0.5, 3.5, 2.5), room(0.5, 0.5, 2.5, 1.5)))
LAP = [(0.0, 0.0), (3.0, 0.0), (3.0, 2.0), (0.0, 2.0)]
ROUTE = along([*LAP, *LAP, (0.0, 0.0)])
CONE = math.radians(3.0)
LINE = np.array([0.3, 0.4])
ANCHOR = np.array([1.0, 0.5])
POSE = np.array([-0.5, 0.2, 0.3])


def expected_of(bearing: float, cone: float) -> tuple[Readings, FloatArray]:
    """A reading of a line by one beam, and what is expected of it (1, 7)."""
    sources = np.zeros((1, 2), dtype=int)
    none = np.zeros(1)
    reading = Readings(
        sources[:, 0], np.zeros((1, 2)), np.array([bearing]), none, sources, cone=cone
    )
    return reading, expected_rows(POSE[None], reading, LINE, ANCHOR)


@settings(deadline=None, max_examples=100)
@given(st.floats(-1.2, 1.2), st.sampled_from([0.02, 0.1, 0.26]))
def test_the_derivatives_by_errors_of_the_beams_equal_central_differences(
    slant: float, cone: float
) -> None:
    if abs(abs(slant) - cone) < 1e-3:  # where the border ray becomes the perpendicular
        return
    bearing = LINE[1] + slant - POSE[2]
    step = 1e-5
    reading, rows = expected_of(bearing, cone)
    ranges = [
        expected_of(bearing + turn, cone + wider)[1][0, 0]
        for turn, wider in ((0.0, step), (0.0, -step), (step, 0.0), (-step, 0.0))
    ]
    by_errors = by_range_errors(SeenWall(reading.rows, rows, POSE[2:], float(LINE[1])), 1)
    assert not by_errors[:, DELAY].any()  # it acts by the poses
    wanted = [1.0, *(np.subtract(ranges[::2], ranges[1::2]) / (2.0 * step))]
    np.testing.assert_allclose(np.delete(by_errors[0], DELAY), wanted, atol=1e-6)


def counted(factor: float, growth: float, seed: int = 0) -> RangeNoise:
    """What is known after 60 segments of 20 readings with noise that is not as specified."""
    generator = np.random.default_rng(seed)
    noise = RangeNoise(RangeSensor(NOISE), 1.5, 0.005, 1.25)
    for _ in range(60):
        ranges = generator.uniform(0.1, 1.4, 20)
        stds = np.hypot(factor * NOISE, growth * ranges**2)
        residuals = stds / NOISE * generator.standard_normal(20)
        residuals[generator.random(20) < 0.03] += 5.0  # readings of another object
        noise.count(residuals, ranges)
    return noise


@pytest.mark.parametrize("seed", range(2))
def test_noise_as_specified_gives_no_evidence(seed: int) -> None:
    assert counted(1.0, 0.0, seed).estimate.evidence < 0.0


@pytest.mark.parametrize(("factor", "growth"), [(2.0, 0.0), (0.5, 0.0), (0.5, 0.02)])
def test_other_noise_is_found(factor: float, growth: float) -> None:
    found = counted(factor, growth).estimate
    assert found.evidence > 50.0
    for distance in (0.4, 1.2):
        true = math.hypot(factor * NOISE, growth * distance**2)
        assert RangeSensor(found.std, found.growth).stds(np.array([distance]))[0] == pytest.approx(
            true, rel=0.2
        )


def observed(
    cone: float,
    seed: int,
    *,
    noise: float = NOISE,
    bias: float = 0.0,
    turns: tuple[float, ...] = (),
) -> tuple[list[Observation], FloatArray]:
    """Observations of a sensor along two laps, and the true poses."""
    generator = np.random.default_rng(seed)
    exact, poses = drive(WALLS, np.zeros(3), ROUTE)
    turned = [
        RangeSensor(
            NOISE, turns=tuple(share * cone + np.array(turns or np.zeros(len(ROBOT.beams))))
        ).mounted(ROBOT)
        for share in np.linspace(-1.0, 1.0, 5)
    ]
    observations: list[Observation] = []
    for pose, seen in zip(poses, exact, strict=True):
        ranges = np.min([ranges_at(pose, WALLS, each) for each in turned], axis=0)
        read = ranges + bias + noise * generator.standard_normal(len(ranges))
        is_seen = ranges < ROBOT.max_ranges
        wheels = seen["wheels"] + np.sqrt(
            2e-5 * np.abs(seen["wheels"])
        ) * generator.standard_normal(2)
        kept = np.where(
            is_seen, np.clip(read, ROBOT.min_ranges, ROBOT.max_ranges), ROBOT.max_ranges
        )
        observations.append({"ranges": kept, "wheels": wheels})
    return observations, poses


def config_of(*, enabled: bool = True) -> AgentConfig:
    config = preset("consistent", NominalNoise(NOISE))
    assert isinstance(config.estimator, ConsistentConfig)
    return replace(
        config, estimator=replace(config.estimator, range_errors=RangeErrorConfig(enabled=enabled))
    )


def mapped(
    observations: list[Observation], config: AgentConfig, robot: RobotSpec = ROBOT
) -> tuple[Mapper, FloatArray, FloatArray]:
    """The mapper after a drive, and its poses (t, 3) and covariances (t, 3, 3)."""
    mapper = Mapper(robot, config)
    poses = []
    covariances = []
    for seen in observations:
        mapper.step(seen)
        poses.append(mapper.poses[0])
        covariances.append(mapper.covariances[0])
    return mapper, np.array(poses), np.array(covariances)


def position_error(poses: FloatArray, true: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum((poses[:, :2] - true[:, :2]) ** 2, axis=1))))


def test_a_sensor_as_specified_keeps_its_drive_to_the_bit() -> None:
    observations, _ = observed(0.0, 0)
    mapper, poses, covariances = mapped(observations, config_of())
    assert mapper.slam.sensor == RangeSensor(NOISE)
    _, without, spread = mapped(observations, config_of(enabled=False))
    np.testing.assert_array_equal(poses, without)
    np.testing.assert_array_equal(covariances, spread)


def test_an_unknown_opening_angle_is_found_and_corrects_the_drive() -> None:
    observations, true = observed(CONE, 0)
    mapper, poses, _ = mapped(observations, config_of())
    assert mapper.slam.sensor is not None
    assert mapper.slam.sensor.cone == pytest.approx(CONE, abs=0.015)
    assert len(poses) == len(true)
    _, without, _ = mapped(observations, config_of(enabled=False))
    assert position_error(poses, true) < position_error(without, true)


def test_a_bias_is_no_opening_angle() -> None:
    sensor = mapped(observed(0.0, 2, bias=0.03)[0], config_of())[0].slam.sensor
    assert sensor is not None
    assert sensor.cone < 0.01


def test_ranges_that_are_too_long_by_a_share_are_named_and_leave_the_size_unknown() -> None:
    observations, true = observed(0.0, 2)
    for seen in observations:
        is_seen = seen["ranges"] < ROBOT.too_far
        seen["ranges"] = np.where(is_seen, 1.03 * seen["ranges"], seen["ranges"])
    mapper, poses, covariances = mapped(observations, config_of())
    assert mapper.slam.sensor.scale == pytest.approx(0.8 * 0.03, abs=0.006)
    # The readings cannot tell long ranges from large wheels, so far places are less certain.
    far = len(poses) // 2 + int(np.hypot(*true[len(poses) // 2 :, :2].T).argmax())
    distance = float(np.hypot(*true[far, :2]))
    along = true[far, :2] / distance
    assert math.sqrt(along @ covariances[far, :2, :2] @ along) > 0.008 * distance
    sensor = mapper.slam.sensor.found(RangeSensor(NOISE), ROBOT.control_period)
    (line,) = (each for each in record_summary({"record": {"sensor": sensor}}) if "sensor" in each)
    assert "the map may be 1.8 % too large or too small" in line


def test_what_shows_no_wall_is_not_corrected() -> None:
    robot = RobotSpec()
    sensor = RangeSensor(NOISE, bias=-0.05, scale=-0.02)
    ranges = np.array([robot.min_ranges[0], 0.06, 1.0, robot.max_ranges[0] - 0.01, np.inf, np.nan])
    found = sensor.corrected(ranges, robot)
    np.testing.assert_array_equal(found[[0, 4, 5]], ranges[[0, 4, 5]])
    assert found[2] == pytest.approx(1.05 / 0.98)
    assert found[3] < robot.too_far[0]
    short = RangeSensor(NOISE, bias=0.05).corrected(ranges, robot)
    assert short[1] > robot.too_near[0]
    assert sensor.true(sensor.reported(ranges))[2] == pytest.approx(1.0)


def test_turned_beams_are_found_and_named() -> None:
    turns = np.radians([3.0, -4.0, 3.0, -3.0, 4.0, -3.0])
    mapper, _, _ = mapped(observed(0.0, 3, turns=tuple(turns))[0], config_of())
    found = mapper.slam.beam_turns
    assert found is not None
    # The beams at the sides stand nearly perpendicular to their walls, and their ranges hardly tell
    # their directions.
    np.testing.assert_allclose(found[1:5, 0], turns[1:5], atol=math.radians(1.2))
    record = sensor_record(None, found, 0.01, ROBOT)
    result = {"record": record, "config": {"robot": asdict(ROBOT)}}
    line = record_summary(result)[-1]
    assert re.search(
        r"^turned .*the beam at 45 deg by [345]\.\d \+- 0\.\d deg to the right, ", line
    )
    assert "turned" not in "".join(record_summary({**result, "metrics": {"status": "lost"}}))
    assert mapper.slam.mounted.beam_angles == pytest.approx(
        ROBOT.beam_angles + found[:, 0], abs=math.radians(1.0)
    )


@pytest.mark.parametrize("delay", [1, 3])
def test_late_ranges_are_found_and_corrected(delay: int) -> None:
    observations, true = observed(0.0, 4)
    late = [observations[max(step - delay, 0)]["ranges"] for step in range(len(observations))]
    told = [{**seen, "ranges": ranges} for seen, ranges in zip(observations, late, strict=True)]
    mapper, _, _ = mapped(told, config_of())
    assert mapper.slam.sensor.delay == pytest.approx(delay, abs=0.2)
    assert np.hypot(*(mapper.poses[0] - true[-1])[:2]) < 0.1
    result = {
        "record": {"sensor": mapper.slam.sensor.found(RangeSensor(NOISE), ROBOT.control_period)}
    }
    (line,) = (line for line in record_summary(result) if line.startswith("sensor"))
    found = re.search(r"ranges are (\d\.\d\d) s later than the wheels", line)
    assert found is not None
    assert float(found[1]) == pytest.approx(delay * ROBOT.control_period, abs=0.03)


@pytest.mark.parametrize("reading", [0.2, math.inf], ids=["stuck", "dead"])
@pytest.mark.parametrize("beam", [0, 4])
def test_a_beam_that_always_reads_the_same_is_left_out_and_named(beam: int, reading: float) -> None:
    observations, true = observed(0.0, 5)
    for seen in observations:
        seen["ranges"][beam] = min(reading, float(ROBOT.max_ranges[beam]))
    mapper, _, _ = mapped(observations, config_of())
    sensor = mapper.slam.sensor
    assert sensor.broken == (beam,)
    assert mapper.statuses[0].level == "ok"
    assert np.hypot(*(mapper.poses[0] - true[-1])[:2]) < 0.1
    result = {
        "record": {"sensor": sensor.found(RangeSensor(NOISE), 0.1)},
        "config": {"robot": asdict(ROBOT)},
    }
    named = f"the beam at {math.degrees(ROBOT.beam_angles[beam]):.4g} deg always reads the same"
    assert named in "".join(record_summary(result))


def test_a_beam_that_breaks_later_does_not_take_the_robot_back_to_its_start(monkeypatch) -> None:
    monkeypatch.setattr(mapper_module, "RESTART_WITHIN", 200)
    observations, true = observed(0.0, 5)
    for seen in observations[450:]:
        seen["ranges"][4] = 0.2
    mapper, _, _ = mapped(observations, config_of())
    assert mapper.slam.sensor.broken == (4,)
    assert np.hypot(*(mapper.poses[0] - true[-1])[:2]) < 0.1


def test_a_stated_opening_angle_keeps_the_filter_consistent() -> None:
    robot = replace(ROBOT, cone=CONE)
    squared = []
    without = []
    for seed in range(4):
        observations, true = observed(CONE, 10 + seed)
        for each, found in ((robot, squared), (ROBOT, without)):
            _, poses, covariances = mapped(observations, config_of(enabled=False), each)
            off = poses[200:] - true[200:]
            off[:, 2] = se2.wrap_angle(off[:, 2])
            scaled = np.linalg.solve(covariances[200:], off[..., None])[..., 0]
            found.append(np.mean(np.sum(off * scaled, axis=1)))
    assert np.mean(squared) / 3.0 < 2.0
    assert np.mean(without) > 1.5 * np.mean(squared)


ROBOT = RobotSpec()
NOMINAL = NominalNoise(0.02)
QUIET = NominalNoise(0.0, 0.0)
TWO_WALLS = np.array([[0.6, 0.5 * math.pi], [-0.6, 0.5 * math.pi]])
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
        self.filters = filters
        self.true = true
        self.pose = np.zeros(3)
        self.generator = np.random.default_rng(seed)

    def move(self, left: float, right: float, assumed: OdometryCalibration) -> None:
        reported = motion_from_wheels(np.array([left, right]), ROBOT, QUIET)
        self.pose = se2.compose(self.pose, calibrated(reported, ROBOT.axle, self.true).increment)
        for ekf in self.filters:
            found = ekf.calibration()
            motion = calibrated(
                reported, ROBOT.axle, OdometryCalibration(*found[0]) if found else assumed
            )
            is_estimated = found is not None or ekf.calibration_evidence is not None
            ekf.predict(motion if is_estimated else replace(motion, by_calibration=None))

    def look(self, side: int) -> None:
        ranges = [range_to(self.pose, beam, TWO_WALLS[side]) for beam in SIDES[side]]
        ranges += SMALL * 0.02 * self.generator.standard_normal(len(ranges))
        for ekf in self.filters:
            clone = ekf.clone()
            if ekf.num_lines <= side:
                line = ekf.add_line(float(TWO_WALLS[side, 1]), np.array([0.0, TWO_WALLS[side, 0]]))
                part = slice(line_at(ekf.arrays.counts, line), line_at(ekf.arrays.counts, line) + 2)
                ekf.P[part, part] = SMALL**2 * np.eye(2)
            sources = np.array([[0, beam] for beam in SIDES[side]])
            readings = Readings(
                np.full(2, clone),
                ROBOT.beam_origins[SIDES[side]],
                ROBOT.beam_angles[SIDES[side]],
                ranges,
                sources,
            )
            observe(ekf, readings, side, SMALL * 0.02, 2, 0.0)
            if side == 1:
                keep_clones(ekf, set())

    def drive(self, assumed: OdometryCalibration = AS_SPECIFIED) -> None:
        for step in range(40):
            self.move(0.02, 0.021 + 0.01 * math.sin(0.3 * step), assumed)
            if step % 4 == 3:
                self.look(step // 4 % 2)


def test_the_filter_and_its_separate_bias_know_what_a_filter_with_the_bias_in_its_state_knows() -> (
    None
):
    separate = CloneEKF(np.zeros(3), PRIOR)
    joint = CloneEKF(np.zeros(3), PRIOR)
    joint.calibrate()
    Corridor([separate, joint], OdometryCalibration(2e-5, -1e-5, 3e-5)).drive()
    assert separate.calibration() is None
    separate.calibrate()
    for ekf in (separate, joint):
        assert ekf.calibration_evidence is None
    (found, covariance), (expected, expected_covariance) = (
        separate.calibration(),
        joint.calibration(),
    )  # type: ignore[misc]
    stds = np.sqrt(np.diag(expected_covariance))
    np.testing.assert_allclose(found / stds, expected / stds, atol=1e-3)
    np.testing.assert_allclose(
        covariance / np.outer(stds, stds), expected_covariance / np.outer(stds, stds), atol=1e-3
    )
    scale = np.sqrt(np.diag(joint.P))
    np.testing.assert_allclose((separate.x - joint.x) / scale, 0.0, atol=2e-3)
    np.testing.assert_allclose(
        separate.P / np.outer(scale, scale), joint.P / np.outer(scale, scale), atol=2e-3
    )
    np.testing.assert_allclose(separate.P, separate.P.T, rtol=1e-12)


def test_the_derivative_by_the_errors_is_that_of_filters_with_other_odometry() -> None:
    def state(ekf: CloneEKF, assumed: OdometryCalibration) -> FloatArray:
        Corridor([ekf], AS_SPECIFIED).drive(assumed)
        return ekf.x.copy()

    ekf = CloneEKF(np.zeros(3), PRIOR)
    state(ekf, AS_SPECIFIED)
    for column in range(3):
        above, below = (
            state(CloneEKF(np.zeros(3)), OdometryCalibration(*(step * np.eye(3)[column])))
            for step in (SMALL, -SMALL)
        )
        np.testing.assert_allclose(
            ekf.by_errors[:, column], (above - below) / (2.0 * SMALL), atol=2e-3
        )


def test_the_evidence_is_the_bayes_factor_of_the_two_hypotheses() -> None:
    generator = np.random.default_rng(1)
    prior = np.diag([1e-4, 4e-4, 9e-4])
    errors = OdometryErrors(1, prior)
    noise = 1e-4 * np.eye(15)
    jacobian = generator.normal(size=(15, 3))
    innovation = jacobian @ [0.05, 0.05, 0.05] + 0.01 * generator.normal(size=15)
    whitened = 100.0 * np.column_stack((jacobian, innovation, np.zeros(15)))
    for wall in range(3):
        errors.learn(whitened[5 * wall : 5 * wall + 5], wall)
    wide = noise + jacobian @ prior @ jacobian.T
    chi_squares = [innovation @ np.linalg.solve(each, innovation) for each in (noise, wide)]
    sizes = [np.linalg.slogdet(each)[1] for each in (noise, wide)]
    assert errors.evidence == pytest.approx(chi_squares[0] - chi_squares[1] + sizes[0] - sizes[1])


def seen_on_walls(innovations: FloatArray, bent: float) -> RangeErrors:
    """What walls say by whitened innovations (n, 8) of a turn of the only beam, if the walls are
    curved by a share of what such a beam would show.
    """
    errors = RangeErrors((0.02, 0.05, 1.0, 0.05))
    generator = np.random.default_rng(2)
    for wall, innovation in enumerate(innovations):
        by_turn = np.linspace(10.0, 60.0, 8)
        by_errors = np.column_stack((np.zeros((8, 3)), by_turn))
        noise = 0.1 * generator.normal(size=8)
        errors.learn(np.column_stack((by_errors, innovation + noise, bent * by_turn)), wall)
    return errors


def test_an_error_counts_if_several_walls_say_it() -> None:
    turned = np.tile(0.08 * np.linspace(10.0, 60.0, 8), (4, 1))
    assert seen_on_walls(turned, 0.0).turn_evidence > 12.0
    one_wall = np.array([[4.0], [0.0], [0.0], [0.0]]) * turned
    assert seen_on_walls(one_wall, 0.0).turn_evidence <= 0.0


def test_walls_that_are_curved_explain_what_a_turned_beam_does() -> None:
    signs = np.resize([1.0, -1.0], (12, 1))
    errors = seen_on_walls(signs * 0.08 * np.linspace(10.0, 60.0, 8), 0.4)
    curvature, evidence = errors.bend
    assert 0.1 < curvature < 0.5
    assert evidence > 12.0
    assert errors.turn_evidence < 0.0


def test_a_robot_in_a_round_room_believes_its_wheels_and_its_sensor() -> None:
    angles = np.linspace(0.0, 2.0 * math.pi, 49)
    ring = 2.0 * np.column_stack((np.cos(angles), np.sin(angles)))
    stops = [(1.2 * math.cos(angle), 1.2 * math.sin(angle)) for angle in angles[::8]]
    start = np.array([1.2, 0.0, 0.0])
    observations, _ = drive(
        np.hstack((ring[:-1], ring[1:])), start, along(2 * stops), FOUR_BEAMS, NOISE
    )
    mapper = Mapper(FOUR_BEAMS, preset("graph", NOMINAL), start)
    for seen in observations:
        mapper.step(seen)
    assert mapper.slam.sensor.bend > 0.0
    assert not mapper.slam.sensor.turns
    assert mapper.slam.odometry_calibrations == [None]


def uneven_laps(
    uneven: float, *, seed: int = 5, laps: float = 1.0
) -> tuple[list[Observation], FloatArray]:
    """Observations along the square with one wheel larger and the other smaller, and the true
    poses.
    """
    log = laps_of_square(0.02, seed=seed, laps=laps)
    counted = np.array([1.0 + 0.5 * uneven, 1.0 - 0.5 * uneven])
    return [
        {**seen, "wheels": (counted * seen["wheels"]).astype(np.float32)}
        for seen in log.observations
    ], log.poses


def test_a_robot_as_specified_is_estimated_as_if_nothing_were_calibrated() -> None:
    observations, poses = uneven_laps(0.0)
    plain, watching = (
        LineSlam(FOUR_BEAMS, self_calibrating(preset("consistent", NOMINAL), when), poses[0])
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
        observations, poses = uneven_laps(0.04, seed=seed)
        mapper = Mapper(
            FOUR_BEAMS, self_calibrating(preset("consistent", NOMINAL), "if_needed"), poses[0]
        )
        off = []
        for seen, true in zip(observations, poses, strict=True):
            mapper.step(seen)
            off.append(float(np.hypot(*(mapper.slam.pose - true)[:2])))
        errors.append(math.sqrt(np.mean(np.square(off))))
    assert np.median(errors) < 0.2


def test_a_mapper_finds_uneven_wheels_and_starts_again() -> None:
    uneven = 0.04
    observations, poses = uneven_laps(uneven)
    mapper, always = (
        Mapper(FOUR_BEAMS, self_calibrating(preset("consistent", NOMINAL), when), poses[0])
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
    found = mapper.slam.odometry_calibrations[0]
    assert found is not None
    turns = np.array([-1.0, 1.0, 0.0])
    std = math.sqrt(turns @ found[1] @ turns)
    assert turns @ np.array(found[0]) == pytest.approx(uneven, abs=4.0 * std)


def config(noise: float) -> AgentConfig:
    return self_calibrating(preset("consistent", NominalNoise(noise)), "always")


def test_each_robot_has_wheels_of_its_own() -> None:
    start: FloatArray = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    slam = LineSlam(FOUR_BEAMS, config(0.02), start)
    ranges = FOUR_BEAMS.max_ranges.astype(np.float32)
    for _ in range(10):
        slam.step(
            *(
                {"ranges": ranges, "wheels": np.full(2, travel, dtype=np.float32)}
                for travel in (0.02, 0.03)
            )
        )
    np.testing.assert_allclose(slam.poses, [[0.2, 0.0, 0.0], [1.3, 0.0, 0.0]], atol=1e-6)
    # Farther driven, less sure of where: each by its own wheels' size alone.
    # The noise alone would give a ratio of 1.5, and the size alone 2.25.
    assert slam.covariances[1][0, 0] > 1.8 * slam.covariances[0][0, 0]


@pytest.mark.slow
def test_a_real_robots_odometry_is_found_to_turn() -> None:
    log = read_log(data_folder() / "fr079" / "fr079_raw.clf.gz", [90, 54, 18, -18, -54, -90], 5.0)
    found = replay_log(log, config(0.02)).self_calibration
    assert found is not None
    figures = found.figures
    # Hand-checked relations say 0.99 deg/m.
    assert 0.6 < figures["self_calibration_turn_deg_per_m"] < 1.2
    assert figures["self_calibration_turn_std_deg_per_m"] < 0.2
    assert figures["self_calibration_scale"] == pytest.approx(1.0, abs=0.02)


def test_replay_tells_what_it_found(tmp_path: Path) -> None:
    table = tmp_path / "corridor.csv"
    rows = [f"{0.1 * step:.1f},{0.025 * step:.3f},0,0,0.8,0.9" for step in range(200)]
    table.write_text("\n".join(["t,x,y,theta,r_-90,r_90", *rows]) + "\n")
    (tmp_path / "settings.toml").write_text(
        '[agent.estimator.self_calibration]\ncalibrate = "always"\n'
    )
    config = ["--preset", "consistent", "--config", str(tmp_path / "settings.toml")]
    arguments = ["replay", str(table), *config, "--out", str(tmp_path / "out")]
    assert limslam(*arguments).returncode == 0
    metrics = json.loads((tmp_path / "out" / "result.json").read_text())["metrics"]
    assert abs(metrics["self_calibration_turn_deg_per_m"]) < 0.5
    assert 0.0 < metrics["self_calibration_turn_std_deg_per_m"] < 1.0
