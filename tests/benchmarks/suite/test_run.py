"""Suites that run: every engine gives the same numbers, a kill loses nothing, and a job that dies
ends no other.
"""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import benchmark_work
from support.command_line import benchmarks

from benchmarks.analysis import tables
from benchmarks.suite.jobs import Job
from benchmarks.suite.runner import ONE_THREAD, run_suite
from benchmarks.suite.store import STAMP, read_rows
from benchmarks.suite.suite import Suite, load_suite
from limslam_agent.measurements.processes import Failure, Processes
from limslam_agent.measurements.store import RESULTS
from limslam_agent.output.provenance import commit, versions

TINY = """
name = "tiny"
description = "Few and short, and a bit of everything."

[[grid]]
worlds = ["env1", "random:3"]
noises = [0.0, 0.02]
robots = [1, 2]
seeds = [0]
max_time = 4.0

[[grid]]
worlds = ["square"]
noises = [0.02]
laps = [1]
seeds = [0, 1]
max_time = 10.0

[[grid]]
worlds = ["env2"]
noises = [0.02]
presets = ["odometry"]
policies = ["random", "wall_follower"]
seeds = [0]
max_time = 4.0
"""
HASTY = """
name = "hasty"
description = "More than can be done in a hundredth of a second."

[[grid]]
worlds = ["env1"]
noises = [0.0]
seeds = [0, 1]
"""
KILLS = 2
SEED = 20160704
GUARD = 300.0
"""Longest wait, s. It only keeps a test from waiting forever: what is awaited takes seconds, even
on a busy machine.
"""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    path = tmp_path_factory.mktemp("suite") / "tiny.toml"
    path.write_text(TINY)
    return load_suite(str(path))


@pytest.fixture(scope="module")
def rows(tiny, tmp_path_factory):
    """What one process makes of the tiny suite, never killed."""
    folder = tmp_path_factory.mktemp("unkilled") / "out"
    summary = run_suite(tiny, folder, Processes(1, GUARD))
    assert (summary.done, summary.before, summary.failures) == (len(tiny.jobs), 0, ())
    return comparable(folder)


def comparable(folder):
    """Rows by key without their cost."""
    lines = read_rows(folder)
    rows = {row.key: replace(row, cost={}) for row in lines}
    assert len(rows) == len(lines), "nothing is done twice"
    return rows


def command(suite, out):
    return [
        sys.executable,
        "-m",
        "benchmarks",
        "run",
        "--suite",
        str(suite),
        "--out",
        str(out),
        "--workers",
        "2",
    ]


def count_lines(path):
    return path.read_bytes().count(b"\n") if path.is_file() else 0


def workers_of(run):
    return [
        Path("/proc", number)
        for number in Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()
    ]


def await_end(workers):
    """Wait until no worker is left; a test that waits in vain fails."""
    deadline = time.monotonic() + GUARD
    while any(each.exists() for each in workers):
        assert time.monotonic() < deadline, "workers have outlived the run that started them"
        time.sleep(0.05)


def test_rows_hold_metrics_and_what_made_them(rows, tiny):
    assert rows.keys() == {job.key for job in tiny.jobs}
    for row in rows.values():
        assert row.error is None
        assert row.metrics["ate_m"] >= 0.0
        assert row.versions == versions()
        assert row.commit == commit()
        assert len(row.config) == 16
    assert len({row.config for row in rows.values()}) == 6, "one for each world, noise and preset"


