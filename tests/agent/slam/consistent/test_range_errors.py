"""Beams with an opening angle, and what the filter finds out about a sensor that is not as specified."""

import math
import re
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.drives import ROBOT, along, drive, ranges_at, room
from support.readings import Readings, expected_ranges, expected_rows

from limslam_agent import AgentConfig, Mapper, preset
from limslam_agent.config.consistent import ConsistentConfig, RangeErrorConfig
from limslam_agent.mapping import mapper as mapper_module
from limslam_agent.output.summary import record_summary, turn_records
from limslam_agent.slam.consistent.range_noise import RangeNoise
from limslam_agent.slam.consistent.separate_bias import DELAY, by_range_errors
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env import NominalNoise, Observation, RobotSpec
from limslam_env.geometry import FloatArray, se2

NOISE = 0.02
WALLS = np.vstack((room(-0.5, -0.5, 3.5, 2.5), room(0.5, 0.5, 2.5, 1.5)))
LAP = [(0.0, 0.0), (3.0, 0.0), (3.0, 2.0), (0.0, 2.0)]
ROUTE = along([*LAP, *LAP, (0.0, 0.0)])
CONE = math.radians(3.0)
LINE, ANCHOR = np.array([0.3, 0.4]), np.array([1.0, 0.5])


def one_reading(bearing: float, cone: float) -> Readings:
    none, sources = np.zeros(1), np.zeros((1, 2), dtype=int)
    return Readings(np.zeros(1, dtype=int), np.zeros((1, 2)), np.array([bearing]), none, sources, cone=cone)


def distance_to(line: FloatArray, bearing: float, cone: float, pose: FloatArray) -> float:
    """Range of one beam that meets a line."""
    return float(expected_ranges(pose[None], one_reading(bearing, cone), line, ANCHOR).ranges[0])


@settings(deadline=None, max_examples=100)
@given(st.floats(-1.2, 1.2), st.sampled_from([0.02, 0.1, 0.26]))
def test_the_derivatives_of_a_cone_equal_central_differences(slant: float, cone: float) -> None:
    if abs(abs(slant) - cone) < 1e-3:  # where the border ray becomes the perpendicular
        return
    pose, bearing, step = np.array([-0.5, 0.2, 0.3]), LINE[1] + slant - 0.3, 1e-5
    found = expected_ranges(pose[None], one_reading(bearing, cone), LINE, ANCHOR)
    rows = expected_rows(pose[None], one_reading(bearing, cone), LINE, ANCHOR)
    by_pose = [
        distance_to(LINE, bearing, cone, pose + each) - distance_to(LINE, bearing, cone, pose - each)
        for each in step * np.eye(3)
    ]
    by_line = [
        distance_to(LINE + each, bearing, cone, pose) - distance_to(LINE - each, bearing, cone, pose)
        for each in step * np.eye(2)
    ]
    wider = distance_to(LINE, bearing, cone + step, pose) - distance_to(LINE, bearing, cone - step, pose)
    np.testing.assert_allclose(found.by_pose[0], np.array(by_pose) / (2.0 * step), atol=1e-6)
    np.testing.assert_allclose(found.by_line[0], np.array(by_line) / (2.0 * step), atol=1e-6)
    turned = distance_to(LINE, bearing + step, cone, pose) - distance_to(LINE, bearing - step, cone, pose)
    by_errors = by_range_errors(rows, one_reading(bearing, cone).rows, pose[2:], float(LINE[1]), 1)
    assert not by_errors[:, DELAY].any()  # it acts by the poses
    by_errors = np.delete(by_errors, DELAY, axis=1)
    np.testing.assert_allclose(by_errors[0], [1.0, wider / (2.0 * step), turned / (2.0 * step)], atol=1e-6)


def counted(factor: float, growth: float, seed: int = 0) -> RangeNoise:
    """What is known after 60 segments of 20 readings with noise that is not as specified."""
    generator, noise = np.random.default_rng(seed), RangeNoise(RangeSensor(NOISE), 1.5, 0.005, 1.25)
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
        assert RangeSensor(found.std, found.growth).stds(np.array([distance]))[0] == pytest.approx(true, rel=0.2)


