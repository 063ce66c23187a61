"""Made-up logs are the same for a seed, and their relations hold for the true path only."""

import numpy as np
import pytest

from benchmarks.scoreboard.made_up_logs import known_relations, made_up_log, sparse_sensor, thinned, walls_of
from limslam_agent.logs.relations import relation_errors
from limslam_env.geometry import se2


@pytest.fixture(scope="module")
def ring():
    """A drive of 30 m in a ring."""
    return made_up_log(1, 30.0)


def test_the_walls_of_a_floor_are_its_borders():
    floor = np.zeros((40, 30), dtype=bool)
    floor[10:30, 5:15] = True
    walls = {tuple(np.round(wall, 6)) for wall in walls_of(floor).tolist()}
    assert walls == {(1, 0.5, 1, 1.5), (3, 0.5, 3, 1.5), (1, 0.5, 3, 0.5), (1, 1.5, 3, 1.5)}


def test_relations_are_those_of_the_true_path(ring):
    known = known_relations(ring)
    assert relation_errors(known, ring.time, ring.truth).translation.max() < 1e-4
    assert relation_errors(known, ring.time, ring.odometry).translation.mean() > 1e-3


def test_a_seed_gives_one_log(ring):
    again = made_up_log(1, 30.0)
    assert np.array_equal(again.ranges, ring.ranges)
    assert np.array_equal(again.odometry, ring.odometry)


def test_few_readings_are_left_in_a_metre(ring):
    moves = se2.between(ring.odometry[:-1], ring.odometry[1:])
    hit = ring.ranges < 5.0
    driven = np.hypot(*moves[:, :2].T).sum()
    left = thinned(hit, moves, 40.0)
    assert left.sum() / driven == pytest.approx(40.0, rel=0.1)
    assert not (left & ~hit).any()
    sensors = [sparse_sensor(seed) for seed in range(32)]
    assert {len(beams) for beams, _ in sensors} == {4, 6, 8, 11}
    assert all(5.0 <= points <= 40.0 for _, points in sensors)
