"""The offline optimum of a run: against another solver, in contact, and as a run reports it."""

import json
import math

import numpy as np
import pytest
from scipy.optimize import least_squares
from support.command_line import limslam

from limslam_agent.runs.optimum import offline_optimum
from limslam_env import NoiseConfig, NominalNoise, RobotSpec, load_world
from limslam_env.geometry import line, se2
from limslam_env.simulation.simulation import Simulation

ROBOT, NOISE = RobotSpec(), NominalNoise(0.02)


def driven(world, actions, seed=1, start=None, noise=0.02):
    """The log of a simulated drive: poses, wheels, ranges, wall_seen and contact, a row for each moment."""
    simulation = Simulation(load_world(world), ROBOT, 1)
    results = [simulation.reset(np.random.SeedSequence(seed), NoiseConfig(noise), start)]
    results += [simulation.step([action]) for action in actions]
    readings, truths = zip(*results, strict=True)
    return (
        *(np.array([getattr(each, name) for each in truths]) for name in ("poses",)),
        *(np.array([getattr(each, name) for each in readings], dtype=float) for name in ("wheels", "ranges")),
        *(np.array([getattr(each, name) for each in truths]) for name in ("wall_seen", "contact")),
    )


def test_another_solver_finds_the_same_optimum():
    """Wheels and lines alone are the unknowns; residuals in plain Python; dense, by differences."""
    true, wheels, ranges, wall_seen, contact = driven("env1", [(0.5, 0.65)] * 40)
    steps, world = len(true) - 1, load_world("env1")
    # Without the readings that nearly graze, both leave out the same ones.
    for row, beam in np.argwhere(wall_seen[:, 0] >= 0):
        edge = world.edges[wall_seen[row, 0, beam]]
        normal = line.through(edge[:2], edge[2:])[1]
        if abs(math.cos(true[row, 0, 2] + ROBOT.beam_angles[beam] - normal)) < 0.3:
            wall_seen[row, 0, beam] = -1
    is_read = (wall_seen[:, 0] >= 0) & (ranges[:, 0] > ROBOT.too_near) & (ranges[:, 0] < ROBOT.too_far)
    counts = {wall: int((wall_seen[:, 0][is_read] == wall).sum()) for wall in np.unique(wall_seen[:, 0][is_read])}
    walls = [wall for wall, count in counts.items() if count >= 6]

    def path(values):
        poses = [true[0, 0]]
        for pair in values:
            poses.append(se2.compose(poses[-1], se2.arc(*se2.wheels_to_arc(pair, ROBOT.axle))))
        return np.array(poses)

    def residuals(values, used):
        travel, lines = values[: 2 * steps].reshape(-1, 2), values[2 * steps :].reshape(-1, 2)
        poses, measured = path(travel), wheels[1:, 0]
        found = ((travel - measured) / np.sqrt(NOISE.wheel_variance * np.abs(measured) + 1e-12)).ravel().tolist()
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
    np.testing.assert_allclose(found[:, 0, :2], path(other.x[: 2 * steps].reshape(-1, 2))[:, :2], atol=2e-5)


def test_wheels_in_contact_do_not_drag_the_optimum_along():
    # Straight into the lower wall, aslant: it slides, and its wheels say that it went on.
    log = driven("square", [(0.8, 0.8)] * 60, start=np.array([[3.0, 0.5, -1.0]]))
    true, contact = log[0], log[-1]
    assert contact.sum() > 30
    told = offline_optimum(ROBOT, NOISE, *log)
    untold = offline_optimum(ROBOT, NOISE, *log[:-1], np.zeros_like(contact))
    assert np.abs(told - true)[..., 1].max() < 0.05
    assert np.abs(untold - true)[..., 1].max() > 2.0 * np.abs(told - true)[..., 1].max()


def test_without_a_wall_there_is_no_optimum():
    true, wheels, ranges, wall_seen, contact = driven("square", [(0.5, 0.5)] * 5)
    assert offline_optimum(ROBOT, NOISE, true, wheels, ranges, np.full_like(wall_seen, -1), contact) is None


def test_the_command_writes_both_metrics(tmp_path):
    drive = ("--world", "square", "--laps", "1", "--noise", "0.02", "--max-time", "20")
    result = limslam("run", *drive, "--limit", "--out", tmp_path / "run")
    assert result.returncode == 0, result.stderr
    metrics = json.loads((tmp_path / "run" / "result.json").read_text())["metrics"]
    assert 0.0 < metrics["limit_ate_m"] < 0.1
    assert metrics["ate_over_limit"] == pytest.approx(metrics["ate_m"] / metrics["limit_ate_m"])
    assert f"limit       {metrics['limit_ate_m']:.3f} m rms" in result.stdout
