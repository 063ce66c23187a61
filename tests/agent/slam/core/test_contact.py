"""Contact: which readings show it, how uncertain it makes the motion, and that the estimates stay honest in it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from limslam_agent import LineSlam, preset
from limslam_agent.slam.core.contact import LONGEST, Contacts, slip_covariance, slip_covariances
from limslam_agent.slam.line_graph.smoother import FilteredRun, smooth_run
from limslam_env import NoiseConfig, NominalNoise, RobotSpec, World, metrics
from limslam_env.geometry import FloatArray
from limslam_env.simulation.simulation import Simulation

ROBOT, STD, NOISE = RobotSpec(), 0.02, NominalNoise(0.02)
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


def test_noise_does_not_end_a_contact_and_free_space_does() -> None:
    steady, noisy = Contacts(ROBOT, STD), Contacts(ROBOT, STD)
    expected = [variance_of(steady, 0.02, LEAST) for _ in range(10)]
    found = [
        variance_of(noisy, 0.02, near) for near in (LEAST, 0.07, LEAST, LEAST, 0.08, LEAST, LEAST, 0.06, 0.07, 0.06)
    ]
    assert found == expected
    assert variance_of(noisy, 0.02, 0.15) == 0.0
    assert variance_of(noisy, 0.02, LEAST) == 0.0


def test_a_beam_that_reads_its_minimum_for_ever_soon_says_nothing() -> None:
    contacts = Contacts(ROBOT, STD)
    found = [variance_of(contacts, 0.02, 0.0) for _ in range(200)]
    assert math.sqrt(sum(found)) < LONGEST
    assert found[100:] == [0.0] * 100


def test_steps_without_a_scan_do_not_end_a_contact() -> None:
    ranges = np.array([seen(LEAST if row % 3 == 0 else 1.5) for row in range(31)])[:, None]
    has_scan = np.array([row % 3 == 0 for row in range(31)])[:, None, None]
    wheels = np.full((31, 1, 2), 0.02)
    found = slip_covariances(ROBOT, STD, np.moveaxis(wheels, 0, 1)[:, 1:], ranges, np.isfinite(ranges) & has_scan)
    assert np.count_nonzero(found[0, :, 0, 0]) > 20


def test_beams_to_the_sides_and_beams_that_cannot_measure_near_the_body_show_no_contact() -> None:
    blind = replace(ROBOT, beams=tuple(replace(beam, min_range=0.1) for beam in ROBOT.beams))
    for contacts, near, beam in ((Contacts(ROBOT, STD), LEAST, 0), (Contacts(blind, STD), 0.1, RIGHT_OF_FRONT)):
        assert sum(variance_of(contacts, 0.02, near, beam) for _ in range(10)) < 1e-12


def test_the_smoother_allows_the_same_slip() -> None:
    ranges = np.array([*[seen(1.0)] * 9, *[seen(LEAST)] * 6])[:, None]
    wheels = np.full((1, len(ranges) - 1, 2), 0.02)
    slips = slip_covariances(ROBOT, STD, wheels, ranges, np.ones(ranges.shape, dtype=bool))[0]
    contacts, total = Contacts(ROBOT, STD), np.zeros((3, 3))
    contacts.slip(0.0, ranges[0, 0], ALL)
    for row in ranges[1:, 0]:
        total += slip_covariance(*contacts.slip(0.02, row, ALL))
    assert np.flatnonzero(slips[:, 0, 0]).tolist() == list(range(9, len(ranges) - 1))
    # The mean of the wheels is the motion ahead.
    ahead = np.array([0.5, 0.5, 0.0])
    assert ahead @ slips.sum(axis=0) @ ahead == pytest.approx(total[0, 0])


def bumping(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A robot that drives against the walls of a room, pushes for a second, and turns: ranges, wheels and poses."""
    walls = [[0, 0, 2.5, 0], [2.5, 0, 2.5, 2], [2.5, 2, 0, 2], [0, 2, 0, 0], [1.2, 0.0, 1.2, 0.5]]
    world = World("room", (2.5, 2.0), np.array(walls, dtype=float))
    simulation, generator = Simulation(world, ROBOT, 1), np.random.default_rng(seed)
    start = np.array([0.5, 1.0, generator.uniform(-0.4, 0.4)])
    readings, truth = simulation.reset(np.random.SeedSequence(seed), NoiseConfig(sensor_noise=STD), start)
    rows, pushed, turning = [(readings.ranges[0], readings.wheels[0], truth.poses[0])], 0, 0
    for _ in range(250):
        pushed = pushed + 1 if (rows[-1][0][1:5] <= ROBOT.too_near[1:5]).any() else 0
        if pushed > 10:
            pushed, turning = 0, int(generator.integers(8, 16))
        action = (-0.6, 0.6) if turning else (0.7, 0.7)
        turning = max(turning - 1, 0)
        readings, truth = simulation.step([action])
        rows.append((readings.ranges[0], readings.wheels[0], truth.poses[0]))
    ranges, wheels, poses = (np.array(each, dtype=float) for each in zip(*rows, strict=True))
    return ranges, wheels, poses


def consistency(seed: int) -> tuple[float, float]:
    """Mean NEES / 3 of the filter and of the smoothed path."""
    ranges, wheels, true = bumping(seed)
    slam, records = LineSlam(ROBOT, preset("consistent", NOISE), true[0]), []
    slam.on_association = records.append
    poses, covariances = [], []
    for row, travel in zip(ranges, wheels, strict=True):
        slam.step({"ranges": row, "wheels": travel})
        poses.append(slam.poses)
        covariances.append(slam.covariances)
    slam.finish()
    usable = np.ones((len(ranges), 1, 6), dtype=bool)
    run = FilteredRun(
        ROBOT, NOISE, wheels[:, None], ranges[:, None], usable, np.array(poses), np.array(covariances), records,
        slam.closures,
    )  # fmt: skip
    smoothed = smooth_run(run)
    assert smoothed is not None
    found = [(np.array(poses), np.array(covariances)), (smoothed.poses, smoothed.covariances)]
    filtered, finished = (metrics.consistency_metrics(true, each[:, 0], own[:, 0])["anees"] for each, own in found)
    return filtered, finished


def test_a_robot_that_pushes_against_walls_knows_how_uncertain_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    honest = np.array([consistency(seed) for seed in range(2)])
    monkeypatch.setattr(Contacts, "slip", lambda *_: (0.0, 0.0))
    blind = np.array([consistency(seed) for seed in range(2)])
    assert blind.mean(axis=0).min() > 10.0
    assert honest.mean(axis=0).max() < 3.0
