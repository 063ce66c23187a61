"""The offline optimum: against the truth, another solver and its own covariance; and what it refuses."""

import json
import math
import sys
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import count

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu
from support.command_line import call

from limslam_agent.cli.main import main
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.results import score
from limslam_agent.runs.run_config import RunConfig
from limslam_env.bounds import offline_optimum, optimum_solver
from limslam_env.bounds.offline_optimum import solve_optimum
from limslam_env.bounds.optimum_model import (
    Readings,
    expected_readings,
    fitted_lines,
    increment_jacobians,
    increments,
    motion_jacobians,
    motions_between,
    usable_readings,
    walk,
)
from limslam_env.config import NoiseConfig
from limslam_env.geometry.line import nearest_form, through
from limslam_env.geometry.se2 import arc, compose, wheels_to_arc, wrap_angle
from limslam_env.interface import RobotSpec, beams_on_rim
from limslam_env.simulation.simulation import Simulation
from limslam_env.worlds.formats.loading import load_world

needs_gtsam = pytest.mark.skipif(find_spec("gtsam") is None, reason="needs gtsam, the extra limits")

FOUR_BEAMS = RobotSpec(beams=beams_on_rim((90.0, 45.0, -45.0, -90.0), 0.10))
WHEEL_VARIANCE = 2e-5
SPEED = 0.25
SQUARE = load_world("square")


@dataclass(frozen=True)
class Log:
    """A drive: a row a step."""

    robot: RobotSpec
    poses: np.ndarray
    wheels: np.ndarray
    ranges: np.ndarray
    wall_seen: np.ndarray
    contact: np.ndarray

    def optimum(self, noise=0.0, *, guess=None, contact=None):
        return solve_optimum(
            self.robot, self.poses if guess is None else guess, self.wheels, self.ranges, self.wall_seen,
            range_std=noise, wheel_variance=WHEEL_VARIANCE, contact=contact,
        )  # fmt: skip


def driven(steer, robot=FOUR_BEAMS, noise=0.0, seed=0, *, wheel_variance=WHEEL_VARIANCE, start=None, robots=1):
    """The log of a drive; ``steer`` is told the true poses and gives the actions, or None at the end."""
    simulation = Simulation(SQUARE, robot, robots)
    settings = NoiseConfig(sensor_noise=noise, wheel_variance=wheel_variance)
    rows = [simulation.reset(np.random.SeedSequence(seed), settings, start)]
    while (actions := steer(rows[-1][1].poses)) is not None:
        rows.append(simulation.step(actions))
    return Log(
        robot,
        np.array([truth.poses for _, truth in rows]),
        np.array([readings.wheels for readings, _ in rows]),
        np.array([readings.ranges for readings, _ in rows]),
        np.array([truth.wall_seen for _, truth in rows]),
        np.array([truth.contact for _, truth in rows]),
    )


def towards(pose, goal, robot):
    """Wheel speeds that bring a true pose to a point at 0.25 m/s."""
    error = wrap_angle(math.atan2(goal[1] - pose[1], goal[0] - pose[0]) - pose[2])
    most = 2.0 * (robot.max_wheel_speed - SPEED) / robot.axle
    difference = 0.5 * robot.axle * min(max(2.0 * error, -most), most)
    return (SPEED - difference) / robot.max_wheel_speed, (SPEED + difference) / robot.max_wheel_speed


def round_the_loop(robot, laps=1, robots=1, steps=math.inf):
    """Each robot round the square's waypoints, the second from the third of them on; for no more than some steps."""
    taken = count()
    routes = [np.tile(np.roll(SQUARE.loop, -1 - 2 * number, axis=0), (laps, 1)).tolist() for number in range(robots)]

    def steer(poses):
        for route, pose in zip(routes, poses, strict=True):
            while route and math.hypot(route[0][0] - pose[0], route[0][1] - pose[1]) < 0.3:
                route.pop(0)
        if not all(routes) or next(taken) >= steps:
            return None
        return [towards(pose, route[0], robot) for route, pose in zip(routes, poses, strict=True)]

    return steer


def laps_of_square(noise, seed=0, laps=1, robot=FOUR_BEAMS, steps=math.inf, **settings):
    return driven(round_the_loop(robot, laps, settings.get("robots", 1), steps), robot, noise, seed, **settings)


