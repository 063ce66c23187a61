"""Results in a folder: nothing lost, nothing twice, nothing of another suite among them."""

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from support import benchmark_work
from support.benchmark_rows import grid, write_folder
from support.command_line import call

from benchmarks.__main__ import main as benchmarks
from benchmarks.analysis.series import read_series
from benchmarks.suite.jobs import Failure, Job
from benchmarks.suite.store import RESULTS, SERIES, STAMP, Row, Stamp, open_store, read_jobs, read_rows

JOBS = [Job("env1", 0.02, seed=seed) for seed in range(3)]
MADE_BY = Stamp("tiny", "d1", 3, {"python": "3.11", "numpy": "2.0"}, "abc")


@pytest.fixture
def folder(tmp_path):
    """A folder with two rows of three: one well, one failed."""
    with open_store(tmp_path / "out", MADE_BY) as store:
        store.append(JOBS[0], benchmark_work.outcome(JOBS[0]))
        store.append(JOBS[1], Failure("it broke"))
    return tmp_path / "out"


def refusal(folder, stamp=MADE_BY):
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(ValueError) as caught, open_store(folder, stamp):
        pass
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    assert str(caught.value).startswith(str(folder))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_row_says_what_ran_and_what_came_of_it(folder):
    well, failed = read_rows(folder)
    assert well == Row(
        world="env1", noise=0.02, robots=1, preset="paper", policy="frontier", ablation=None, laps=0, seed=0,
        metrics={"ate_m": 0.02, "doors_open": None}, cost={"job_s": 0.1}, versions=MADE_BY.versions, commit="abc",
        config="c0ffee", series=f"{SERIES}/{JOBS[0].key}.npz", key=JOBS[0].key, error=None,
    )  # fmt: skip
    assert (failed.error, failed.metrics, failed.cost, failed.series) == ("it broke", {}, {}, None)
    assert failed.key == JOBS[1].key


def test_rows_are_one_line_of_json_each(folder):
    lines = (folder / RESULTS).read_text().splitlines()
    assert [json.loads(line)["seed"] for line in lines] == [0, 1]
    issue = {"world", "noise", "robots", "preset", "policy", "ablation", "laps", "seed", "metrics", "cost", "versions"}
    assert issue | {"commit", "config"} <= json.loads(lines[0]).keys()


def test_series_are_arrays_without_pickles(folder):
    with np.load(folder / read_rows(folder)[0].series, allow_pickle=False) as series:
        assert series["time"].tolist() == [0.0, 1.0, 2.0]
        assert series["true"].shape == (3, 1, 3)


def test_what_is_there_is_known_at_the_next_start(folder):
    with open_store(folder, MADE_BY) as store:
        assert store.rows.keys() == {JOBS[0].key, JOBS[1].key}
        with pytest.raises(ValueError, match="a row for this job already"):
            store.append(JOBS[0], benchmark_work.outcome(JOBS[0]))
        store.append(JOBS[2], benchmark_work.outcome(JOBS[2]))
    assert [row.seed for row in read_rows(folder)] == [0, 1, 2]


def test_failed_rows_stay_unless_they_are_to_be_tried_again(folder):
    with open_store(folder, MADE_BY, retry_failed=True) as store:
        assert store.rows.keys() == {JOBS[0].key}
        store.append(JOBS[1], benchmark_work.outcome(JOBS[1]))
    assert [row.error for row in read_rows(folder)] == [None, None]


def test_a_torn_line_is_mended_wherever_it_was_torn(folder):
    content = (folder / RESULTS).read_bytes()
    first = content.index(b"\n") + 1
    for end in range(first, len(content), 7):
        (folder / RESULTS).write_bytes(content[:end])
        assert [row.seed for row in read_rows(folder)] == [0], "those who only read leave the torn line out"
        with open_store(folder, MADE_BY) as store:
            assert store.rows.keys() == {JOBS[0].key}
            store.append(JOBS[1], Failure("it broke"))
        assert (folder / RESULTS).read_bytes() == content