def observed(
    cone: float, seed: int, *, noise: float = NOISE, bias: float = 0.0, turns: tuple[float, ...] = ()
) -> tuple[list[Observation], FloatArray]:
    """Observations of a sensor along two laps, and the true poses."""
    generator = np.random.default_rng(seed)
    exact, poses = drive(WALLS, np.zeros(3), ROUTE)
    turned = [
        RangeSensor(NOISE, turns=tuple(share * cone + np.array(turns or np.zeros(len(ROBOT.beams))))).mounted(ROBOT)
        for share in np.linspace(-1.0, 1.0, 5)
    ]
    observations: list[Observation] = []
    for pose, seen in zip(poses, exact, strict=True):
        ranges = np.min([ranges_at(pose, WALLS, each) for each in turned], axis=0)
        read = ranges + bias + noise * generator.standard_normal(len(ranges))
        is_seen = ranges < ROBOT.max_ranges
        wheels = seen["wheels"] + np.sqrt(2e-5 * np.abs(seen["wheels"])) * generator.standard_normal(2)
        kept = np.where(is_seen, np.clip(read, ROBOT.min_ranges, ROBOT.max_ranges), ROBOT.max_ranges)
        observations.append({"ranges": kept, "wheels": wheels})
    return observations, poses


def config_of(*, enabled: bool = True) -> AgentConfig:
    config = preset("consistent", NominalNoise(NOISE))
    assert isinstance(config.estimator, ConsistentConfig)
    return replace(config, estimator=replace(config.estimator, range_errors=RangeErrorConfig(enabled=enabled)))


def mapped(
    observations: list[Observation], config: AgentConfig, robot: RobotSpec = ROBOT
) -> tuple[Mapper, FloatArray, FloatArray]:
    """The mapper after a drive, and its poses (t, 3) and covariances (t, 3, 3)."""
    mapper, poses, covariances = Mapper(robot, config), [], []
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


def test_turned_beams_are_found_and_named() -> None:
    turns = np.radians([3.0, -4.0, 3.0, -3.0, 4.0, -3.0])
    mapper, _, _ = mapped(observed(0.0, 3, turns=tuple(turns))[0], config_of())
    found = mapper.slam.beam_turns
    assert found is not None
    # The beams at the sides stand nearly perpendicular to their walls, and their ranges hardly tell their directions.
    np.testing.assert_allclose(found[1:5, 0], turns[1:5], atol=math.radians(1.2))
    result = {"record": {"beam_turns": turn_records(found)}, "config": {"robot": asdict(ROBOT)}}
    line = record_summary(result)[-1]
    assert re.search(r"^turned .*the beam at 45 deg by [345]\.\d \+- 0\.\d deg to the right, ", line)
    assert "turned" not in "".join(record_summary({**result, "metrics": {"status": "lost"}}))
    assert mapper.slam.mounted.beam_angles == pytest.approx(ROBOT.beam_angles + found[:, 0], abs=math.radians(1.0))


@pytest.mark.parametrize("delay", [1, 3])
def test_late_ranges_are_found_and_corrected(delay: int) -> None:
    observations, true = observed(0.0, 4)
    late = [observations[max(step - delay, 0)]["ranges"] for step in range(len(observations))]
    told = [{**seen, "ranges": ranges} for seen, ranges in zip(observations, late, strict=True)]
    mapper, _, _ = mapped(told, config_of())
    assert mapper.slam.range_sensor.delay == pytest.approx(delay, abs=0.2)
    assert np.hypot(*(mapper.poses[0] - true[-1])[:2]) < 0.1
    result = {"record": {"sensor": mapper.slam.range_sensor.found(RangeSensor(NOISE), ROBOT.control_period)}}
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
    sensor = mapper.slam.range_sensor
    assert sensor.broken == (beam,)
    assert mapper.statuses[0].level == "ok"
    assert np.hypot(*(mapper.poses[0] - true[-1])[:2]) < 0.1
    result = {"record": {"sensor": sensor.found(RangeSensor(NOISE), 0.1)}, "config": {"robot": asdict(ROBOT)}}
    named = f"the beam at {math.degrees(ROBOT.beam_angles[beam]):.4g} deg always reads the same"
    assert named in "".join(record_summary(result))


def test_a_beam_that_breaks_later_does_not_take_the_robot_back_to_its_start(monkeypatch) -> None:
    monkeypatch.setattr(mapper_module, "RESTART_WITHIN", 200)
    observations, true = observed(0.0, 5)
    for seen in observations[450:]:
        seen["ranges"][4] = 0.2
    mapper, _, _ = mapped(observations, config_of())
    assert mapper.slam.range_sensor.broken == (4,)
    assert np.hypot(*(mapper.poses[0] - true[-1])[:2]) < 0.1


def test_a_stated_opening_angle_keeps_the_filter_consistent() -> None:
    robot, squared, without = replace(ROBOT, cone=CONE), [], []
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


@pytest.mark.parametrize("cone", [-0.1, 1.0])
def test_an_impossible_opening_angle_is_refused(cone: float) -> None:
    with pytest.raises(ValueError, match="half the opening angle"):
        RobotSpec(cone=cone)
