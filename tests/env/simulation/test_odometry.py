"""Wheel encoders: their noise and steps, and wheels that slip or stand elsewhere than the data sheet says."""

import math

import numpy as np
import pytest

from limslam_env import NoiseConfig, RobotSpec, World
from limslam_env.geometry import FloatArray, se2
from limslam_env.kernels.readings import reported_travel
from limslam_env.simulation.noise import noise_table
from limslam_env.simulation.simulation import Readings, Simulation, Truth

ROBOT = RobotSpec()
SIDE = 60.0
# Large enough that no drive in here meets a wall before it means to.
HALL = World("hall", (SIDE, SIDE), SIDE * np.array([[0, 0, 1, 0], [1, 0, 1, 1], [1, 1, 0, 1], [0, 1, 0, 0]]))
MIDDLE = np.array([0.5 * SIDE, 0.5 * SIDE, 0.3])
TOP = ROBOT.max_wheel_speed * ROBOT.control_period


def reports(travel: FloatArray, noise: NoiseConfig, seed: int = 0, limit: float = 0.06) -> FloatArray:
    """What the encoders say to a list of wheel travels (n, 2)."""
    table, generator = noise_table(vars(noise), ROBOT)[6:11], np.random.default_rng(seed)
    table[4] = limit
    told, untold = np.zeros(travel.shape), [0.0, 0.0]
    for row, normals in enumerate(generator.standard_normal(travel.shape)):
        for side in range(2):
            told[row, side], untold[side] = reported_travel(
                travel[row, side], untold[side], table[side], table[2], table[3], table[4], normals[side]
            )
    return told


def drive(
    noise: NoiseConfig, actions: list[tuple[float, float]], seed: int = 0, start: FloatArray = MIDDLE
) -> tuple[list[Readings], list[Truth]]:
    simulation = Simulation(HALL, ROBOT)
    results = [simulation.reset(np.random.SeedSequence(seed), noise, start)]
    results += [simulation.step([action]) for action in actions]
    readings, truths = zip(*results, strict=True)
    return list(readings), list(truths)


def wheels_of(readings: list[Readings]) -> FloatArray:
    return np.array([reading.wheels[0] for reading in readings[1:]], dtype=float)


def poses_of(truths: list[Truth]) -> FloatArray:
    return np.array([truth.poses[0] for truth in truths])


def travel_of(poses: FloatArray, axle: float) -> FloatArray:
    """The wheel travel (n, 2) of wheels ``axle`` apart that leads from each pose to the next."""
    turn = se2.wrap_angle(np.diff(poses[:, 2]))
    chord = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    ahead = chord * 0.5 * turn / np.sin(np.where(turn == 0.0, 1.0, 0.5 * turn))
    ahead = np.where(turn == 0.0, chord, ahead)
    return np.column_stack((ahead - 0.5 * turn * axle, ahead + 0.5 * turn * axle))


def test_the_simulation_s_wheels_err_apart_and_step_by_step():
    count = 10_000
    readings, _ = drive(NoiseConfig(wheel_variance=2e-5), [(0.3, -0.3)] * count)
    errors = wheels_of(readings) - 0.3 * TOP * np.array([1.0, -1.0])
    variance = errors.var(axis=0) / (2e-5 * 0.3 * TOP)
    np.testing.assert_allclose(variance, 1.0, atol=5.0 * math.sqrt(2.0 / count))
    bound = 5.0 / math.sqrt(count)
    assert abs(np.corrcoef(errors.T)[0, 1]) < bound
    for side in range(2):
        assert abs(np.corrcoef(errors[:-1, side], errors[1:, side])[0, 1]) < bound


def test_the_simulation_carries_what_its_encoders_left_out():
    resolution, actions = 0.004, [(0.11, -0.47)] * 500
    readings, _ = drive(NoiseConfig(wheel_variance=0.0, encoder_resolution=resolution), actions)
    told = wheels_of(readings)
    assert (told[:, 0] == 0.0).any(), "some steps are too small to be told"
    np.testing.assert_allclose(told / resolution, np.round(told / resolution), atol=1e-4)
    assert np.abs(np.cumsum(told - TOP * np.array(actions), axis=0)).max() <= resolution + 1e-5