def for_steps(count, action):
    """The same action of one robot, for some steps."""
    remaining = iter(range(count))
    return lambda _poses: [action] if next(remaining, None) is not None else None


def ate(poses, true):
    return float(np.sqrt(np.mean(np.sum((poses - true)[..., :2] ** 2, axis=-1))))


def heading_rmse(poses, true):
    return math.degrees(np.sqrt(np.mean(wrap_angle((poses - true)[..., 2]) ** 2)))


def central_differences(function, at, step=1e-6):
    """Derivatives (..., of ``at``) of a function of an array."""
    columns = []
    for index in np.ndindex(at.shape):
        change = np.zeros_like(at)
        change[index] = step
        columns.append((function(at + change) - function(at - change)) / (2.0 * step))
    return np.stack(columns, axis=-1)


MOTIONS = [(0.02, 0.03, 0.001), (0.025, 0.025, 0.0), (-0.02, 0.02, -0.004), (0.0, 0.0, 0.0), (0.3, -0.1, 0.05)]


@pytest.mark.parametrize("motion", MOTIONS)
def test_derivatives_of_increments(motion):
    motion = np.array(motion)
    expected = central_differences(lambda values: increments(values, 0.16), motion)
    np.testing.assert_allclose(increment_jacobians(motion, 0.16), expected, atol=1e-8)


@pytest.mark.parametrize("motion", MOTIONS)
def test_derivatives_of_motions(motion):
    before = np.array([0.7, -1.2, 2.9])
    poses = walk(before[None], np.array([[motion]]), 0.16)
    by_before, by_after = motion_jacobians(poses, np.array([[motion]]), 0.16)
    both = central_differences(lambda values: motions_between(values[:, None], 0.16)[0, 0], poses[:, 0])
    np.testing.assert_allclose(np.hstack((by_before[0, 0], by_after[0, 0])), both, atol=2e-8)


def readings_of(many, generator):
    number = np.zeros(many, dtype=np.intp)
    places, angles = generator.uniform(-0.1, 0.1, (many, 2)), generator.uniform(-2.0, 2.0, many)
    return Readings(number, number, number, np.ones(many), places, angles)


