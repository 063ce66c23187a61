"""The rows of a suite and their series."""

import json
from pathlib import Path

import numpy as np
import pytest
from support import benchmark_work

from benchmarks.analysis.coverage import read_curves
from benchmarks.suite.jobs import Job
from benchmarks.suite.runner import run_suite
from benchmarks.suite.store import SERIES, STAMP, read_rows
from benchmarks.suite.suite import Suite
from limslam_agent.measurements.store import RESULTS

JOBS = tuple(Job("env1", 0.02, seed=seed) for seed in range(2))


class Here:
    """Jobs are done in this process."""

    def run(self, jobs, work):
        yield from ((job, work(job)) for job in jobs)


@pytest.fixture
def folder(tmp_path):
    run_suite(Suite("tiny", "", JOBS, "d1"), tmp_path / "out", Here(), work=benchmark_work.outcome)
    return tmp_path / "out"


def test_a_row_says_what_ran_and_what_came_of_it(folder):
    line = json.loads((folder / RESULTS).read_text().splitlines()[0])
    identity = {"world", "noise", "robots", "preset", "policy", "ablation", "laps", "seed"}
    assert identity | {"metrics", "cost", "versions", "commit", "config", "series", "key", "error"} == line.keys()
    first = read_rows(folder)[0]
    assert (first.metrics, first.config, first.error) == ({"ate_m": 0.02, "doors_open": None}, "c0ffee", None)
    assert first.cost.keys() == {"job_s", "job_cpu_s"}
    assert (first.key, first.series) == (JOBS[0].key, f"{SERIES}/{JOBS[0].key}.npz")
    with np.load(folder / first.series, allow_pickle=False) as series:
        assert series["coverage"].shape == (3,)
    assert json.loads((folder / STAMP).read_text())["jobs"] == 2


@pytest.mark.parametrize("damage", [Path.unlink, lambda path: path.write_bytes(path.read_bytes()[:100])])
def test_series_that_are_lost_are_made_again(folder, damage):
    series = folder / SERIES / f"{JOBS[0].key}.npz"
    damage(series)
    summary = run_suite(Suite("tiny", "", JOBS, "d1"), folder, Here(), work=benchmark_work.outcome)
    assert (summary.done, summary.before) == (2, 1)
    assert series.is_file()


@pytest.mark.parametrize("name", ["../secret.npz", "/etc/passwd", "series/../../secret.npz", "series/link/secret.npz"])
def test_series_that_lead_out_of_the_folder_are_not_opened(folder, name):
    np.savez(folder.parent / "secret.npz", time=np.zeros(1))
    (folder / SERIES / "link").symlink_to(folder.parent)
    line = json.loads((folder / RESULTS).read_text().splitlines()[0])
    (folder / RESULTS).write_text(json.dumps({**line, "series": name}) + "\n")
    with pytest.raises(ValueError, match="lead out of the folder"):
        read_curves([folder])
    with pytest.raises(ValueError, match="lead out of the folder"):
        run_suite(Suite("tiny", "", JOBS, "d1"), folder, Here(), work=benchmark_work.outcome)


@pytest.mark.parametrize("damage", [Path.unlink, lambda path: path.write_bytes(path.read_bytes()[:60])])
def test_damaged_series_are_refused_in_one_line(folder, damage):
    path = folder / SERIES / f"{JOBS[0].key}.npz"
    damage(path)
    with pytest.raises(ValueError, match=rf"{path}: is missing or damaged: [^\n]*$"):
        read_curves([folder])
