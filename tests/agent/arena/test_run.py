"""Entries that run: results are resumed after a kill, verified to the bit, and failures of an entry
are its losses.
"""

import json
import os
import subprocess
import sys
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from support.arena import MANIFEST, made_entry
from support.command_line import limslam

from limslam_agent.arena.results import FORMAT, RUNS, STAMP, Row, digest_of, read_results
from limslam_agent.arena.running import Execution, Job, run_entry, run_job
from limslam_agent.arena.scoring import BOUNDS, lost_scores
from limslam_agent.arena.verify import differences, opened, shifts, verify
from limslam_agent.cli.arena import write_kept_run
from limslam_agent.measurements.store import RESULTS, open_store, read_stamp

RANDOM = np.random.default_rng(0)
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


ONE = Execution()


def run_all(entry, plans, folder, seed=0, report=lambda *_: None, **options):
    return run_entry(entry, plans, folder, seed, Execution(**options), report)


def verified(folder, entry, plans):
    """What differs in each plan of a folder, in words."""
    return [
        differences(before, now, is_process=False)
        for before, now in verify(folder, entry, plans, ONE, RANDOM)
    ]


def test_a_run_is_resumed_verified_and_kept(tmp_path, entry, short_plans):
    folder = tmp_path / "out"
    seen = []
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
    assert verified(folder, entry, short_plans[:2]) == [[], []]
    with pytest.raises(ValueError, match="1 plan of 3 has no results, such as plan 2"):
        list(verify(folder, entry, short_plans, ONE, RANDOM))


def test_the_plans_that_are_verified_are_drawn_at_random(tmp_path, entry, short_plans, monkeypatch):
    monkeypatch.setattr(
        "limslam_agent.arena.verify.results_of", lambda todo, _jobs: map(row_of, todo)
    )
    folder = tmp_path / "out"
    plans = [replace(short_plans[0], number=number) for number in range(40)]
    monkeypatch.setattr("limslam_agent.arena.running.run_job", row_of)
    run_all(entry, plans, folder)

    def drawn(seed):
        found = verify(folder, entry, plans, ONE, np.random.default_rng(seed), 5)
        return [now.plan for _, now in found]

    assert len(set(drawn(0))) == 5
    assert drawn(0) == drawn(0)
    assert len({number for seed in range(40) for number in drawn(seed)}) == len(plans)


def row_of(job):
    """The row of an entry that failed at once."""
    metrics = lost_scores(job.plan, "failed: broken")
    settings = digest_of({"plan": job.plan.setting, "entry": job.entry.digest})
    return Row(job.plan.number, job.plan.setting, metrics, settings=settings, error="broken")


def test_failed_plans_are_run_again_when_asked(tmp_path, entry, short_plans):
    folder = tmp_path / "out"
    seen = []
    run_all(entry, short_plans[:1], folder)
    kept = (folder / RESULTS).read_bytes()
    with open_store(FORMAT, folder, read_stamp(FORMAT, folder)) as store:
        failed = lost_scores(short_plans[1], "failed: did not answer within 5 s")
        store.append(
            replace(store.rows[0], plan=1, metrics=failed, error="did not answer within 5 s")
        )
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
    ((difference,),) = verified(folder, entry, short_plans[:1])
    assert difference.startswith("path_m ")
    rewrite(metrics={name: value for name, value in line["metrics"].items() if name != "path_m"})
    ((difference,),) = verified(folder, entry, short_plans[:1])
    assert difference.startswith("path_m missing, now ")
    rewrite(setting={**line["setting"], "noise": 0.0})
    with pytest.raises(ValueError, match="has another setting than the plan"):
        list(verify(folder, entry, short_plans[:1], ONE, RANDOM))
    rewrite(settings="0" * 64)
    with pytest.raises(ValueError, match="is not of this entry"):
        list(verify(folder, entry, short_plans[:1], ONE, RANDOM))
    assert row.plan == 0


def test_a_process_is_verified_within_bounds(entry, short_plans):
    row = run_job(Job(entry, short_plans[0], {}, ""))
    row = replace(row, metrics={name: row.metrics[name] for name in BOUNDS})

    def changed(**metrics):
        return replace(row, metrics={**row.metrics, **metrics})

    coverage = row.metrics["correct_coverage"]
    near = changed(correct_coverage=coverage + 0.04)
    assert differences(row, near, is_process=True) == []
    assert differences(row, near, is_process=False)
    far = {"correct_coverage": coverage + 0.06, "touches": 4, "anees_final": 2.0}
    for name, value in far.items():
        (difference,) = differences(row, changed(**{name: value}), is_process=True)
        assert difference.startswith(f"{name} ")
    newer = changed(a_newer_metric=1.0)
    for is_process in (False, True):
        assert differences(newer, row, is_process=is_process) == ["a_newer_metric 1.0, now missing"]
        assert differences(row, newer, is_process=is_process) == ["a_newer_metric missing, now 1.0"]