def test_derivatives_of_readings():
    generator, many = np.random.default_rng(4), 40
    readings = readings_of(many, generator)
    poses, anchors = generator.uniform(-3.0, 3.0, (many, 3)), generator.uniform(-3.0, 3.0, (many, 2))
    turn = generator.uniform(-1.3, 1.3, many)
    lines = np.column_stack((generator.uniform(-0.2, 0.2, many), poses[:, 2] + readings.angle + turn))
    found = expected_readings(poses, lines, anchors, readings)
    for row in range(many):
        one = readings.where(np.arange(many) == row)
        by_pose = central_differences(
            lambda pose, row=row, one=one: expected_readings(
                pose[None], lines[[row]], anchors[[row]], one
            ).distance[0], poses[row]
        )  # fmt: skip
        by_line = central_differences(
            lambda line, row=row, one=one: expected_readings(
                poses[[row]], line[None], anchors[[row]], one
            ).distance[0], lines[row]
        )  # fmt: skip
        np.testing.assert_allclose(found.by_pose[row], by_pose, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(found.by_line[row], by_line, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.cosine, np.cos(turn))


def test_a_reading_worked_out_by_hand():
    # A robot at (1, 2) that looks along y; a beam at its front edge, 45 degrees to the right; the line x = 2.
    one = np.zeros(1, dtype=np.intp)
    reading = Readings(one, one, one, np.ones(1), np.array([[0.1, 0.0]]), np.array([-0.25 * math.pi]))
    pose, line, anchor = np.array([[1.0, 2.0, 0.5 * math.pi]]), np.array([[0.5, 0.0]]), np.array([[1.5, 7.0]])
    assert expected_readings(pose, line, anchor, reading).distance[0] == pytest.approx(math.sqrt(2.0))


def test_a_walk_is_the_arcs_that_the_agent_composes_and_back():
    generator = np.random.default_rng(1)
    motions = np.append(generator.uniform(-0.03, 0.03, (50, 2, 2)), np.zeros((50, 2, 1)), axis=-1)
    poses = walk(np.array([[1.0, 2.0, 3.0], [0.0, -1.0, -2.0]]), motions, 0.16)
    for robot in range(2):
        pose = poses[0, robot]
        for wheels in motions[:, robot, :2]:
            pose = compose(pose, arc(*wheels_to_arc(wheels, 0.16)))
        np.testing.assert_allclose(poses[-1, robot, :2], pose[:2], atol=1e-12)
        assert wrap_angle(float(poses[-1, robot, 2] - pose[2])) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(motions_between(poses, 0.16), motions, atol=1e-12)


def test_only_readings_that_measured_a_wall_count():
    slow = replace(FOUR_BEAMS.beams[0], period=2)
    robot = replace(FOUR_BEAMS, beams=(slow, *FOUR_BEAMS.beams[1:]))
    ranges = np.ones((3, 1, 4))
    ranges[0, 0, 1], ranges[0, 0, 2] = 1.5, 0.05  # saw nothing, and too near to measure
    walls = np.full((3, 1, 4), 7)
    walls[1, 0, 3], walls[2, 0, 3] = -2, -1
    walls[2, 0, 1] = 4
    readings, names = usable_readings(robot, ranges, walls)
    beams = [(0, 90), (0, -90), (1, 45), (1, -45), (2, 90), (2, 45), (2, -45)]
    assert list(zip(readings.step.tolist(), np.degrees(readings.angle).round().tolist(), strict=True)) == beams
    assert names.tolist() == [4, 7]
    assert names[readings.line].tolist() == [7, 7, 7, 7, 7, 4, 7]


@pytest.mark.parametrize("seed", range(8))
def test_the_first_guess_of_a_short_edge_is_not_the_noise_along_the_beams(seed):
    # 10 cm of a wall at y = 1, seen slantwise with 4 cm of noise.
    generator, many = np.random.default_rng(seed), 60
    x, number = np.linspace(-0.05, 0.05, many), np.zeros(many, dtype=np.intp)
    angle = np.full(many, math.radians(50.0))
    poses = np.column_stack((x - 1.0 / math.tan(angle[0]), np.zeros(many), np.zeros(many)))[:, None]
    distance = 1.0 / math.sin(angle[0]) + 0.04 * generator.standard_normal(many)
    readings = Readings(np.arange(many), number, number, distance, np.zeros((many, 2)), angle)
    _, lines = fitted_lines(poses, readings, 1, 0.04)
    assert abs(math.cos(lines[0, 1] - angle[0])) > 0.2


@needs_gtsam
def test_without_noise_the_optimum_is_the_truth():
    log = laps_of_square(0.0, wheel_variance=0.0)
    optimum = log.optimum()
    assert optimum.is_converged
    # As exact as float32 readings are, summed up over a lap.
    np.testing.assert_allclose(optimum.poses[..., :2], log.poses[..., :2], atol=2e-5)
    assert optimum.chi_square < 1e-3
    assert optimum.walls.tolist() == list(range(8))
    # Two of them pass through the origin, where (r, theta) alone would be a bad choice.
    for wall, line in zip(optimum.walls, optimum.lines, strict=True):
        true = through(SQUARE.edges[wall, :2], SQUARE.edges[wall, 2:])
        np.testing.assert_allclose(nearest_form(line, true), true, atol=2e-5)


@needs_gtsam
def test_the_guess_chooses_nothing_but_the_valley():
    log = laps_of_square(0.02, steps=300)
    from_truth = log.optimum(0.02)
    odometry = walk(log.poses[0], np.append(log.wheels[1:], np.zeros_like(log.wheels[1:, :, :1]), axis=-1), 0.16)
    assert ate(odometry, log.poses) > 0.03
    from_odometry = log.optimum(0.02, guess=odometry)
    assert from_truth.is_converged
    assert from_odometry.is_converged
    # Lines far outside of what was read are held by a hair, from where they began.
    np.testing.assert_allclose(from_odometry.poses, from_truth.poses, atol=2e-5)


@needs_gtsam
def test_another_solver_finds_the_same_optimum():
    """Wheels alone are the unknowns, so that nothing is aside; residuals in plain Python; dense, by differences."""
    log = laps_of_square(0.02, seed=3, steps=24)
    optimum = log.optimum(0.02)
    steps = len(log.wheels) - 1
    beams = [
        (row, beam, wall)
        for row, walls in enumerate(log.wall_seen[:, 0].tolist())
        for beam, wall in enumerate(walls)
        if wall >= 0 and log.ranges[row, 0, beam] < 1.49
    ]
    walls = sorted({wall for *_, wall in beams})

    def path(wheels):
        poses = [log.poses[0, 0]]
        for pair in wheels:
            poses.append(compose(poses[-1], arc(*wheels_to_arc(pair, 0.16))))
        return np.array(poses)

    def residuals(values):
        wheels, lines = values[: 2 * steps].reshape(-1, 2), values[2 * steps :].reshape(-1, 2)
        poses, measured = path(wheels), log.wheels[1:, 0].astype(float)
        found = ((wheels - measured) / np.sqrt(WHEEL_VARIANCE * np.abs(measured) + 1e-12)).ravel().tolist()
        for row, beam, wall in beams:
            (x, y, heading), (r, theta) = poses[row], lines[walls.index(wall)]
            phi = heading + log.robot.beams[beam].angle
            x, y = x + 0.1 * math.cos(phi), y + 0.1 * math.sin(phi)
            should = (r - x * math.cos(theta) - y * math.sin(theta)) / math.cos(theta - phi)
            found.append((log.ranges[row, 0, beam] - should) / 0.02)
        return np.array(found)

    lines = [through(SQUARE.edges[wall, :2], SQUARE.edges[wall, 2:]) for wall in walls]
    begin = np.concatenate((log.wheels[1:].ravel(), np.ravel(lines)))
    other = least_squares(residuals, begin, xtol=1e-14, ftol=1e-14, gtol=1e-14, x_scale="jac")
    np.testing.assert_allclose(optimum.poses[:, 0], path(other.x[: 2 * steps].reshape(-1, 2)), atol=2e-5)
    assert optimum.chi_square == pytest.approx(2.0 * other.cost, rel=1e-4)


@needs_gtsam
def test_residuals_are_as_large_as_assumed():
    optimum = laps_of_square(0.02, seed=1).optimum(0.02)
    assert optimum.is_converged
    # The standard deviation of chi-square over its degrees of freedom is 0.03 for these 2400.
    assert optimum.degrees_of_freedom > 2000
    assert optimum.chi_square / optimum.degrees_of_freedom == pytest.approx(1.0, abs=0.1)


@needs_gtsam
def test_two_robots_share_the_walls():
    log = laps_of_square(0.02, robot=RobotSpec(), robots=2, steps=300)
    both = log.optimum(0.02)
    assert both.is_converged
    assert both.poses.shape == log.poses.shape
    assert both.chi_square / both.degrees_of_freedom == pytest.approx(1.0, abs=0.15)
    odometry = walk(log.poses[0], np.append(log.wheels[1:], np.zeros_like(log.wheels[1:, :, :1]), axis=-1), 0.16)
    for robot in range(2):
        assert ate(both.poses[:, robot], log.poses[:, robot]) < 0.5 * ate(odometry[:, robot], log.poses[:, robot])
    # They drive the two halves of the loop: alone, one sees fewer walls.
    alone = replace(
        log, poses=log.poses[:, :1], wheels=log.wheels[:, :1], ranges=log.ranges[:, :1], wall_seen=log.wall_seen[:, :1]
    ).optimum(0.02)
    assert set(alone.walls) < set(both.walls)


@needs_gtsam
def test_wheels_in_contact_do_not_drag_the_optimum_along():
    # Straight into the lower wall, aslant: it slides, and its wheels say that it went on.
    log = driven(for_steps(60, (0.8, 0.8)), noise=0.02, start=np.array([3.0, 0.5, -1.0]))
    assert log.contact.sum() > 30
    told, untold = log.optimum(0.02, contact=log.contact), log.optimum(0.02)
    assert told.is_converged
    assert np.abs(told.poses - log.poses)[..., 1].max() < 0.05
    assert untold.chi_square > 3.0 * told.chi_square


@needs_gtsam
def test_the_same_log_gives_the_same_numbers_to_the_bit():
    log = laps_of_square(0.04, steps=120)
    first, second = log.optimum(0.04), log.optimum(0.04)
    assert first.poses.tobytes() == second.poses.tobytes()
    assert first.lines.tobytes() == second.lines.tobytes()


@needs_gtsam
@pytest.mark.parametrize("rows", [1, 2])
def test_a_log_of_hardly_a_step(rows):
    log = laps_of_square(0.02, steps=rows - 1)
    optimum = log.optimum(0.02)
    assert optimum.is_converged
    np.testing.assert_allclose(optimum.poses, log.poses, atol=0.01)


SHORT = driven(for_steps(3, (0.5, 0.5)))


@needs_gtsam
@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"wheels": SHORT.wheels[:-1]}, r"guess must have the shape \(3, 1, 3\)"),
        ({"wheels": SHORT.wheels[:, 0]}, r"wheels must be \(steps, robots, 2\), not \(4, 2\)"),
        ({"wheels": SHORT.wheels[:0]}, "wheels must be"),
        ({"ranges": SHORT.ranges[..., :3]}, r"ranges must have the shape \(4, 1, 4\)"),
        ({"wall_seen": SHORT.wall_seen[:2]}, "wall_seen must have the shape"),
        ({"poses": SHORT.poses[..., :2]}, "guess must have the shape"),
        ({"ranges": np.full_like(SHORT.ranges, np.nan)}, "ranges hold a number that is not finite"),
        ({"wheels": np.full_like(SHORT.wheels, np.inf)}, "wheels hold a number that is not finite"),
        ({"wall_seen": np.full_like(SHORT.wall_seen, -1)}, "no beam has measured a wall"),
        ({"ranges": np.full_like(SHORT.ranges, 1.5)}, "no beam has measured a wall"),
    ],
)
def test_a_log_that_cannot_be_is_refused(changes, reason):
    with pytest.raises(ValueError, match=reason) as caught:
        replace(SHORT, **changes).optimum()
    assert "\n" not in str(caught.value)


