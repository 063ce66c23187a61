"""Motion and its covariance: wheels, odometry, ticks of encoders, late ranges, and contact."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limslam_agent import LineSlam, preset
from limslam_agent.config.shared import OdometryConfig
from limslam_agent.readings import unsteadiness
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.separate_bias import DELAY
from limslam_agent.slam.core.contact import LONGEST, Contacts, slip_covariance, slip_covariances
from limslam_agent.slam.core.encoder_ticks import jitter_of, tick_by, ticks_of
from limslam_agent.slam.core.late_ranges import WaitingTravel, ahead, behind, held_back
from limslam_agent.slam.core.motion import (
    Motion,
    OdometryCalibration,
    calibrated,
    motion_from_odometry,
    motion_from_wheels,
    motion_of,
)
from limslam_agent.slam.line_graph.run import FilteredRun
from limslam_agent.slam.line_graph.smoother import smooth_run
from limslam_env import NoiseConfig, NominalNoise, RobotSpec, World, metrics
from limslam_env.geometry import FloatArray, se2
from limslam_env.simulation.simulation import Simulation

ROBOT = RobotSpec()
NOISE = NominalNoise(0.0, 2e-5)
travels = st.floats(-0.06, 0.06)
metres = st.floats(-0.5, 0.5)


def exact_arc(wheels: FloatArray, axle: float) -> FloatArray:
    """Where the wheels take the robot, as textbooks draw it: a circle about a centre on the axle's
    line.
    """
    left, right = wheels
    turn = (right - left) / axle
    if abs(turn) < 1e-9:
        return np.array([0.5 * (left + right), 0.0, turn])
    radius = 0.5 * (left + right) / turn
    return np.array([radius * math.sin(turn), radius * (1.0 - math.cos(turn)), turn])


def numerical_jacobian(wheels: FloatArray, axle: float) -> FloatArray:
    """Central differences of the arc by the two wheels, (3, 2)."""
    step = 1e-5
    columns = [
        (exact_arc(wheels + step * unit, axle) - exact_arc(wheels - step * unit, axle))
        / (2.0 * step)
        for unit in np.eye(2)
    ]
    return np.column_stack(columns)


@settings(deadline=None, max_examples=100)
@given(travels, travels)
def test_wheels_move_the_robot_along_the_exact_arc(left: float, right: float) -> None:
    wheels = np.array([left, right])
    np.testing.assert_allclose(
        motion_from_wheels(wheels, ROBOT, NOISE).increment, exact_arc(wheels, 0.16), atol=1e-9
    )


@settings(deadline=None, max_examples=100)
@given(travels, travels)
def test_the_covariance_of_wheels_is_theirs_through_the_jacobian_of_the_arc(
    left: float, right: float
) -> None:
    wheels = np.array([left, right])
    by_wheels = numerical_jacobian(wheels, ROBOT.axle)
    expected = by_wheels @ np.diag(NOISE.wheel_variance * np.abs(wheels) + 1e-12) @ by_wheels.T
    covariance = motion_from_wheels(wheels, ROBOT, NOISE).covariance
    np.testing.assert_allclose(covariance, expected, rtol=1e-4, atol=1e-12)


@settings(deadline=None, max_examples=100)
@given(metres, st.floats(-0.1, 0.1), st.floats(-0.5, 0.5), st.floats(-0.1, 0.1))
def test_the_bias_is_made_up_for_in_proportion_to_the_distance(
    x: float, y: float, turn: float, bias: float
) -> None:
    motion = motion_from_odometry(np.array([x, y, turn]), OdometryConfig(turn_bias=bias))
    # The bias is true minus reported heading; its sign is that of the way driven.
    assert motion.increment[2] - turn == pytest.approx(
        bias * math.copysign(math.hypot(x, y), x), abs=1e-12
    )
    np.testing.assert_array_equal(motion.increment[:2], [x, y])


@pytest.mark.parametrize(
    "bad", [[math.nan, 0.0, 0.0], [0.0, 0.0, -math.inf], [0.1, 0.1], [0.1] * 4]
)
def test_odometry_that_is_not_three_finite_numbers_is_refused(bad: object) -> None:
    with pytest.raises(ValueError, match="odometry must be 3 finite numbers"):
        motion_of(
            {"ranges": np.zeros(6), "odometry": np.array(bad)}, ROBOT, NOISE, OdometryConfig()
        )


SIZES = OdometryCalibration(0.02, -0.01, 0.03)
QUIET = NominalNoise(0.0, 1e-9)


@pytest.mark.parametrize(
    "wheels", [(0.05, 0.03), (0.05, 0.047), (-0.04, -0.05), (-0.05, 0.05), (0.0, 0.0)]
)
def test_larger_wheels_on_a_wider_axle_are_a_robot_that_is_built_so(
    wheels: tuple[float, float],
) -> None:
    travel = np.array(wheels)
    motion = calibrated(motion_from_wheels(travel, ROBOT, NOISE), ROBOT.axle, SIZES)
    np.testing.assert_allclose(
        motion.increment, exact_arc(np.array([1.02, 0.99]) * travel, 1.03 * 0.16), atol=1e-12
    )


@pytest.mark.parametrize("wheels", [(0.05, 0.03), (-0.05, -0.03), (-0.05, 0.05)])
def test_the_derivative_by_the_factors_is_that_of_central_differences(
    wheels: tuple[float, float],
) -> None:
    motion = motion_from_wheels(np.array(wheels), ROBOT, QUIET)
    step = 1e-6
    at = np.array(SIZES)
    columns = [
        (
            calibrated(motion, 0.16, OdometryCalibration(*(at + step * unit))).increment
            - calibrated(motion, 0.16, OdometryCalibration(*(at - step * unit))).increment
        )
        / (2.0 * step)
        for unit in np.eye(3)
    ]
    np.testing.assert_allclose(
        calibrated(motion, 0.16, SIZES).by_calibration, np.column_stack(columns), atol=1e-9
    )


def test_a_turn_that_may_be_noise_says_nothing_of_the_axle() -> None:
    motion = motion_from_wheels(np.array([0.0251, 0.0249]), ROBOT, NOISE)
    by_calibration = calibrated(
        motion, ROBOT.axle, OdometryCalibration(0.0, 0.0, 0.0)
    ).by_calibration
    assert by_calibration is not None
    np.testing.assert_allclose(by_calibration[2], [-0.025 / 0.16, 0.025 / 0.16, 0.0], atol=1e-6)


@pytest.mark.parametrize("tick", [0.0003, 0.0023, 0.0102])
def test_a_tick_is_found_in_what_is_reported(tick: float) -> None:
    totals = np.cumsum(np.random.default_rng(0).normal(0.02, 0.01, (300, 1, 2)), axis=0)
    wheels = np.diff(np.floor(totals / tick) * tick, axis=0).astype(np.float32)
    np.testing.assert_allclose(ticks_of(wheels.astype(float)), tick, rtol=1e-3)


def test_exact_travels_have_no_tick_that_counts() -> None:
    assert ticks_of(np.random.default_rng(0).normal(0.02, 1e-4, (300, 1, 2))).max() < 1e-4


def test_travels_that_are_all_the_same_say_nothing_of_a_tick() -> None:
    tick = 0.0
    for _ in range(5):
        tick = tick_by(tick, 0.03)
    assert tick < 0.0
    assert not jitter_of(np.array([tick, tick]), 0.16).any()
    assert tick_by(tick, 0.02) == pytest.approx(0.01)


def test_a_wheel_that_stands_says_nothing_of_a_tick() -> None:
    assert ticks_of(np.array([0.03, 0.0, 0.03, 0.03, 0.0]).repeat(2).reshape(-1, 1, 2)).max() <= 0.0


def test_wheels_without_a_report_go_on_with_a_growing_variance() -> None:
    waiting = WaitingTravel(1, ROBOT)
    wheels = np.full((6, 2), 0.03)
    wheels[2:4] = np.nan
    wheels[4:] = 0.01
    seen = [waiting.synchronous([{"wheels": each}], 0.0)[0] for each in wheels]
    given = np.array([each["wheels"] for each in seen])
    np.testing.assert_allclose(given[:, 0], [0.03, 0.03, 0.03, 0.03, 0.01, 0.01])
    variances = [float(each.get("wheel_variances", np.zeros(2))[0]) for each in seen]
    once = unsteadiness(ROBOT)
    np.testing.assert_allclose(variances, [0.0, 0.0, once, 4.0 * once, 0.0, 0.0])


def test_the_jitter_is_the_covariance_of_parts_of_ticks() -> None:
    ticks = np.array([0.01, 0.004])
    axle = 0.2
    parts = np.random.default_rng(0).uniform(-0.5, 0.5, (20000, 2)) * ticks
    poses = np.array([se2.arc(*se2.wheels_to_arc(each, axle)) for each in parts])
    np.testing.assert_allclose(jitter_of(ticks, axle), np.cov(poses.T), rtol=0.03, atol=2e-7)


TRAVEL = np.random.default_rng(0).normal(0.03, 0.02, (40, 2, 2))


def told(travel, delays):
    """What is given of the travel (t, n, 2), step by step, and what waits after each step."""
    waiting = WaitingTravel(travel.shape[1])
    given = []
    waits = []
    for row, delay in zip(travel, delays, strict=True):
        seen = waiting.synchronous(
            [{"wheels": wheels, "ranges": np.ones(1)} for wheels in row], delay
        )
        given.append([each["wheels"] for each in seen])
        waits.append(waiting.travel)
    return np.array(given), np.array(waits)


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0, 2.7])
def test_travel_waits_for_so_many_steps(delay):
    given, waits = told(TRAVEL, [delay] * len(TRAVEL))
    np.testing.assert_allclose(given, held_back(TRAVEL, delay), atol=1e-15)
    np.testing.assert_allclose(waits, np.cumsum(TRAVEL - given, axis=0), atol=1e-15)
    whole = int(delay)
    share = delay - int(delay)
    expected = (1.0 - share) * TRAVEL[10 - whole] + share * TRAVEL[9 - whole]
    np.testing.assert_allclose(given[10], expected, atol=1e-15)


def test_no_travel_is_lost_when_the_delay_changes():
    given, waits = told(TRAVEL, [0.0] * 10 + [2.5] * 10 + [1.0] * 20)
    np.testing.assert_allclose(given.sum(axis=0) + waits[-1], TRAVEL.sum(axis=0), atol=1e-14)


def test_ahead_is_the_arc_of_the_travel_and_behind_leads_back():
    pose = np.array([1.0, 2.0, 0.5])
    axle = 0.2
    quarter = 0.25 * np.pi * axle
    # A quarter turn on the spot, and a quarter of a circle of radius 1 m to the left.
    np.testing.assert_allclose(
        ahead(pose, np.array([-quarter, quarter]), axle), [1.0, 2.0, 0.5 + 0.5 * np.pi]
    )
    turned = ahead(np.zeros(3), 0.5 * np.pi * np.array([0.9, 1.1]), axle)
    np.testing.assert_allclose(turned, [1.0, 1.0, 0.5 * np.pi], atol=1e-12)
    back = behind(ahead(pose, TRAVEL[:, 0], axle), TRAVEL[:, 0], axle)
    np.testing.assert_allclose(se2.wrap_angle(back - pose), np.zeros_like(back), atol=1e-12)


def test_a_clone_is_where_late_ranges_were_read():
    start = np.array([1.0, 2.0, 0.3])
    step = 0.03
    turn = 0.02
    ekf = CloneEKF(start, range_errors=(0.02, 0.05, 1.0))
    ekf.predict(Motion(se2.arc(step, turn), np.zeros((3, 3))))
    ekf.clone()
    late, early = (
        se2.compose(start, se2.arc((1.0 - delay) * step, (1.0 - delay) * turn))
        for delay in (0.1, -0.1)
    )
    np.testing.assert_allclose(ekf.by_errors[-3:, DELAY], (late - early) / 0.2, atol=5e-4)
    np.testing.assert_array_equal(ekf.by_errors[:3, DELAY], np.zeros(3))


STD = 0.02
NOISY = NominalNoise(0.02)
LEAST = 0.05
ALL = np.ones(6, dtype=bool)
RIGHT_OF_FRONT = 3  # at -15 degrees


def seen(near: float, beam: int = RIGHT_OF_FRONT) -> FloatArray:
    """Readings (6,), m, of which one is given."""
    ranges = np.full(6, 1.0)
    ranges[beam] = near
    return ranges


def variance_of(contacts: Contacts, ahead: float, near: float, beam: int = RIGHT_OF_FRONT) -> float:
    return contacts.slip(ahead, seen(near, beam), ALL)[0]


def test_a_robot_that_goes_on_towards_a_wall_slips() -> None:
    contacts = Contacts(ROBOT, STD)
    found = [variance_of(contacts, 0.02, near) for near in (0.12, 0.1, 0.08, *[LEAST] * 11)]
    # The first reading at the minimum only says that the wall is near.
    assert found[:4] == [0.0] * 4
    assert all(each > 0.0 for each in found[4:])
    slow = Contacts(ROBOT, STD)
    assert [variance_of(slow, 0.005, LEAST) for _ in range(4)] == [0.0] * 4
    driven = 10 * 0.02 * math.cos(ROBOT.beam_angles[RIGHT_OF_FRONT])
    free = np.linspace(0.0, LEAST, 10_001)
    assert sum(found) == pytest.approx(np.mean(np.maximum(driven - free, 0.0) ** 2), rel=1e-3)


def test_a_beam_that_reads_its_minimum_for_ever_soon_says_nothing() -> None:
    contacts = Contacts(ROBOT, STD)
    found = [variance_of(contacts, 0.02, 0.0) for _ in range(200)]
    assert math.sqrt(sum(found)) < LONGEST
    assert found[100:] == [0.0] * 100


def test_beams_to_the_sides_and_beams_that_cannot_measure_near_the_body_show_no_contact() -> None:
    blind = replace(ROBOT, beams=tuple(replace(beam, min_range=0.1) for beam in ROBOT.beams))
    for contacts, near, beam in (
        (Contacts(ROBOT, STD), LEAST, 0),
        (Contacts(blind, STD), 0.1, RIGHT_OF_FRONT),
    ):
        assert sum(variance_of(contacts, 0.02, near, beam) for _ in range(10)) < 1e-12


def test_the_smoother_allows_the_same_slip() -> None:
    ranges = np.array([*[seen(1.0)] * 9, *[seen(LEAST)] * 6])[:, None]
    wheels = np.full((1, len(ranges) - 1, 2), 0.02)
    slips = slip_covariances(ROBOT, STD, wheels, ranges, np.ones(ranges.shape, dtype=bool))[0]
    contacts = Contacts(ROBOT, STD)
    total = np.zeros((3, 3))
    contacts.slip(0.0, ranges[0, 0], ALL)
    for row in ranges[1:, 0]:
        total += slip_covariance(*contacts.slip(0.02, row, ALL))
    assert np.flatnonzero(slips[:, 0, 0]).tolist() == list(range(9, len(ranges) - 1))
    np.testing.assert_allclose(slips.sum(axis=0), total, atol=1e-15)


def bumping(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A robot that drives against the walls of a room, pushes for a second, and turns: ranges,
    wheels and poses.
    """
    walls = [[0, 0, 2.5, 0], [2.5, 0, 2.5, 2], [2.5, 2, 0, 2], [0, 2, 0, 0], [1.2, 0.0, 1.2, 0.5]]
    world = World("room", (2.5, 2.0), np.array(walls, dtype=float))
    simulation = Simulation(world, ROBOT, 1)
    generator = np.random.default_rng(seed)
    start = np.array([0.5, 1.0, generator.uniform(-0.4, 0.4)])
    readings, truth = simulation.reset(
        np.random.SeedSequence(seed), NoiseConfig(sensor_noise=STD), start
    )
    rows = [(readings.ranges[0], readings.wheels[0], truth.poses[0])]
    pushed = 0
    turning = 0
    for _ in range(250):
        pushed = pushed + 1 if (rows[-1][0][1:5] <= ROBOT.too_near[1:5]).any() else 0
        if pushed > 10:
            pushed = 0
            turning = int(generator.integers(8, 16))
        action = (-0.6, 0.6) if turning else (0.7, 0.7)
        turning = max(turning - 1, 0)
        readings, truth = simulation.step([action])
        rows.append((readings.ranges[0], readings.wheels[0], truth.poses[0]))
    ranges, wheels, poses = (np.array(each, dtype=float) for each in zip(*rows, strict=True))
    return ranges, wheels, poses