def test_killed_at_random_moments_and_resumed_the_rows_are_the_same(rows, tmp_path):
    draw = np.random.default_rng(SEED)
    suite = tmp_path / "tiny.toml"
    out = tmp_path / "out"
    suite.write_text(TINY)
    for _ in range(KILLS):
        # Counted in rows and not in seconds alone, so that slow machines and fast ones are killed
        # in their work.
        enough = count_lines(out / RESULTS) + int(draw.integers(3))
        run = subprocess.Popen(command(suite, out), stderr=subprocess.PIPE, start_new_session=True)
        while run.poll() is None and (
            count_lines(out / RESULTS) < enough or not (out / STAMP).is_file()
        ):
            time.sleep(0.01)
        time.sleep(draw.uniform(0.0, 0.4))
        workers = workers_of(run)
        run.kill()
        _, err = run.communicate()
        await_end(workers)
        assert run.returncode == -signal.SIGKILL, err.decode()
    before = count_lines(out / RESULTS)
    done = subprocess.run(command(suite, out), capture_output=True, text=True, check=True)
    assert f"{len(rows)} of {len(rows)} jobs done, {before} of them before, 0 failed" in done.stdout
    assert comparable(out) == rows


TROUBLED = [Job("env1", 0.0, seed=seed) for seed in range(6)]
REASONS = {
    benchmark_work.RAISES: "ArithmeticError: two lines",
    benchmark_work.KILLED: "its worker was killed by SIGKILL (out of memory?)",
    benchmark_work.EXITS: "its worker ended with exit code 7",
}


def test_a_job_that_dies_is_recorded_with_its_reason_and_the_others_go_on(tmp_path):
    suite = Suite("troubled", tuple(TROUBLED), "d")
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    summary = run_suite(suite, tmp_path, Processes(2, GUARD), work=benchmark_work.troubled)
    rows = {row.seed: row for row in read_rows(tmp_path)}
    assert rows.keys() == {job.seed for job in TROUBLED}
    reasons = {seed: row.error for seed, row in rows.items() if row.error is not None}
    assert reasons == REASONS
    assert dict(summary.failures) == {
        TROUBLED[seed].title: reason for seed, reason in reasons.items()
    }
    one_thread = {**ONE_THREAD, "cv2": 1}
    well = {seed: row.metrics for seed, row in rows.items() if row.error is None}
    assert well == {seed: {"seed": seed, **one_thread} for seed in (0, 4, 5)}
    assert {name: os.environ.get(name) for name in ONE_THREAD} == before, (
        "what is set for workers stays with them"
    )


def test_a_job_that_hangs_is_given_up_and_the_next_one_is_done():
    # Until a worker starts a job its clock does not run, so that a time-out of a second is enough
    # on any machine.
    hangs, well = (replace(TROUBLED[0], seed=seed) for seed in (benchmark_work.HANGS, 0))
    results = dict(Processes(1, 1.0).run([hangs, well], benchmark_work.troubled))
    assert results[hangs] == Failure("time-out: not done after 1 s")
    assert results[well].metrics["seed"] == 0


def test_workers_end_when_the_caller_stops_listening():
    with closing(Processes(2, GUARD).run(TROUBLED, benchmark_work.outcome)) as results:
        assert not isinstance(next(results)[1], Failure)
        assert multiprocessing.active_children()
    assert not multiprocessing.active_children()


def test_a_failed_job_ends_the_command_with_1_and_its_reason(tmp_path):
    (tmp_path / "hasty.toml").write_text(HASTY)
    out = tmp_path / "out"
    done = benchmarks(
        "run",
        "--suite",
        tmp_path / "hasty.toml",
        "--out",
        out,
        "--workers",
        "2",
        "--timeout",
        "0.01",
    )
    assert done.returncode == 1
    assert (
        "failed: env1, 0 cm, paper, frontier, seed 0: time-out: not done after 0.01 s"
        in done.stderr
    )
    assert "2 of 2 jobs done, 2 failed" in done.stdout
    assert all(row.error for row in read_rows(out))


@pytest.fixture
def results(tmp_path):
    """A folder with the results of a suite of well jobs."""
    suite = Suite("well", tuple(TROUBLED[:2]), "d")
    run_suite(suite, tmp_path / "out", Processes(1, GUARD), work=benchmark_work.outcome)
    return tmp_path / "out"


def test_the_command_tabulates(results):
    shown = benchmarks("table", results)
    assert (shown.returncode, shown.stdout) == (0, tables.table(read_rows(results)))