def test_what_a_kill_left_half_written_is_removed(folder):
    left = [
        folder / ".results.jsonl.limslam-new.jsonl", folder / ".suite.json.limslam-new.json",
        folder / SERIES / ".12ab.npz.limslam-new.npz", folder / SERIES / ".12ab.npz.limslam-lock",
    ]  # fmt: skip
    for path in left:
        path.write_bytes(b"half")
    with open_store(folder, MADE_BY):
        assert not any(path.exists() for path in left)
    assert len(read_rows(folder)) == 2


def test_a_kill_before_the_first_row_leaves_a_folder_that_can_be_used(tmp_path):
    (tmp_path / ".lock").touch()
    (tmp_path / ".suite.json.limslam-new.json").write_bytes(b'{"su')
    with open_store(tmp_path, MADE_BY) as store:
        assert store.rows == {}
    assert json.loads((tmp_path / STAMP).read_text()) == asdict(MADE_BY)


def test_two_at_once_are_refused(folder):
    with open_store(folder, MADE_BY):
        assert "another run is writing there" in refusal(folder)
    with open_store(folder, MADE_BY) as store:
        assert len(store.rows) == 2


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        (replace(MADE_BY, digest="d2"), "digest d1; now tiny, 3 jobs, digest d2"),
        (replace(MADE_BY, suite="other", jobs=4), "another suite"),
        (replace(MADE_BY, versions={"python": "3.11", "numpy": "2.1"}), "numpy 2.0, now 2.1"),
        (replace(MADE_BY, versions={"python": "3.11"}), "numpy 2.0, now missing"),
        (replace(MADE_BY, commit="abc-dirty"), "commit abc, now abc-dirty"),
    ],
)
def test_another_suite_version_or_commit_is_refused_with_the_reason(folder, changed, reason):
    assert reason in refusal(folder, changed)


def test_folders_of_something_else_are_refused(tmp_path):
    (tmp_path / "thesis.tex").touch()
    assert "holds no benchmark's results" in refusal(tmp_path)
    with pytest.raises(ValueError, match="is not a folder"), open_store(tmp_path / "thesis.tex", MADE_BY):
        pass


def test_a_broken_stamp_is_refused(folder):
    (folder / STAMP).write_text("[]")
    with pytest.raises(ValueError, match="not the stamp of a benchmark"), open_store(folder, MADE_BY):
        pass


@pytest.mark.parametrize("line", ["{", "[]", '{"world": "env1"}', '{"speed": 1}'])
def test_a_line_that_is_no_row_is_refused_with_its_number(folder, line):
    with (folder / RESULTS).open("a") as file:
        file.write(line + "\n")
    with pytest.raises(ValueError, match=r"results.jsonl, line 3: not") as caught:
        read_rows(folder)
    assert "\n" not in str(caught.value)


def test_no_results_there(tmp_path):
    with pytest.raises(ValueError, match="no results there"):
        read_rows(tmp_path)


def test_a_parent_folder_lists_the_results_below_it(folder, tmp_path):
    for name in ("suite-b", "suite-a"):
        (tmp_path / name).mkdir()
        (tmp_path / name / RESULTS).write_bytes((folder / RESULTS).read_bytes())
    with pytest.raises(ValueError, match=r"no results there; there are some in .*suite-a, .*suite-b$"):
        read_rows(tmp_path)


def test_ten_thousand_rows_can_be_read(folder):
    row = (folder / RESULTS).read_bytes().splitlines(keepends=True)[0]
    (folder / RESULTS).write_bytes(row * 10_000)
    assert len(read_rows(folder / RESULTS)) == 10_000


def test_keys_tell_jobs_apart():
    changes = [
        {"world": "env2"}, {"noise": 0.03}, {"robots": 2}, {"preset": "odometry"}, {"policy": "random"},
        {"ablation": "no-ekf"}, {"laps": 1}, {"seed": 1}, {"max_time": 10.0}, {"limit": True},
    ]  # fmt: skip
    job = Job("env1", 0.02)
    assert len({job.key, *(replace(job, **change).key for change in changes)}) == len(changes) + 1
    assert job.key == Job("env1", 0.02).key