def consistency(seed: int) -> tuple[float, float]:
    """Mean NEES / 3 of the filter and of the smoothed path."""
    ranges, wheels, true = bumping(seed)
    slam = LineSlam(ROBOT, preset("consistent", NOISY), true[0])
    records = []
    slam.on_association = records.append
    poses = []
    covariances = []
    for row, travel in zip(ranges, wheels, strict=True):
        slam.step({"ranges": row, "wheels": travel})
        poses.append(slam.poses)
        covariances.append(slam.covariances)
    slam.finish()
    usable = np.ones((len(ranges), 1, 6), dtype=bool)
    run = FilteredRun(
        ROBOT,
        NOISY,
        wheels[:, None],
        ranges[:, None],
        usable,
        np.array(poses),
        np.array(covariances),
        records,
        slam.closures,
    )
    smoothed = smooth_run(run)
    assert smoothed is not None
    found = [(np.array(poses), np.array(covariances)), (smoothed.poses, smoothed.covariances)]
    filtered, finished = (
        metrics.consistency_metrics(true, each[:, 0], own[:, 0])["anees"] for each, own in found
    )
    return filtered, finished


def test_a_robot_that_pushes_against_walls_knows_how_uncertain_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    honest = np.array([consistency(seed) for seed in range(2)])
    monkeypatch.setattr(Contacts, "slip", lambda *_: (0.0, 0.0))
    blind = np.array([consistency(seed) for seed in range(2)])
    assert blind.mean(axis=0).min() > 10.0
    assert honest.mean(axis=0).max() < 3.0