@pytest.mark.parametrize("gain", [0.0, 0.02])
def test_scores_of_a_process_that_are_all_better_are_noticed(entry, short_plans, gain):
    row = run_job(Job(entry, short_plans[0], {}, ""))
    generator = np.random.default_rng(3)
    pairs = []
    for before, now in generator.normal(0.5, 0.01, (40, 2)).tolist():
        shares = before + gain, now
        metrics = [{**row.metrics, "correct_coverage": share} for share in shares]
        pairs.append(tuple(replace(row, metrics=each) for each in metrics))
    found = shifts(pairs)
    assert [words.split()[0] for words in found] == (["correct_coverage"] if gain else [])
    assert shifts(pairs[:9]) == []


def test_secret_plans_are_verified_with_their_seed_only(tmp_path, entry):
    folder = tmp_path / "out"
    run_all(entry, [], folder, seed=7)
    with pytest.raises(ValueError, match="--secret-seed is needed"):
        opened(folder, None, None)
    with pytest.raises(ValueError, match="its plans are not those of this seed"):
        opened(folder, None, 8)
    assert opened(folder, None, 7)[0].digest == entry.digest
    with pytest.raises(ValueError, match="has no results yet"):
        list(verify(folder, entry, opened(folder, None, 7)[2], ONE, RANDOM))
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
        (("run", "entry", "--out", "out", "--plans", "500"), "--plans must be a whole number"),
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
import os
from pathlib import Path
number, owners = os.getppid(), set()
while True:
    place = Path("/proc", str(number))
    found = place.joinpath("mem").stat()
    owners.add((found.st_uid, found.st_gid))
    if b"limslam_agent" in place.joinpath("cmdline").read_bytes():
        break
    number = int(place.joinpath("stat").read_text().rpartition(")")[2].split()[1])
os.write(2, f"the memory belongs to {owners}".encode())
os._exit(1)
"""
LIVES_ON = """
import os
import time
for _ in range(2):
    if os.fork() == 0:
        os.setsid()
        open(f"{os.getpid()}.pid", "w").close()
        os.closerange(0, 3)
        time.sleep(600)
os._exit(1)
"""
COMMAND = """name = "Spy"
authors = ["A"]
kind = "command"
command = ["{python}", "spy.py"]
uses = "readings"
"""
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="other systems have no /proc")


def made_spy(folder, program):
    return made_entry(folder, COMMAND, spy=program)


@LINUX
def test_an_entry_does_not_see_the_memory_of_the_processes_above_it(tmp_path):
    made_spy(tmp_path / "spy", SPY)
    words = ("-m", "limslam_agent", "arena", "run", tmp_path / "spy", "--out", tmp_path / "out")
    # The files of a process in /proc belong to the user and the group 0 if its memory is hidden.
    subprocess.run(
        [sys.executable, *words, "--plans", "1", "--jobs", "1", "--secret-seed"],
        input=b"31415926535\n",
        check=False,
        group=65534 if os.geteuid() == 0 else None,
    )
    (row,) = read_results(tmp_path / "out")[1].values()
    assert row.error.endswith("the memory belongs to {(0, 0)}")


@LINUX
def test_what_an_entry_has_started_ends_with_its_plan(tmp_path, short_plans):
    entry = made_spy(tmp_path / "spy", LIVES_ON)
    (row,) = run_all(entry, short_plans[:1], tmp_path / "out")
    assert "ended without stopping the robot" in row.error
    started = [int(path.stem) for path in entry.folder.glob("*.pid")]
    assert len(started) == 2
    assert not [number for number in started if Path("/proc", str(number)).exists()]


def test_a_user_that_does_not_exist_is_refused(tmp_path, short_plans):
    entry = made_spy(tmp_path / "spy", LIVES_ON)
    with pytest.raises(ValueError, match=r"there is no user 'nobody_here'|only root can"):
        run_all(entry, short_plans[:1], tmp_path / "out", user="nobody_here")


@LINUX
def test_a_command_has_the_rights_of_the_chosen_user(tmp_path, short_plans):
    shell = COMMAND.replace('["{python}", "spy.py"]', '["sh", "-c", "id -un >&2; exit 1"]')
    entry = made_entry(tmp_path / "spy", shell)
    if os.geteuid() != 0:
        with pytest.raises(ValueError, match="only root can run a command as another user"):
            run_all(entry, short_plans[:1], tmp_path / "out", user="nobody")
        return
    (row,) = run_all(entry, short_plans[:1], tmp_path / "out", user="nobody")
    assert row.error.endswith("nobody")
