"""The rows of a suite."""

import json

import pytest
from support import benchmark_work

from benchmarks.suite.jobs import Job, Suite
from benchmarks.suite.runner import run_suite
from benchmarks.suite.store import STAMP, read_rows
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
    assert identity | {"metrics", "cost", "versions", "commit", "config", "key", "error"} == line.keys()
    first = read_rows(folder)[0]
    assert (first.metrics, first.config, first.error) == ({"ate_m": 0.02, "doors_open": None}, "c0ffee", None)
    assert first.cost.keys() == {"job_s", "job_cpu_s"}
    assert first.key == JOBS[0].key
    assert json.loads((folder / STAMP).read_text())["jobs"] == 2
