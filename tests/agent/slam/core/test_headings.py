"""The heading of an inertial measurement unit beside wheels: turns, errors, consistency."""

import math
from dataclasses import replace

import numpy as np
import pytest

from limslam_agent import LimSlamAgent, Mapper, preset
from limslam_agent.config.presets import AgentConfig
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.replay.replay import Replay, replay_log
from limslam_agent.slam.core.late_ranges import WaitingTravel
from limslam_agent.slam.core.motion import HeadingCalibration, Motion, calibrated, steered
from limslam_agent.slam.core.turn_meter import LONGEST_GAP, Turn, TurnMeter, turns_of
from limslam_agent.slam.line_graph.motions import motions_between
from limslam_agent.slam.line_graph.problem import make_problem, state_from_poses
from limslam_agent.slam.line_graph.run import FilteredRun
from limslam_env import NoiseConfig, NominalNoise, RobotSpec
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import arc, compose, wrap_angle
from limslam_env.simulation.simulation import Simulation
from limslam_env.worlds.formats.loading import load_world

ROBOT = RobotSpec()
NOISE = NominalNoise(0.02)
STRAIGHT = np.array([0.02, 0.02])


def all_turns(yaw: list[float], wheels: FloatArray) -> list[Turn]:
    return turns_of(ROBOT, NOISE, np.array(yaw), np.broadcast_to(wheels, (len(yaw), 2)))


# Turns.


def test_the_turn_is_the_difference_of_headings_and_slip_of_the_wheels_does_not_enter() -> None:
    slipping = np.array([0.02, 0.024])
    turns = all_turns([3.1, 3.14, 3.18 - 2.0 * math.pi], slipping)
    assert turns[0].angle == pytest.approx(0.004 / ROBOT.axle)  # there is no difference yet
    assert [each.angle for each in turns[1:]] == pytest.approx([0.04, 0.04])
    assert turns[1].seconds == pytest.approx(ROBOT.control_period)
    assert turns[1].variance < 0.01 * turns[0].variance


def test_the_wheels_turn_in_a_gap_and_the_next_heading_corrects_all_of_it() -> None:
    slipping = np.array([0.02, 0.024])
    turns = all_turns([0.0, math.nan, math.nan, 0.03], slipping)
    assert [each.seconds for each in turns] == pytest.approx([0.0, 0.0, 0.0, 0.3])
    assert sum(each.angle for each in turns[1:]) == pytest.approx(0.03)
    assert turns[3].measured == pytest.approx(0.03)
    # The error of the wheels ends with the gap: it is jitter of the headings in between.
    assert turns[2].jitter > 1.9 * turns[1].jitter > 0.0
    assert turns[3].jitter < 0.01 * turns[1].jitter


def test_after_a_long_gap_the_turn_is_that_of_the_wheels_and_as_uncertain() -> None:
    steps = round(LONGEST_GAP / ROBOT.control_period) + 3
    turns = all_turns([0.0, *[math.nan] * steps, 1.0, 1.1], STRAIGHT)
    assert sum(each.angle for each in turns[:-1]) == 0.0
    by_wheels = NOISE.wheel_variance * 0.04 / ROBOT.axle**2
    assert sum(each.variance for each in turns[1:-1]) == pytest.approx(
        (steps + 1) * by_wheels, rel=0.1
    )
    assert turns[-1].angle == pytest.approx(0.1)


def test_a_heading_that_jumps_as_a_compass_near_iron_is_not_believed() -> None:
    turns = all_turns([0.0, 1.0, 1.05], STRAIGHT)
    assert [each.angle for each in turns] == pytest.approx([0.0, 0.0, 0.05])
    assert turns[1].seconds == 0.0


@pytest.mark.parametrize("turn", [1.0, -1.0, 3.0])
def test_a_fast_turn_of_the_wheels_is_no_jump(turn: float) -> None:
    wheels = 0.5 * turn * ROBOT.axle * np.array([-1.0, 1.0])
    turns = all_turns([0.0, 1.1 * turn, 2.2 * turn], wheels)
    assert turns[2].angle == pytest.approx(1.1 * turn)


def test_a_heading_that_is_repeated_is_no_new_one() -> None:
    true = 0.05 * np.arange(60)
    wheels = 0.5 * 0.05 * ROBOT.axle * np.array([-1.0, 1.0])
    turns = all_turns(np.repeat(true[::5], 5).tolist(), wheels)
    followed = np.cumsum([each.angle for each in turns])
    np.testing.assert_allclose(followed, true + 0.05)


def test_a_unit_that_does_not_work_is_not_used() -> None:
    turning = np.array([-0.01, 0.01])
    slow = np.array([0.02, 0.0205])
    for wheels in (turning, slow):
        turns = all_turns([1.0] * 40, wheels)
        expected = 40 * (wheels[1] - wheels[0]) / ROBOT.axle
        assert sum(each.angle for each in turns) == pytest.approx(expected)


