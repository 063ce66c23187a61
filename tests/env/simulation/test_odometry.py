"""Wheel encoders: their noise and steps, and wheels that slip or stand elsewhere than the data
sheet says.
"""

import math

import numpy as np
import pytest

from limslam_env import LimSlamEnv, LimSlamParallelEnv, NoiseConfig, RobotSpec, World
from limslam_env.geometry import FloatArray, se2

ROBOT = RobotSpec()
SIDE = 60.0
# Large enough that no drive in here meets a wall before it means to.
HALL = World(
    "hall", (SIDE, SIDE), SIDE * np.array([[0, 0, 1, 0], [1, 0, 1, 1], [1, 1, 0, 1], [0, 1, 0, 0]])
)
MIDDLE = np.array([0.5 * SIDE, 0.5 * SIDE, 0.3])
TOP = ROBOT.max_wheel_speed * ROBOT.control_period


def drive(
    noise: NoiseConfig,
    actions: list[tuple[float, float]],
    seed: int = 0,
    start: FloatArray = MIDDLE,
) -> tuple[FloatArray, FloatArray, bool]:
    """What the wheels report (n, 2), the true poses (n + 1, 3), and whether the robot touches a
    wall at the end.
    """
    env = LimSlamEnv(HALL, noise=noise, coverage_goal=None)
    poses = [env.reset(seed=seed, options={"start": start})[1]["pose"]]
    wheels = []
    for action in actions:
        observation, *_, info = env.step(np.array(action))
        wheels.append(observation["wheels"])
        poses.append(info["pose"])
    return np.array(wheels, dtype=float), np.array(poses), info["collision"]


def travel_of(poses: FloatArray, axle: float) -> FloatArray:
    """The wheel travel (n, 2) of wheels ``axle`` apart that leads from each pose to the next."""
    turn = se2.wrap_angle(np.diff(poses[:, 2]))
    chord = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    ahead = chord * 0.5 * turn / np.sin(np.where(turn == 0.0, 1.0, 0.5 * turn))
    ahead = np.where(turn == 0.0, chord, ahead)
    return np.column_stack((ahead - 0.5 * turn * axle, ahead + 0.5 * turn * axle))


def test_the_simulation_s_wheels_err_apart_and_step_by_step():
    count = 10_000
    wheels, _, _ = drive(NoiseConfig(wheel_variance=2e-5), [(0.3, -0.3)] * count)
    errors = wheels - 0.3 * TOP * np.array([1.0, -1.0])
    variance = errors.var(axis=0) / (2e-5 * 0.3 * TOP)
    np.testing.assert_allclose(variance, 1.0, atol=5.0 * math.sqrt(2.0 / count))
    bound = 5.0 / math.sqrt(count)
    assert abs(np.corrcoef(errors.T)[0, 1]) < bound
    for side in range(2):
        assert abs(np.corrcoef(errors[:-1, side], errors[1:, side])[0, 1]) < bound


def test_the_simulation_carries_what_its_encoders_left_out():
    resolution = 0.004
    actions = [(0.11, -0.47)] * 500
    told, _, _ = drive(NoiseConfig(wheel_variance=0.0, encoder_resolution=resolution), actions)
    assert (told[:, 0] == 0.0).any(), "some steps are too small to be told"
    np.testing.assert_allclose(told / resolution, np.round(told / resolution), atol=1e-4)
    assert np.abs(np.cumsum(told - TOP * np.array(actions), axis=0)).max() <= resolution + 1e-5


def test_unequal_wheels_drive_as_before_and_only_report_otherwise():
    actions = [(0.5, 0.8)] * 30
    plain, true, _ = drive(NoiseConfig(wheel_variance=0.0), actions)
    uneven, also_true, _ = drive(NoiseConfig(wheel_variance=0.0, wheel_mismatch=-0.03), actions)
    np.testing.assert_array_equal(true, also_true)
    np.testing.assert_allclose(uneven, plain * [0.97, 1.03], rtol=1e-6)


def test_the_encoders_draw_alike_whatever_the_noise():
    # What follows in the run is not shifted by slips, steps or mismatches: its noise is that of the
    # plain run.
    actions = [(0.9, 0.4)] * 100
    plain, odd = (
        drive(noise, actions)[0]
        for noise in (
            NoiseConfig(wheel_variance=1e-5),
            NoiseConfig(wheel_variance=1e-5, slip_rate=5.0, axle_mismatch=0.02),
        )
    )
    np.testing.assert_array_equal(plain, odd)


def test_in_contact_the_encoders_go_on_reporting_the_wheels():
    start = np.array([SIDE - 0.15, 0.5 * SIDE, 0.0])
    wheels, poses, touches = drive(NoiseConfig(wheel_variance=0.0), [(1.0, 1.0)] * 10, start=start)
    assert touches
    np.testing.assert_allclose(wheels[-1], TOP, atol=1e-7)
    assert poses[-1, 0] == pytest.approx(SIDE - ROBOT.radius, abs=1e-3)


def test_a_slipping_robot_gets_less_far_and_reports_the_way_in_full():
    share = 0.4
    count = 400
    wheels, poses, _ = drive(
        NoiseConfig(wheel_variance=0.0, slip_rate=8.0, slip_share=share),
        [(1.0, 0.8)] * count,
        seed=3,
    )
    asked = TOP * np.array([1.0, 0.8])
    np.testing.assert_allclose(wheels, np.tile(asked, (count, 1)), atol=1e-8)
    driven = travel_of(poses, ROBOT.axle)
    slips = driven < asked * (1.0 - 0.5 * share)
    np.testing.assert_allclose(driven, np.where(slips, asked * (1.0 - share), asked), atol=1e-9)
    chances = 1.0 - np.exp(-8.0 * asked)
    np.testing.assert_allclose(slips.mean(axis=0), chances, atol=5.0 * math.sqrt(0.25 / count))
    assert (slips[:, 0] != slips[:, 1]).any(), "each wheel slips on its own"


def test_each_robot_slips_on_its_own():
    env = LimSlamParallelEnv(
        HALL, num_robots=2, noise=NoiseConfig(slip_rate=10.0, slip_share=1.0), coverage_goal=None
    )
    _, infos = env.reset(seed=0, options={"start": [(20.0, 20.0, 0.0), (40.0, 40.0, 0.0)]})
    moved = []
    for _ in range(200):
        before = [infos[name]["pose"] for name in env.agents]
        *_, infos = env.step(dict.fromkeys(env.agents, np.ones(2)))
        off = np.subtract([infos[name]["pose"] for name in env.agents], before)
        moved.append(np.hypot(*off[:, :2].T) > 0.0299)
    moved = np.array(moved)
    assert (moved[:, 0] & ~moved[:, 1]).any()
    assert (moved[:, 1] & ~moved[:, 0]).any()


def test_an_axle_mismatch_is_the_arc_of_the_true_axle():
    actions = np.random.default_rng(4).uniform(-1.0, 1.0, (100, 2))
    _, poses, _ = drive(
        NoiseConfig(axle_mismatch=0.08), [tuple(action) for action in actions.tolist()]
    )
    expected = MIDDLE
    for action, pose in zip(actions, poses[1:], strict=True):
        expected = se2.compose(
            expected, se2.arc(*se2.wheels_to_arc(TOP * action, 1.08 * ROBOT.axle))
        )
        np.testing.assert_allclose(pose[:2], expected[:2], atol=1e-9)
        assert abs(se2.wrap_angle(pose[2] - expected[2])) < 1e-9
