"""Made-up logs are read as they were driven, and their relations hold for the true path only."""

import numpy as np
import pytest

from benchmarks import __main__ as command
from benchmarks import made_up_logs
from benchmarks.made_up_logs import made_up_log, smoothing_table, walls_of, write_log
from limslam_agent.logs.log_reader import read_log
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


def test_a_log_that_cannot_be_smoothed_is_a_row_of_the_table(tmp_path, monkeypatch):
    def fails(*_):
        raise IndexError("index 3 is out of bounds")

    monkeypatch.setattr(made_up_logs, "outcome", fails)
    *_, row = smoothing_table([1], ["", "max_range=4"], tmp_path, 10.0)
    assert "| max_range=4 | failed: IndexError: index 3 is out of bounds" in row


@pytest.mark.parametrize("seeds", ["a..b", "0,1", "-1", "5..3", "", "0..", "1.5"])
def test_seeds_that_are_none_are_refused(tmp_path, seeds):
    with pytest.raises(ValueError, match="--seeds: a seed such as 7 or a range such as"):
        command.made_up_logs(tmp_path / "logs", seeds)
    assert not (tmp_path / "logs").exists()


def test_what_is_missing_is_refused_before_the_first_log(tmp_path, monkeypatch):
    with pytest.raises(ValueError, match="foo is no setting of a variation"):
        next(smoothing_table([0], ["", "foo=1"], tmp_path / "logs", 10.0))
    monkeypatch.setenv("LIMSLAM_DATA", str(tmp_path / "absent"))
    with pytest.raises(ValueError, match="recorded data not found"):
        next(smoothing_table(range(4), [""], tmp_path / "logs", 10.0))
    assert next(smoothing_table(range(3), [""], tmp_path / "logs", 10.0)).startswith("| log |")
    assert not (tmp_path / "logs").exists()


def test_ctrl_c_does_not_promise_that_the_same_command_goes_on(tmp_path, monkeypatch, capsys):
    def stops(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(made_up_logs, "smoothing_table", stops)
    monkeypatch.setattr(command.signal, "signal", lambda *_: None)
    monkeypatch.setattr(command.sys, "argv", ["benchmarks", "made-up-logs", str(tmp_path)])
    with pytest.raises(SystemExit) as caught:
        command.main()
    assert caught.value.code == 130
    assert capsys.readouterr().err == "benchmarks: stopped; what is done is kept, and --seeds chooses the rest\n"