def test_a_heading_in_coarse_steps_holds_a_straight_drive_against_the_wheels() -> None:
    """The wheels say that the robot turns by less than a step of the heading in a second."""
    slipping = np.array([0.02, 0.02008])
    step = math.radians(1.0)
    turns = all_turns([step, 0.0, *[0.0] * 100], slipping)
    assert abs(sum(each.angle for each in turns[1:])) < 1.5 * step


def test_a_standing_robot_shows_the_drift_and_does_not_turn() -> None:
    drift = math.radians(0.8)
    turns = all_turns([0.1 * drift * step for step in range(40)], np.zeros(2))
    shown = [each.drift for each in turns if each.drift is not None]
    assert len(shown) > 25
    assert shown == pytest.approx([drift] * len(shown))
    assert sum(abs(each.angle) for each in turns[15:]) == 0.0


def test_a_standing_robot_that_is_turned_turns() -> None:
    turns = all_turns([0.0] * 20 + [0.05, 0.10, 0.15], np.zeros(2))
    assert sum(each.angle for each in turns) == pytest.approx(0.15)


def test_the_steps_of_a_heading_are_jitter_that_does_not_add_up() -> None:
    step = math.radians(1.0)
    true = np.arange(60) * 0.37 * step
    turns = all_turns((np.round(true / step) * step).tolist(), STRAIGHT)
    assert turns[-1].jitter == pytest.approx(step**2 / 12.0)
    walked = sum(each.variance for each in turns[1:])
    assert walked == pytest.approx(NOISE.yaw_std**2 * 5.9 + step**2 / 12.0, rel=0.01)


@pytest.mark.parametrize("late", [0, 1, 3])
def test_headings_that_are_late_are_brought_up_to_date_by_the_wheels(late: int) -> None:
    rates = np.random.default_rng(1).choice([-0.1, 0.0, 0.1], 12).repeat(10)
    wheels = 0.5 * ROBOT.axle * rates[:, None] * (-1.0, 1.0) + 0.02
    noisy = wheels + np.random.default_rng(2).normal(0.0, 5e-4, wheels.shape)
    true = np.cumsum(rates)
    yaw = np.append(np.zeros(late), true)[: len(true)]
    turns = turns_of(ROBOT, NOISE, yaw, noisy)
    off = np.cumsum([each.angle for each in turns]) - true
    assert np.ptp(off[40:]) < 0.15
    meter = TurnMeter(ROBOT, NOISE)
    for each in zip(yaw.tolist(), noisy, strict=True):
        meter.step(*each)
    assert meter.lag == pytest.approx(late, abs=0.3)


def test_late_ranges_delay_the_heading_as_they_delay_the_wheels() -> None:
    waiting = WaitingTravel(1)
    told = []
    for step in range(8):
        seen = {"wheels": STRAIGHT, "yaw": float(wrap_angle(3.0 + 0.1 * step))}
        (late,) = waiting.synchronous([seen], 1.5)
        told.append(late["yaw"])
    assert np.isnan(told[:2]).all()
    np.testing.assert_allclose(told[2:], wrap_angle(3.0 + 0.1 * (np.arange(2, 8) - 1.5)))


# Derivatives.


def test_the_derivative_by_the_constant_errors_is_that_of_central_differences() -> None:
    wheels = np.array([0.05, 0.02])
    turn = Turn(0.4, 1e-6, measured=0.6, seconds=0.3)
    motion = steered(Motion(np.zeros(3), np.eye(3)), wheels, turn, NOISE)
    np.testing.assert_allclose(motion.increment, arc(0.035, 0.4))
    values = np.array([0.02, -0.03, 0.05])
    step = 1e-6

    def moved(errors: FloatArray) -> FloatArray:
        return calibrated(motion, ROBOT.axle, HeadingCalibration(*errors.tolist())).increment

    expected = [
        (moved(values + step * unit) - moved(values - step * unit)) / (2.0 * step)
        for unit in np.eye(3)
    ]
    found = calibrated(motion, ROBOT.axle, HeadingCalibration(*values.tolist())).by_calibration
    np.testing.assert_allclose(found, np.column_stack(expected), atol=1e-8)
    assert moved(values)[2] == pytest.approx(0.4 - 0.03 * 0.6 - 0.05 * 0.3)