def change_row(folder, number, **changes):
    """Change fields of a row of ``results.jsonl``."""
    lines = [json.loads(line) for line in (folder / RESULTS).read_text().splitlines()]
    lines[number] |= changes
    (folder / RESULTS).write_text("".join(json.dumps(line) + "\n" for line in lines))


def test_a_row_that_repeats_another_is_counted_once(folder, capsys):
    with (folder / RESULTS).open("a") as file:
        file.write((folder / RESULTS).read_text())
    assert [row.seed for row in read_jobs([folder])] == [0, 1]
    assert capsys.readouterr().err == "benchmarks: 2 rows repeat others and are not counted again\n"
    assert len(read_jobs([folder, folder, folder])) == 2
    with open_store(folder, MADE_BY) as store:
        assert len(store.rows) == 2


def test_a_job_that_was_done_twice_at_other_cost_is_counted_once(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "again")
    change_row(tmp_path / "again", 0, cost={"job_s": 99.0})
    assert [row.cost for row in read_jobs([folder, tmp_path / "again"])] == [{"job_s": 0.1}, {}]


@pytest.mark.parametrize("changes", [{"metrics": {"ate_m": 9.0}}, {"error": "it broke"}, {"commit": "other"}])
def test_two_different_rows_of_one_job_are_refused(folder, tmp_path, changes):
    shutil.copytree(folder, tmp_path / "again")
    change_row(tmp_path / "again", 0, **changes)
    words = f"two different rows claim the same job .env1, paper, frontier, seed 0.: their {next(iter(changes))} differ"
    with pytest.raises(ValueError, match=words):
        read_jobs([folder, tmp_path / "again"])


@pytest.mark.parametrize("damage", [Path.unlink, lambda path: path.write_bytes(path.read_bytes()[:100])])
def test_series_that_are_lost_are_made_again(folder, damage):
    series = folder / SERIES / f"{JOBS[0].key}.npz"
    damage(series)
    with open_store(folder, MADE_BY) as store:
        assert (store.lost, set(store.rows)) == (1, {JOBS[1].key})
        store.append(JOBS[0], benchmark_work.outcome(JOBS[0]))
    assert series.is_file()
    with open_store(folder, MADE_BY) as store:
        assert (store.lost, len(store.rows)) == (0, 2)


@pytest.mark.parametrize("name", ["../secret.npz", "/etc/passwd", "series/../../secret.npz", "series/link/secret.npz"])
def test_series_that_lead_out_of_the_folder_are_not_opened(folder, name):
    np.savez(folder.parent / "secret.npz", time=np.zeros(1))
    (folder / SERIES / "link").symlink_to(folder.parent)
    change_row(folder, 0, series=name)
    with pytest.raises(ValueError, match="lead out of the folder"):
        read_series(folder, read_rows(folder)[0])
    assert "lead out of the folder" in refusal(folder)


@pytest.mark.parametrize(
    "changes",
    [
        {"metrics": [1]}, {"metrics": {"ate_m": [1]}}, {"cost": {"job_s": "long"}}, {"seed": "one"}, {"noise": None},
        {"versions": 3}, {"series": 5}, {"error": {}}, {"world": ["env1"]}, {"key": None},
    ],
)  # fmt: skip
def test_a_row_with_a_value_of_another_kind_is_refused_in_one_line(folder, changes):
    change_row(folder, 1, **changes)
    with pytest.raises(ValueError, match=rf"results.jsonl, line 2: not a row of results: {next(iter(changes))} is"):
        read_rows(folder)
    result = call(benchmarks, "table", folder)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("benchmarks: ")


def test_the_table_of_a_folder_given_twice_is_the_table_of_the_folder(tmp_path):
    folder = write_folder(tmp_path / "made-up", grid(seeds=3, worlds=("env1",)))
    once, twice = call(benchmarks, "table", folder), call(benchmarks, "table", folder, folder)
    assert once.returncode == twice.returncode == 0
    assert twice.stdout == once.stdout
    assert twice.stderr == "benchmarks: 12 rows repeat others and are not counted again\n"
    assert once.stderr == ""
