"""Made-up logs are read as they were driven, and their relations hold for the true path only."""

import numpy as np
import pytest

from benchmarks.scoreboard.made_up_logs import made_up_log, sparse_sensor, thinned, walls_of, write_log
from limslam_agent import read_log
from limslam_agent.logs.relations import read_relations, relation_errors
from limslam_env.geometry import se2


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    """A drive of 30 m in a ring, and its files."""
    log = made_up_log(1, 30.0)
    return log, *write_log(log, tmp_path_factory.mktemp("logs"))


def test_the_walls_of_a_floor_are_its_borders():
    floor = np.zeros((40, 30), dtype=bool)
    floor[10:30, 5:15] = True
    walls = {tuple(np.round(wall, 6)) for wall in walls_of(floor).tolist()}
    assert walls == {(1, 0.5, 1, 1.5), (3, 0.5, 3, 1.5), (1, 0.5, 3, 0.5), (1, 1.5, 3, 1.5)}


def test_the_files_hold_the_drive(ring):
    log, path, _ = ring
    read = read_log(path, (90.0, 0.0, -90.0), 5.0)
    scans = read.has_scan
    assert 0 < (~scans).sum() < scans.sum()
    assert np.allclose(read.time[scans], 1000.0 + log.time, atol=1e-6)
    moves, driven = (se2.between(each[:-1], each[1:]) for each in (read.odometry[scans], log.odometry))
    assert np.allclose(moves, driven, atol=1e-5)
    seen = log.ranges[:, [179, 90, 0]]
    assert np.allclose(np.minimum(read.ranges[scans], 5.0), np.minimum(seen, 5.0), atol=0.006)


def test_relations_are_those_of_the_true_path(ring):
    log, _, relations = ring
    known = read_relations(relations)
    assert relation_errors(known, log.time + 1000.0, log.truth).translation.max() < 1e-4
    assert relation_errors(known, log.time + 1000.0, log.odometry).translation.mean() > 1e-3


def test_a_seed_gives_one_log(ring):
    again = made_up_log(1, 30.0)
    assert np.array_equal(again.ranges, ring[0].ranges)
    assert np.array_equal(again.odometry, ring[0].odometry)


def test_few_readings_are_left_in_a_metre(ring):
    log, *_ = ring
    moves = se2.between(log.odometry[:-1], log.odometry[1:])
    hit = log.ranges < 5.0
    driven = np.hypot(*moves[:, :2].T).sum()
    left = thinned(hit, moves, 40.0)
    assert left.sum() / driven == pytest.approx(40.0, rel=0.1)
    assert not (left & ~hit).any()
    sensors = [sparse_sensor(seed) for seed in range(32)]
    assert {len(beams) for beams, _ in sensors} == {4, 6, 8, 11}
    assert all(5.0 <= points <= 40.0 for _, points in sensors)