@needs_gtsam
@pytest.mark.parametrize("noise", [-0.01, math.nan, math.inf])
def test_noise_that_cannot_be_is_refused(noise):
    with pytest.raises(ValueError, match="range_std must be a number of 0 or more"):
        SHORT.optimum(noise)
    with pytest.raises(ValueError, match="contact must have the shape"):
        SHORT.optimum(contact=np.zeros(3, dtype=bool))


def test_without_gtsam_nothing_is_driven(monkeypatch):
    monkeypatch.setattr(offline_optimum, "find_spec", lambda _name: None)
    with pytest.raises(ValueError, match=r"pip install 'limslam\[limits\]'"):
        RunConfig(limit=True)
    with pytest.raises(ValueError, match=r"pip install 'limslam\[limits\]'"):
        SHORT.optimum()
    assert not RunConfig().limit


def test_without_gtsam_the_command_says_so_in_a_line(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "gtsam", None)
    result = call(main, "run", "--limit", "--out", tmp_path / "run")
    assert result.returncode == 2
    assert result.stderr.splitlines() == [
        "limslam: the offline optimum needs gtsam, which is not installed: pip install 'limslam[limits]'"
    ]
    assert list(tmp_path.iterdir()) == []


@needs_gtsam
def test_the_command_writes_both_metrics(tmp_path):
    drive = ("--world", "square", "--laps", "1", "--noise", "0.02", "--max-time", "20")
    result = call(main, "run", *drive, "--limit", "--out", tmp_path / "run")
    assert result.returncode == 0, result.stderr
    written = json.loads((tmp_path / "run" / "result.json").read_text())
    metrics = written["metrics"]
    assert 0.0 < metrics["limit_ate_m"] < 0.1
    assert metrics["ate_over_limit"] == pytest.approx(metrics["ate_m"] / metrics["limit_ate_m"])
    assert "gtsam" in written["versions"]
    assert f"limit       {metrics['limit_ate_m']:.3f} m rms" in result.stdout


