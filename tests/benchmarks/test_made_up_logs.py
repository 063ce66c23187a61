"""Made-up logs are read as they were driven, and their relations hold for the true path only."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import __main__ as command
from benchmarks import made_up_logs
from benchmarks.log_variations import Outcome
from benchmarks.made_up_logs import made_up_log, smoothing_table, walls_of, write_log
from limslam_agent.logs.log_reader import read_log
from limslam_agent.logs.relations import read_relations, relation_errors
from limslam_agent.status.status import Status
from limslam_env.geometry import se2

ERRORS = "relation_error_m", "relation_error_deg", "loop_relation_error_m"


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
    *_, row, verdict = smoothing_table([1], ["", "max_range=4"], tmp_path, length=10.0)
    assert "| max_range=4 | failed: IndexError: index 3 is out of bounds" in row
    assert verdict == "\nof 0 paths, 0 are wrong and ok, 0 right and not ok, and 0 worse than odometry"


def test_the_sparse_table_says_how_many_paths_are_wrong_and_ok(tmp_path, monkeypatch):
    """Few points, few revisits, and errors after alignment, of a stand-in for the smoothing."""
    asked = []

    def smoothed(_, __, how, truth):
        asked.append((len(how.beams), how.points, truth[1].shape))
        status = SimpleNamespace(status=Status("ok" if len(asked) == 1 else "unsure"))
        return Outcome(None, status, dict.fromkeys(ERRORS, 0.1), 1.0, (1.0, (0.7, 0.2, 1.5)[len(asked) - 1]))

    monkeypatch.setattr(made_up_logs, "outcome", smoothed)
    *_, verdict = smoothing_table([5, 9, 13], [""], tmp_path, sparse=True, length=50.0)
    assert [beams for beams, _, _ in asked] == [4, 6, 6]
    assert all(5.0 <= points <= 40.0 and shape[1] == 3 for _, points, shape in asked)
    assert verdict == "\nof 3 paths, 1 are wrong and ok, 1 right and not ok, and 1 worse than odometry"


@pytest.mark.parametrize("seeds", ["a..b", "0,1", "-1", "5..3", "", "0..", "1.5"])
def test_seeds_that_are_none_are_refused(tmp_path, seeds):
    with pytest.raises(ValueError, match="--seeds: a seed such as 7 or a range such as"):
        command.made_up_logs(tmp_path / "logs", seeds)
    assert not (tmp_path / "logs").exists()


def test_what_is_missing_is_refused_before_the_first_log(tmp_path, monkeypatch):
    with pytest.raises(ValueError, match="foo is no setting of a variation"):
        next(smoothing_table([0], ["", "foo=1"], tmp_path / "logs", length=10.0))
    monkeypatch.setenv("LIMSLAM_DATA", str(tmp_path / "absent"))
    with pytest.raises(ValueError, match="recorded data not found"):
        next(smoothing_table(range(4), [""], tmp_path / "logs", length=10.0))
    assert next(smoothing_table(range(3), [""], tmp_path / "logs", length=10.0)).startswith("| log |")
    assert not (tmp_path / "logs").exists()


def test_ctrl_c_does_not_promise_that_the_same_command_goes_on(tmp_path, monkeypatch, capsys):
    def stops(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(made_up_logs, "smoothing_table", stops)
    monkeypatch.setattr(command.signal, "signal", lambda *_: None)
    monkeypatch.setattr(command.sys, "argv", ["benchmarks", "made-up-logs", str(tmp_path)])
    with pytest.raises(SystemExit) as caught:
        command.main()
    assert caught.value.code == 130
    assert capsys.readouterr().err == "benchmarks: stopped; what is done is kept, and --seeds chooses the rest\n"