def test_the_smoother_has_the_same_motions_and_derivatives() -> None:
    yaw = np.array([[0.0], [0.1], [math.nan], [0.3]])
    wheels = np.tile([[[0.02, 0.03]]], (4, 1, 1))
    ranges = np.full((4, 1, len(ROBOT.beams)), 0.5)
    poses = np.zeros((4, 1, 3))
    run = FilteredRun(
        ROBOT,
        NOISE,
        wheels,
        ranges,
        np.ones(ranges.shape, dtype=bool),
        poses,
        np.zeros((4, 1, 3, 3)),
        yaw=yaw,
    )
    problem = make_problem(run)
    values = np.array([[0.01, 0.02, 0.03, 0.0, 0.0]])
    turns = turns_of(ROBOT, NOISE, yaw[:, 0], wheels[:, 0])
    moved = [
        calibrated(
            steered(Motion(np.zeros(3), np.eye(3)), wheels[0, 0], turn, NOISE),
            ROBOT.axle,
            HeadingCalibration(*values[0, :3].tolist()),
        ).increment
        for turn in turns
    ]
    driven = np.zeros((1, 4, 3))
    for step, increment in enumerate(moved[1:], 1):
        driven[0, step] = compose(driven[0, step - 1], increment)
    reports, _, _ = problem.reports(motions_between(driven), values)
    np.testing.assert_allclose(reports, problem.motions, atol=1e-12)
    state = state_from_poses(poses)
    headings = problem.jitters(state)[0, :, 2, 2]
    np.testing.assert_allclose(headings, [each.jitter for each in turns])


# Observations.


@pytest.mark.parametrize("yaw", [0.1, np.float32(0.1), np.array(0.1), np.array([0.1]), math.nan])
def test_a_heading_may_be_a_number_or_an_array_of_one(yaw: object) -> None:
    mapper = Mapper(ROBOT)
    mapper.step({"wheels": np.zeros(2), "yaw": yaw})
    assert np.isfinite(mapper.poses).all()


@pytest.mark.parametrize("yaw", [math.inf, "north", np.zeros(2), np.zeros(0), [[1.0, 2.0]], {}, 1j])
def test_a_bad_heading_is_one_clear_error_and_changes_nothing(yaw: object) -> None:
    mapper = Mapper(ROBOT)
    agent = LimSlamAgent(ROBOT)
    agent.reset(np.zeros(3))
    observation = {"wheels": STRAIGHT, "yaw": yaw}
    for step in (mapper.step, agent.act):
        with pytest.raises(ValueError, match="yaw must be one number") as caught:
            step(observation)
        assert "\n" not in str(caught.value)
    np.testing.assert_array_equal(mapper.poses, np.zeros((1, 3)))


@pytest.mark.parametrize("name", ["paper", "odometry"])
def test_the_other_presets_turn_by_the_heading_too(name: str) -> None:
    mapper = Mapper(ROBOT, preset(name))
    for step in range(10):
        mapper.step({"wheels": np.array([0.02, 0.021]), "yaw": 1.0 + 0.001 * step})
    assert mapper.poses[0, 2] == pytest.approx(0.001 / ROBOT.axle + 0.009)


def test_the_heading_of_a_log_of_poses_is_named_as_not_used() -> None:
    log = drive(0, 2.0, NoiseConfig())
    assert log.true_pose is not None
    poses = replace(log, wheels=None, odometry=log.true_pose)
    assert len([note for note in poses.notes if "heading" in note]) == 1
    assert replace(poses).notes == poses.notes
    with pytest.raises(ValueError, match="yaw"):
        replace(log, yaw=np.full(len(log), math.inf))


# Drives.


def drive(seed: int, seconds: float, noise: NoiseConfig, stands: float = 0.0) -> RecordedLog:
    """A drive around the loop of a world, after standing for some seconds, with true headings."""
    world = load_world("env1")
    generator = np.random.default_rng(seed)
    simulation = Simulation(world, ROBOT)
    told = replace(noise, sensor_noise=0.02)
    readings, truth = simulation.reset(np.random.SeedSequence(seed), told, imu=True)
    rows = [(readings, truth.poses[0])]
    goal = 0
    for step in range(round(seconds / ROBOT.control_period)):
        action = (0.0, 0.0)
        if step * ROBOT.control_period >= stands:
            x, y, heading = truth.poses[0].tolist()
            way = np.array(world.loop[goal]) - (x, y)
            if np.hypot(*way) < 0.2:
                goal = (goal + 1) % len(world.loop)
            turn = float(wrap_angle(math.atan2(way[1], way[0]) - heading))
            ahead = 0.6 * max(math.cos(turn), 0.0)
            bend = max(-0.3, min(0.3, turn)) + 0.05 * generator.standard_normal()
            action = (ahead - bend, ahead + bend)
        readings, truth = simulation.step([action])
        rows.append((readings, truth.poses[0]))
    seen = [each for each, _ in rows]
    return RecordedLog(
        ROBOT,
        ROBOT.control_period * np.arange(float(len(rows))),
        np.array([each.ranges[0] for each in seen]),
        np.ones(len(rows), dtype=np.bool_),
        start_pose=rows[0][1],
        wheels=np.array([each.wheels[0] for each in seen], dtype=float),
        true_pose=np.array([pose for _, pose in rows]),
        yaw=np.array([each.yaw.item(0) for each in seen if each.yaw is not None], dtype=float),
    )


