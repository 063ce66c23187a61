"""Entries that run: results are resumed after a kill, verified to the bit, and failures of an entry
are its losses.
"""

import json
import subprocess
import sys
from dataclasses import replace
from io import StringIO

import pytest
from support.arena import MANIFEST, made_entry
from support.command_line import limslam

from limslam_agent.arena.results import FORMAT, RUNS, STAMP, read_results
from limslam_agent.arena.running import Job, run_entry, run_job
from limslam_agent.arena.verify import differences, opened, verify
from limslam_agent.cli.arena import write_kept_run
from limslam_agent.measurements.store import RESULTS, open_store, read_stamp

PYTHON = MANIFEST.replace(
    'kind = "shipped"\nrun = "random"', 'kind = "python"\nrun = "mine.py:Mine"'
)
POLICY = """
import numpy as np

class Mine:
    stop_reason, plan = None, np.zeros((0, 2))

    def act(self, belief):
        {body}
"""
ACTOR = """
class Mine:
    done, steps = False, 0

    def reset(self, start_pose, seed):
        self.steps = 0

    def act(self, observation):
        self.steps += 1
        self.done = self.steps > 5
        return [0.5, 0.5]
"""


def run_all(entry, plans, folder, **options):
    return run_entry(entry, plans, folder, **{"seed": 0, "jobs": 1, **options})


def test_a_run_is_resumed_verified_and_kept(tmp_path, entry, short_plans):
    folder, seen = tmp_path / "out", []
    run_all(entry, short_plans[:1], folder, keep=write_kept_run)
    whole = (folder / RESULTS).read_bytes()
    (folder / RESULTS).write_bytes(whole + b'{"plan": 1, "sett')  # killed while it wrote
    rows = run_all(
        entry, short_plans[:2], folder, report=lambda row, count: seen.append((row.plan, count))
    )
    assert seen == [(1, 2)]
    assert [row.plan for row in rows] == [0, 1]
    assert (folder / RESULTS).read_bytes().startswith(whole)
    assert (folder / RUNS / "000" / "run.toml").is_file()
    assert rows[0].metrics["lost"] == "not explored in time"
    assert rows[0].metrics["plan_time_to_95_s"] == 2.0
    assert rows[0].versions["limslam"]
    assert rows[1].setting["robots"] == 2
    assert list(verify(folder, entry, short_plans, None, 1)) == [(0, []), (1, [])]


def test_failed_plans_are_run_again_when_asked(tmp_path, entry, short_plans):
    folder, seen = tmp_path / "out", []
    run_all(entry, short_plans[:1], folder)
    kept = (folder / RESULTS).read_bytes()
    with open_store(FORMAT, folder, read_stamp(FORMAT, folder)) as store:
        store.append(replace(store.rows[0], plan=1, error="did not answer within 5 s"))
    assert run_all(entry, short_plans[:2], folder)[1].error
    run_all(
        entry, short_plans[:1], folder, retry_failed=True
    )  # the failed plan is not among the chosen ones
    assert (folder / RESULTS).read_bytes() != kept
    rows = run_all(
        entry,
        short_plans[:2],
        folder,
        retry_failed=True,
        report=lambda row, _: seen.append(row.plan),
    )
    assert seen == [1]
    assert [row.error for row in rows] == [None, None]
    assert (folder / RESULTS).read_bytes().startswith(kept)


def test_a_policy_of_a_file_drives_every_robot(tmp_path, short_plans):
    entry = made_entry(
        tmp_path / "mine", PYTHON.format(name="Mine"), mine=POLICY.format(body="return [0.5, 0.4]")
    )
    row = run_job(Job(entry, short_plans[1], {}, ""))
    assert row.error is None
    assert row.metrics["path_m"] == pytest.approx(2.0 * 0.45 * 0.3, rel=0.05)


def test_an_actor_ends_a_run_that_is_lost(tmp_path, short_plans):
    manifest = PYTHON.replace('"belief"', '"readings"')
    entry = made_entry(tmp_path / "mine", manifest.format(name="Mine"), mine=ACTOR)
    metrics = run_job(Job(entry, short_plans[0], {}, "")).metrics
    assert (metrics["lost"], metrics["claims_done"]) == ("claims to be done and is not", True)
    assert metrics["end_time_s"] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("return 1 / 0", "mine.py, line 8, in act: ZeroDivisionError: division by zero"),
        ("return [2.0]", "Mine: act must return two finite numbers"),
    ],
)
def test_a_failure_of_the_entry_is_its_loss(tmp_path, short_plans, body, reason):
    entry = made_entry(tmp_path / "mine", PYTHON.format(name="Mine"), mine=POLICY.format(body=body))
    row = run_job(Job(entry, short_plans[0], {}, ""))
    assert reason in row.error
    assert row.metrics["lost"].startswith("failed: ")
    assert row.metrics["plan_time_to_95_s"] == 2.0


def test_results_of_something_else_are_not_continued(tmp_path, entry, short_plans):
    folder = tmp_path / "out"
    run_all(entry, [], folder)
    other = made_entry(tmp_path / "other", MANIFEST.format(name="Other"))
    with pytest.raises(ValueError, match="holds results of another entry"):
        run_all(other, short_plans, folder)
    with pytest.raises(ValueError, match="holds results of other plans"):
        run_all(entry, short_plans, folder, seed=5)
    with pytest.raises(ValueError, match="lies in the folder of the entry"):
        run_all(entry, short_plans, entry.folder / "out")