def test_unequal_wheels_drive_as_before_and_only_report_otherwise():
    actions = [(0.5, 0.8)] * 30
    plain, true = drive(NoiseConfig(wheel_variance=0.0), actions)
    uneven, also_true = drive(NoiseConfig(wheel_variance=0.0, wheel_mismatch=-0.03), actions)
    np.testing.assert_array_equal(poses_of(true), poses_of(also_true))
    np.testing.assert_allclose(wheels_of(uneven), wheels_of(plain) * [0.97, 1.03], rtol=1e-6)


def test_a_report_is_clipped_to_the_limit_and_the_rest_comes_later():
    found = reports(np.array([[0.1, -0.1], [0.01, 0.0], [0.0, 0.0]]), NoiseConfig(wheel_variance=0.0), limit=0.06)
    np.testing.assert_allclose(found, [[0.06, -0.06], [0.05, -0.04], [0.0, 0.0]], atol=1e-12)


def test_the_encoders_draw_alike_whatever_the_noise():
    # What follows in the run is not shifted by slips, steps or mismatches: its noise is that of the plain run.
    actions = [(0.9, 0.4)] * 100
    plain, odd = (
        drive(noise, actions)[0]
        for noise in (
            NoiseConfig(wheel_variance=1e-5),
            NoiseConfig(wheel_variance=1e-5, slip_rate=5.0, axle_mismatch=0.02),
        )
    )
    np.testing.assert_array_equal(wheels_of(plain), wheels_of(odd))


def test_in_contact_the_encoders_go_on_reporting_the_wheels():
    start = np.array([SIDE - 0.15, 0.5 * SIDE, 0.0])
    readings, truths = drive(NoiseConfig(wheel_variance=0.0), [(1.0, 1.0)] * 10, start=start)
    assert truths[-1].contact[0]
    np.testing.assert_allclose(wheels_of(readings)[-1], TOP, atol=1e-7)
    assert truths[-1].poses[0, 0] == pytest.approx(SIDE - ROBOT.radius, abs=1e-3)


def test_a_slipping_robot_gets_less_far_and_reports_the_way_in_full():
    share, count = 0.4, 400
    readings, truths = drive(
        NoiseConfig(wheel_variance=0.0, slip_rate=8.0, slip_share=share), [(1.0, 0.8)] * count, seed=3
    )
    asked = TOP * np.array([1.0, 0.8])
    np.testing.assert_allclose(wheels_of(readings), np.tile(asked, (count, 1)), atol=1e-8)
    driven = travel_of(poses_of(truths), ROBOT.axle)
    slips = driven < asked * (1.0 - 0.5 * share)
    np.testing.assert_allclose(driven, np.where(slips, asked * (1.0 - share), asked), atol=1e-9)
    chances = 1.0 - np.exp(-8.0 * asked)
    np.testing.assert_allclose(slips.mean(axis=0), chances, atol=5.0 * math.sqrt(0.25 / count))
    assert (slips[:, 0] != slips[:, 1]).any(), "each wheel slips on its own"


def test_each_robot_slips_on_its_own():
    simulation = Simulation(HALL, ROBOT, 2)
    starts = np.array([[20.0, 20.0, 0.0], [40.0, 40.0, 0.0]])
    simulation.reset(np.random.SeedSequence(0), NoiseConfig(slip_rate=10.0, slip_share=1.0), starts)
    moved = []
    for _ in range(200):
        before = starts
        starts = simulation.step([(1.0, 1.0)] * 2)[1].poses
        moved.append(np.hypot(*(starts - before)[:, :2].T) > 0.0299)
    moved = np.array(moved)
    assert (moved[:, 0] & ~moved[:, 1]).any()
    assert (moved[:, 1] & ~moved[:, 0]).any()


def test_an_axle_mismatch_is_the_arc_of_the_true_axle():
    actions = np.random.default_rng(4).uniform(-1.0, 1.0, (100, 2))
    _, truths = drive(NoiseConfig(axle_mismatch=0.08), [tuple(action) for action in actions.tolist()])
    expected = MIDDLE
    for action, pose in zip(actions, poses_of(truths)[1:], strict=True):
        expected = se2.compose(expected, se2.arc(*se2.wheels_to_arc(TOP * action, 1.08 * ROBOT.axle)))
        np.testing.assert_allclose(pose[:2], expected[:2], atol=1e-9)
        assert abs(se2.wrap_angle(pose[2] - expected[2])) < 1e-9