def config_of(name: str = "graph") -> AgentConfig:
    return preset(name, NOISE)


def error(log: RecordedLog, poses: FloatArray) -> float:
    """Root mean square of the distance from the true path, m."""
    assert log.true_pose is not None
    return float(np.sqrt(np.mean(np.sum((poses - log.true_pose)[:, :2] ** 2, axis=1))))


def drift_of(replay: Replay) -> tuple[float, float]:
    """The drift, rad/s, that a filter has found, and its standard deviation."""
    found = replay.self_calibration
    assert found is not None
    assert isinstance(found.factors, HeadingCalibration)
    return found.factors.drift, math.sqrt(found.covariance[2, 2])


@pytest.mark.parametrize(("name", "seeds"), [("slips", 4), ("carpet", 2)])
def test_a_heading_with_a_drift_helps_wheels_that_slip(name: str, seeds: int) -> None:
    noises = {
        "slips": NoiseConfig(slip_rate=0.3, yaw_drift=math.radians(0.5)),
        "carpet": NoiseConfig(axle_mismatch=0.1, yaw_drift=math.radians(-0.5)),
    }
    errors = []
    for seed in range(seeds):
        log = drive(seed, 60.0, noises[name])
        row = []
        for each in (replace(log, yaw=None), log):
            replay = replay_log(each, config_of())
            assert replay.smoothed is not None
            row.append((error(log, replay.estimated), error(log, replay.smoothed.poses)))
        errors.append(row)
    (by_wheels, smoothed_by_wheels), (filtered, smoothed) = np.median(errors, axis=0)
    assert filtered < 0.75 * by_wheels
    assert smoothed < 0.75 * smoothed_by_wheels


def test_a_drift_is_found_while_the_robot_stands_before_it_sees_anything_new() -> None:
    true = math.radians(1.0)
    log = drive(3, 20.0, NoiseConfig(yaw_drift=true), stands=20.0)
    replay = replay_log(log, config_of("consistent"))
    drift, std = drift_of(replay)
    assert drift == pytest.approx(true, abs=3.0 * std)
    assert std < math.radians(0.05)
    assert abs(replay.estimated[-1, 2] - replay.estimated[0, 2]) < math.radians(1.5)


def test_the_smoother_finds_the_drift_and_says_so_in_the_figures() -> None:
    log = drive(5, 60.0, NoiseConfig(yaw_drift=math.radians(0.7)))
    replay = replay_log(log, config_of())
    assert replay.smoothed is not None
    figures = replay.smoothed.figures
    assert figures["smoothed_yaw_drift_deg_per_s"] == pytest.approx(0.7, abs=0.05)
    assert replay.self_calibration is not None
    assert replay.self_calibration.words.startswith("heading of the IMU: drift 0.")


def test_headings_without_a_single_reading_change_nothing() -> None:
    log = drive(1, 20.0, NoiseConfig())
    without = replay_log(replace(log, yaw=None), config_of())
    empty = replay_log(replace(log, yaw=np.full(len(log), math.nan)), config_of())
    np.testing.assert_array_equal(empty.estimated, without.estimated)
    assert (empty.smoothed is None) == (without.smoothed is None)
    if empty.smoothed is not None and without.smoothed is not None:
        np.testing.assert_array_equal(empty.smoothed.poses, without.smoothed.poses)


def test_pose_and_drift_are_as_uncertain_as_the_filter_says() -> None:
    """Monte Carlo: the normalised squared error of the pose is 3 on average, of the drift 1."""
    generator = np.random.default_rng(0)
    poses = []
    drifts = []
    for seed in range(20):
        true = float(generator.normal(0.0, math.radians(0.5)))
        log = drive(100 + seed, 25.0, NoiseConfig(yaw_drift=true))
        assert log.true_pose is not None
        replay = replay_log(log, config_of("consistent"))
        off = replay.estimated - log.true_pose
        off[:, 2] = wrap_angle(off[:, 2])
        rows = [120, 180, 250]
        whitened = np.linalg.solve(replay.covariances[rows], off[rows, :, None])
        poses += np.sum(off[rows] * whitened[..., 0], axis=1).tolist()
        drift, std = drift_of(replay)
        drifts.append(((drift - true) / std) ** 2)
    assert 1.0 < np.mean(poses) < 5.0
    assert 0.3 < np.mean(drifts) < 2.5