def test_rows_that_were_changed_are_noticed(tmp_path, entry, short_plans):
    folder = tmp_path / "out"
    (row,) = run_all(entry, short_plans[:1], folder)
    line = json.loads((folder / RESULTS).read_text())

    def rewrite(**changes):
        (folder / RESULTS).write_text(json.dumps({**line, **changes}) + "\n")

    rewrite(metrics={**line["metrics"], "path_m": line["metrics"]["path_m"] + 1e-12})
    ((_, (difference,)),) = verify(folder, entry, short_plans, 1, 1)
    assert difference.startswith("path_m ")
    rewrite(setting={**line["setting"], "noise": 0.0})
    with pytest.raises(ValueError, match="has another setting than the plan"):
        list(verify(folder, entry, short_plans, 1, 1))
    rewrite(settings="0" * 64)
    with pytest.raises(ValueError, match="is not of this entry"):
        list(verify(folder, entry, short_plans, 1, 1))
    assert row.plan == 0


def test_a_process_is_verified_within_bounds(entry, short_plans):
    row = run_job(Job(entry, short_plans[0], {}, ""))
    near, far = (
        {**row.metrics, "correct_coverage": row.metrics["correct_coverage"] + off}
        for off in (0.04, 0.06)
    )
    made = [type(row)(row.plan, row.setting, metrics) for metrics in (near, far)]
    assert differences(row, made[0], is_process=True) == []
    assert differences(row, made[0], is_process=False)
    newer = type(row)(row.plan, row.setting, {**row.metrics, "a_newer_metric": 1.0})
    assert differences(row, newer, is_process=False) == []
    assert differences(row, made[1], is_process=True)[0].startswith("correct_coverage ")


def test_secret_plans_are_verified_with_their_seed_only(tmp_path, entry):
    folder = tmp_path / "out"
    run_all(entry, [], folder, seed=7)
    with pytest.raises(ValueError, match="--secret-seed is needed"):
        opened(folder, None, None)
    with pytest.raises(ValueError, match="its plans are not those of this seed"):
        opened(folder, None, 8)
    assert opened(folder, None, 7)[0].digest == entry.digest
    with pytest.raises(ValueError, match="has no results yet"):
        list(verify(folder, entry, opened(folder, None, 7)[2], None, 1))
    (entry.folder / "more.txt").touch()
    with pytest.raises(ValueError, match="was changed since"):
        opened(folder, None, 7)


def test_a_stamp_that_was_changed_is_noticed(tmp_path, entry):
    folder = tmp_path / "out"
    run_all(entry, [], folder)
    stamp = json.loads((folder / STAMP).read_text())

    def rewrite(**changes):
        (folder / STAMP).write_text(json.dumps({**stamp, **changes}))

    rewrite(entry={**stamp["entry"], "name": "Another"})
    with pytest.raises(ValueError, match="its manifest is not that of"):
        opened(folder, None, None)
    rewrite(is_secret=True)
    with pytest.raises(ValueError, match="is_secret is True, and its plans say otherwise"):
        opened(folder, None, 0)
    rewrite(entry={**stamp["entry"], "kind": "\n"})
    with pytest.raises(ValueError, match=r"arena\.json: is damaged: entry: kind: ") as refusal:
        opened(folder, None, None)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("run", "nowhere", "--out", "out"), "there is no such folder"),
        (("run", "entry", "--out", "out", "--plans", "500"), "Invalid value for '--plans'"),
        (
            ("run", "entry", "--out", "out", "--secret-seed"),
            "a whole number of 0 or more from standard input",
        ),
        (("verify", "nowhere"), "holds no results of the arena"),
        (("page", "nowhere", "--out", "board.txt"), "a page ends in .html"),
    ],
)
def test_bad_input_is_refused_with_one_line(tmp_path, entry, words, reason, monkeypatch):
    assert entry.folder == tmp_path / "entry"
    monkeypatch.setattr("sys.stdin", StringIO("-1\n"))
    finished = limslam("arena", *words, cwd=tmp_path)
    assert finished.returncode == 2
    assert reason in finished.stderr
    assert len(finished.stderr.splitlines()) == 1


SPY = """
import os, sys
from pathlib import Path
number, seen = os.getpid(), b""
while number > 1:
    place = Path("/proc", str(number))
    seen += place.joinpath("cmdline").read_bytes() + place.joinpath("environ").read_bytes()
    number = int(place.joinpath("stat").read_text().rpartition(")")[2].split()[1])
command = "a command" if b"arena" in seen else "nothing"
sys.exit("the seed was seen" if b"31415926535" in seen else f"only {command} was seen")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no /proc")
def test_an_entry_does_not_see_the_secret_seed_in_the_processes_above_it(tmp_path):
    folder = tmp_path / "spy"
    folder.mkdir()
    (folder / "spy.py").write_text(SPY)
    (folder / "entry.toml").write_text(
        'name = "Spy"\nauthors = ["A"]\nkind = "command"\ncommand = ["{python}", "spy.py"]\nuses '
        '= "readings"\n'
    )
    words = [
        sys.executable,
        "-m",
        "limslam_agent",
        "arena",
        "run",
        folder,
        "--out",
        tmp_path / "out",
    ]
    subprocess.run(
        [*words, "--plans", "1", "--jobs", "1", "--secret-seed"],
        input=b"31415926535\n",
        check=False,
    )
    (row,) = read_results(tmp_path / "out")[1].values()
    assert "only a command was seen" in row.error
