"""Runs with each policy, how they end, and the offline optimum beside them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from support.command_line import limslam
from support.runs import result_of

from limslam_agent import preset
from limslam_agent.config.smoother import RenewalConfig
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.optimum import offline_optimum
from limslam_agent.runs.results import score
from limslam_agent.runs.run_config import RunConfig
from limslam_env import NoiseConfig, NominalNoise, RobotSpec, World, load_world
from limslam_env.geometry import line, se2
from limslam_env.metrics import consistency_metrics
from limslam_env.simulation.simulation import Simulation

WALLS = [[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0], [2, 0, 2, 1.6]]
LOOP = [[1.0, 1.0], [1.0, 2.3], [3.0, 2.3], [3.0, 1.0], [3.0, 2.3], [1.0, 2.3]]
ROOM = World("room", (4.0, 3.0), WALLS, starts=[[1.0, 0.8, 0.4], [3.0, 1.0, 2.0]], loop=LOOP)


def run(policy, **settings):
    return run_episode(
        RunConfig(ROOM, policy=policy, **{"max_time": 120.0, "until": "seen", **settings})
    )


@pytest.fixture(scope="module")
def tour():
    return run("tour")


@pytest.mark.parametrize(
    "settings", [{"preset": "odometry"}, {"preset": "paper", "ablation": "no-ekf"}]
)
def test_every_estimator_listens_to_the_same_drive(tour, settings):
    other = run("tour", **settings)
    assert len(tour.time) > 100
    for name in ("time", "ranges", "wheels", "actions", "true", "wall_seen", "coverage"):
        np.testing.assert_array_equal(getattr(tour, name), getattr(other, name))
    assert not np.array_equal(tour.estimated, other.estimated)


def test_a_tour_is_no_exploration(tour):
    scores = score(tour)
    assert scores["stop_reason"] == "the tour is driven"
    assert scores["exploration_time_s"] is None
    assert scores["collisions"] == 0
    np.testing.assert_allclose(tour.true[-1, 0, :2], LOOP[0], atol=0.005)
    # The filter was there all the time.
    assert scores["ate_m"] > 0.0
    assert scores["landmarks"] >= 4


def test_a_tour_is_driven_as_often_as_laps_say(tour):
    twice = run("tour", laps=2)
    assert twice.time[-1] == pytest.approx(2.0 * tour.time[-1], rel=0.05)


@pytest.mark.parametrize("policy", ["wall_follower", "random"])
def test_policies_to_compare_with_drive_by_what_they_believe(policy):
    episode = run(policy, robots=2, max_time=20.0)
    lengths = np.abs(np.diff(episode.true[..., :2], axis=0)).sum(axis=(0, 2))
    assert (lengths > 0.5).all()
    again = run(policy, robots=2, max_time=20.0)
    other = run(policy, robots=2, max_time=20.0, seed=1)
    np.testing.assert_array_equal(again.true, episode.true)
    assert not np.array_equal(other.true, episode.true)


# A room of 1.4 m x 1.4 m in the corner of a hall, with a gap in the hall's outer wall or without
# one.
CORNER = [[0, 1.4, 1.4, 1.4], [1.4, 1.4, 1.4, 0]]
CLOSED = [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]]
OPEN = [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 4, 4], [3, 4, 0, 4], [0, 4, 0, 0]]
INSIDE = {"starts": np.array([[0.7, 0.7, 0.0]])}


@pytest.mark.parametrize(
    ("walls", "more", "words"),
    [(CLOSED, INSIDE, "other regions"), (OPEN, {}, "outer wall is open")],
)
def test_a_small_region_is_not_called_the_world(walls, more, words):
    config = RunConfig(
        World("hall", (6.0, 4.0), np.array(walls + CORNER, dtype=float), **more),
        0.0,
        until="seen",
        seed=1,
        max_time=200.0,
    )
    (warning,) = config.warnings
    assert words in warning
    episode = run_episode(config)
    assert episode.is_finished
    assert episode.stop_reason.startswith("stopped: the start region is explored, but 9")
    assert episode.stop_reason.endswith("of the floor cannot be reached from it: not explored")
    assert score(episode)["exploration_time_s"] is None


def test_a_whole_world_is_called_explored():
    config = RunConfig(
        World("room", (6.0, 4.0), np.array(CLOSED, dtype=float)),
        0.0,
        seed=1,
        max_time=400.0,
        until="seen",
    )
    assert config.warnings == []
    episode = run_episode(config)
    assert episode.stop_reason == "explored: no frontier is left"
    assert score(episode)["exploration_time_s"] == episode.time[-1]


@pytest.mark.slow
def test_ten_minutes_in_one_building_end_as_they_began():
    settings = replace(preset("graph", NominalNoise(0.02)), renewal=RenewalConfig(period=120.0))
    run = RunConfig(
        "env3",
        0.02,
        seed=100,
        policy="tour",
        laps=100,
        max_time=600.0,
        until="seen",
        settings=settings,
    )
    landmarks = []
    episode = run_episode(run, lambda team, *_: landmarks.append(len(team.slam.all_landmarks)))
    error = np.hypot(*(episode.estimated - episode.true)[:, 0, :2].T)
    quarters = np.array_split(np.arange(len(error)), 4)
    first, *_, last = (np.sqrt(np.mean(error[part] ** 2)) for part in quarters)
    assert last <= 1.5 * max(first, 0.03)
    part = quarters[-1]
    scores = consistency_metrics(
        episode.true[part, 0], episode.estimated[part, 0], episode.covariances[part, 0]
    )
    assert scores["anees"] <= 3.0
    assert landmarks[-1] <= 1.3 * landmarks[len(landmarks) // 4]


ROBOT = RobotSpec()
NOISE = NominalNoise(0.02)


def driven(world, actions, seed=1, start=None, noise=0.02):
    """The log of a simulated drive: poses, wheels, ranges, wall_seen and contact, a row for each
    moment.
    """
    simulation = Simulation(load_world(world), ROBOT, 1)
    results = [simulation.reset(np.random.SeedSequence(seed), NoiseConfig(noise), start)]
    results += [simulation.step([action]) for action in actions]
    readings, truths = zip(*results, strict=True)
    return (
        *(np.array([getattr(each, name) for each in truths]) for name in ("poses",)),
        *(
            np.array([getattr(each, name) for each in readings], dtype=float)
            for name in ("wheels", "ranges")
        ),
        *(np.array([getattr(each, name) for each in truths]) for name in ("wall_seen", "contact")),
    )


def test_another_solver_finds_the_same_optimum():
    """Wheels and lines alone are the unknowns; residuals in plain Python; dense, by differences."""
    true, wheels, ranges, wall_seen, contact = driven("env1", [(0.5, 0.65)] * 40)
    steps = len(true) - 1
    world = load_world("env1")
    # Without the readings that nearly graze, both leave out the same ones.
    for row, beam in np.argwhere(wall_seen[:, 0] >= 0):
        edge = world.edges[wall_seen[row, 0, beam]]
        normal = line.through(edge[:2], edge[2:])[1]
        if abs(math.cos(true[row, 0, 2] + ROBOT.beam_angles[beam] - normal)) < 0.3:
            wall_seen[row, 0, beam] = -1
    is_read = (
        (wall_seen[:, 0] >= 0) & (ranges[:, 0] > ROBOT.too_near) & (ranges[:, 0] < ROBOT.too_far)
    )
    counts = {
        wall: int((wall_seen[:, 0][is_read] == wall).sum())
        for wall in np.unique(wall_seen[:, 0][is_read])
    }
    walls = [wall for wall, count in counts.items() if count >= 6]

    def path(values):
        poses = [true[0, 0]]
        for pair in values:
            poses.append(se2.compose(poses[-1], se2.arc(*se2.wheels_to_arc(pair, ROBOT.axle))))
        return np.array(poses)

    def residuals(values, used):
        travel = values[: 2 * steps].reshape(-1, 2)
        lines = values[2 * steps :].reshape(-1, 2)
        poses = path(travel)
        measured = wheels[1:, 0]
        found = (
            ((travel - measured) / np.sqrt(NOISE.wheel_variance * np.abs(measured) + 1e-12))
            .ravel()
            .tolist()
        )
        for row, beam in used:
            (r, theta), heading = lines[walls.index(wall_seen[row, 0, beam])], poses[row, 2]
            phi, (x, y) = heading + ROBOT.beam_angles[beam], poses[row, :2]
            origin = ROBOT.beam_origins[beam]
            x += origin[0] * math.cos(heading) - origin[1] * math.sin(heading)
            y += origin[0] * math.sin(heading) + origin[1] * math.cos(heading)
            should = (r - x * math.cos(theta) - y * math.sin(theta)) / math.cos(theta - phi)
            found.append((ranges[row, 0, beam] - should) / 0.02)
        return np.array(found)

    lines = np.array([line.through(world.edges[wall, :2], world.edges[wall, 2:]) for wall in walls])
    used = [(row, beam) for row, beam in np.argwhere(is_read) if wall_seen[row, 0, beam] in walls]
    begin = np.concatenate((wheels[1:].ravel(), lines.ravel()))
    other = least_squares(residuals, begin, xtol=1e-12, ftol=1e-12, x_scale="jac", args=(used,))
    found = offline_optimum(ROBOT, NOISE, true, wheels, ranges, wall_seen, contact)
    assert found is not None
    np.testing.assert_allclose(
        found[:, 0, :2], path(other.x[: 2 * steps].reshape(-1, 2))[:, :2], atol=2e-5
    )


def test_wheels_in_contact_do_not_drag_the_optimum_along():
    # Straight into the lower wall, aslant: it slides, and its wheels say that it went on.
    log = driven("square", [(0.8, 0.8)] * 60, start=np.array([[3.0, 0.5, -1.0]]))
    true = log[0]
    contact = log[-1]
    assert contact.sum() > 30
    told = offline_optimum(ROBOT, NOISE, *log)
    untold = offline_optimum(ROBOT, NOISE, *log[:-1], np.zeros_like(contact))
    assert np.abs(told - true)[..., 1].max() < 0.05
    assert np.abs(untold - true)[..., 1].max() > 2.0 * np.abs(told - true)[..., 1].max()


def test_without_a_wall_there_is_no_optimum():
    true, wheels, ranges, wall_seen, contact = driven("square", [(0.5, 0.5)] * 5)
    assert (
        offline_optimum(ROBOT, NOISE, true, wheels, ranges, np.full_like(wall_seen, -1), contact)
        is None
    )


def test_the_command_writes_both_metrics(tmp_path):
    drive = ("--world", "square", "--laps", "1", "--noise", "0.02", "--max-time", "20")
    result = limslam("run", *drive, "--limit", "--out", tmp_path / "run")
    assert result.returncode == 0, result.stderr
    metrics = result_of(tmp_path / "run")["metrics"]
    assert metrics["exploration_time_s"] is None
    assert 0.0 < metrics["limit_ate_m"] < 0.1
    assert metrics["ate_over_limit"] == pytest.approx(metrics["ate_m"] / metrics["limit_ate_m"])
    assert f"limit       {metrics['limit_ate_m']:.3f} m rms" in result.stdout