@needs_gtsam
def test_of_two_robots_the_limit_is_the_mean():
    episode = run_episode(RunConfig("env1", 0.02, max_time=15.0, robots=2, limit=True))
    metrics = score(episode)
    optimum = solve_optimum(
        episode.config.robot, episode.true, episode.wheels, episode.ranges, episode.wall_seen,
        range_std=0.02, wheel_variance=WHEEL_VARIANCE, contact=episode.contact,
    )  # fmt: skip
    both = [ate(optimum.poses[:, robot], episode.true[:, robot]) for robot in range(2)]
    assert metrics["limit_ate_m"] == pytest.approx(np.mean(both))
    without = score(replace(episode, config=replace(episode.config, limit=False)))
    assert set(metrics) - set(without) == {"limit_ate_m", "ate_over_limit", "smoothed_over_limit"}


def normalised_error(log, noise):
    """NEES of the last pose of a one-robot log, with the covariance of the optimum by another library."""
    optimum = log.optimum(noise)
    readings, walls = usable_readings(log.robot, log.ranges, log.wall_seen)
    motions, stds = offline_optimum._measured_motions(log.wheels.astype(float), WHEEL_VARIANCE, None)
    anchors, lines = fitted_lines(optimum.poses, readings, len(walls), noise)
    problem = optimum_solver.Problem(0.16, log.poses[0], motions, stds, readings, noise, anchors, lines)
    state = optimum_solver.moved_to(problem, motions_between(optimum.poses, 0.16), lines)
    graph = optimum_solver._linearised(optimum_solver.without_grazing(problem, state), state)
    rows, columns, values = graph.sparseJacobian_()
    is_left = columns < columns.max()  # the last column is the right-hand side
    places = rows[is_left].astype(int) - 1, columns[is_left].astype(int) - 1
    jacobian = csc_matrix((values[is_left], places))
    last = 3 * (len(motions) - 1) + np.arange(3)
    unit = np.zeros((jacobian.shape[1], 3))
    unit[last, range(3)] = 1.0
    covariance = splu((jacobian.T @ jacobian).tocsc()).solve(unit)[last]
    error = optimum.poses[-1, 0] - log.poses[-1, 0]
    error[2] = wrap_angle(float(error[2]))
    return float(error @ np.linalg.solve(covariance, error))


@needs_gtsam
def test_errors_are_as_large_as_the_covariance_of_the_optimum():
    nees = [normalised_error(laps_of_square(0.02, seed=seed, steps=150), 0.02) for seed in range(30)]
    # Chi-square of 90 degrees of freedom: the mean over 3 has a standard deviation of 0.15.
    assert np.mean(nees) / 3.0 == pytest.approx(1.0, abs=0.45)


@needs_gtsam
@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise", "expected", "expected_heading"), [(0.0, 0.032, 0.26), (0.02, 0.036, 0.64), (0.04, 0.058, 0.97)]
)
def test_four_laps_of_the_square_are_no_worse_than_the_limit_of_the_experiment(noise, expected, expected_heading):
    """The square corridor: the limit's size is one draw a run, of the first wall's direction."""
    found = []
    for seed in range(5):
        log = laps_of_square(noise, seed, laps=4)
        optimum = log.optimum(noise)
        assert optimum.is_converged
        found.append((ate(optimum.poses, log.poses), heading_rmse(optimum.poses, log.poses)))
    error, heading = np.median(found, axis=0)
    assert 0.1 * expected < error < 1.1 * expected
    assert 0.3 * expected_heading < heading < 1.1 * expected_heading


@needs_gtsam
@pytest.mark.slow
def test_the_size_of_the_limit_over_many_laps():
    errors = []
    for seed in range(60):
        log = laps_of_square(0.02, 100 + seed)
        errors.append(ate(log.optimum(0.02).poses, log.poses))
    # The covariance of the optimum expects 0.052 m for one lap.
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(0.052, rel=0.3)


@needs_gtsam
@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.04])
def test_nobody_beats_the_limit_in_the_median(noise):
    ratios = []
    for seed in range(5):
        episode = run_episode(RunConfig("square", noise, seed=seed, laps=1, limit=True))
        ratios.append(score(episode)["ate_over_limit"])
    assert np.median(ratios) >= 1.0
