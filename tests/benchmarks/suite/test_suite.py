"""Suite files, the jobs that they make, and faults of robots in them."""

from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from support.command_line import benchmarks

from benchmarks.suite.faults import Fault, fault_begins, fault_scores
from benchmarks.suite.jobs import Job
from benchmarks.suite.runner import run_config, run_job
from benchmarks.suite.suite import load_suite, shipped_suites
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.run_config import RunConfig

HEAD = 'name = "tiny"\ndescription = "A few."\n'
GRID = HEAD + '[[grid]]\nworlds = ["env1"]\nnoises = [0.02]\nseeds = [0]\n'
WORLD = (
    'name = "box"\nsize = [4, 3]\nwalls = [[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, '
    "{y}]]\n"
    "starts = [[1.0, 1.0, 0.0]]\n"
)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def parse_suite(text, first_seed=None):
    Path("my.toml").write_text(text)
    return load_suite("my.toml", first_seed)


def refusal(text):
    with pytest.raises(ValueError) as caught:
        parse_suite(text)
    assert str(caught.value).startswith("my.toml: ")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_grid_is_a_product_with_defaults():
    suite = parse_suite(
        HEAD
        + (
            '[[grid]]\nworlds = ["env1", "env2"]\nnoises = [0, 0.02]\nrobots = [1, 2]\nseeds = '
            "{first = 3, count = 2}"
        )
    )
    assert len(suite.jobs) == 2 * 2 * 2 * 2
    assert {(job.world, job.noise, job.robots, job.seed) for job in suite.jobs} == {
        (world, noise, robots, seed)
        for world in ("env1", "env2")
        for noise in (0.0, 0.02)
        for robots in (1, 2)
        for seed in (3, 4)
    }
    assert {
        (job.preset, job.policy, job.ablation, job.laps, job.max_time, job.limit)
        for job in suite.jobs
    } == {("paper", "frontier", None, 0, 1800.0, False)}
    assert all(isinstance(job.noise, float) for job in suite.jobs), (
        "0 and 0.0 are one noise, and one key"
    )


def test_each_grid_begins_with_the_seed_that_is_asked_for():
    text = GRID.replace("[0]", "[3, 5]") + GRID.removeprefix(HEAD).replace(
        "env1", "random:seed:18x12"
    )
    jobs = parse_suite(text, first_seed=1000).jobs
    assert [(job.world, job.seed) for job in jobs] == [
        ("env1", 1000),
        ("env1", 1002),
        ("random:1000:18x12", 1000),
    ]
    assert [job.world for job in parse_suite(text).jobs] == ["env1", "env1", "random:0:18x12"]


def test_faults_begin_when_the_seed_says():
    jobs = parse_suite(
        GRID.replace("[0]", "[0, 1]") + "faults = ['kidnapped', 'jump']\nuntil = 'walls'\n"
    ).jobs
    assert [job.identity["policy"] for job in jobs] == ["kidnapped"] * 2 + ["jump"] * 2
    carried, again, jump, _ = (run_config(job) for job in jobs)
    assert 80.0 <= carried.kidnap_at <= 120.0
    assert carried.max_time == jump.max_time == carried.kidnap_at + 40.0
    assert (again.kidnap_at != carried.kidnap_at, jump.kidnap_at) == (True, None)
    assert carried.agent.policy.until == "walls"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("name = ", "is not TOML"),
        ('name = "tiny"\n', "description: is missing"),
        (GRID.replace('"tiny"', '"../tiny"'), "name: '../tiny'"),
        (HEAD, "grid: is missing"),
        (
            GRID.replace("env1", "env9"),
            "[[grid]] 1: env9, 2 cm, paper, frontier, seed 0: no world is called 'env9'",
        ),
        (
            GRID.replace("env1", "random:9..3"),
            "[[grid]] 1: worlds: 'random:9..3' names no floor plans",
        ),
        (
            GRID.replace("0.02", "-0.02"),
            "noise must be a number from 0 to 1000, not -0.02",
        ),
        (GRID + "presets = ['best']\n", "no preset is called 'best'"),
        (GRID + "robots = [0]\n", "robots must be a whole number from 1 to 8, not 0"),
        (
            GRID + "faults = ['drunk']\n",
            "no fault is called 'drunk'; there are kidnapped, reversed",
        ),
        (GRID + "faults = ['jump']\nfault_time = [10, 9]\n", "fault_time: must be two times"),
        (GRID + "faults = ['jump']\nrobots = [2]\n", "faults are for one robot that explores"),
        (
            GRID.replace("[0]", "[-1]"),
            "[[grid]] 1: seed must be a whole number from 0 to",
        ),
        (GRID.replace("[0]", "{first = 0, count = 9000000000000}"), "a grid has 1 to 5000 seeds"),
        (
            GRID.replace('["env1"]', '["random:0..999999"]').replace(
                "[0]", "{first = 0, count = 5000}"
            ),
            "a suite has at most 5000 jobs, and these are more",
        ),
        (
            GRID.replace("[0]", "{first = 0, count = 3000}")
            + GRID[GRID.index("[[grid]]") :].replace("[0]", "{first = 3000, count = 3000}"),
            "a suite has at most 5000 jobs, and these are more",
        ),
        (
            GRID.replace("[0]", "[0, 0]"),
            "2 jobs are the same to the tables: env1, 2 cm, paper, frontier, seed 0",
        ),
    ],
)
def test_what_is_wrong_is_refused_with_file_and_key(text, reason):
    assert reason in refusal(text)


@pytest.mark.parametrize("suite", ["plans", "large"])
def test_without_the_data_folder_one_line_says_so(suite, monkeypatch, tmp_path):
    monkeypatch.setenv("LIMSLAM_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(
        ValueError, match=rf"{suite}.toml: .*recorded data not found in .*nowhere: set LIMSLAM_DATA"
    ):
        load_suite(suite)


def test_the_digest_knows_jobs_and_the_contents_of_worlds(tmp_path):
    box = tmp_path / "box.toml"
    box.write_text(WORLD.format(y=0))
    text = GRID.replace("env1", str(box))
    suites = [
        parse_suite(each)
        for each in (text, text.replace("A few.", "Few."), text.replace("[0]", "[1]"))
    ]
    assert suites[0].digest == suites[1].digest != suites[2].digest
    box.write_text(WORLD.format(y=0.5).replace("[0, 3, 0, 0.5]", "[0, 3, 0, 0.5], [0, 0.5, 0, 0]"))
    assert parse_suite(text).digest != suites[0].digest


def test_the_shipped_suites():
    assert set(shipped_suites()) == {
        "smoke",
        "paper",
        "consistent",
        "ablations",
        "limits",
        "noise",
        "random",
        "plans",
        "explore",
        "explorations",
        "kidnapped",
        "faults",
        "large",
    }
    for name in {*shipped_suites()} - {"plans", "large"}:
        suite = load_suite(name)
        assert suite.name == name
    assert len(load_suite("smoke").jobs) >= 12
    counts = Counter(job.fault for name in ("kidnapped", "faults") for job in load_suite(name).jobs)
    assert counts == {"kidnapped": 20, "reversed": 5, "jump": 5, "delayed": 10}


def test_the_papers_suite_is_the_papers_grid():
    jobs = load_suite("paper").jobs
    grid = [job for job in jobs if not job.laps]
    assert {(job.world, job.noise, job.robots, job.seed) for job in grid} == {
        (world, noise, robots, seed)
        for world in ("env1", "env2", "env3")
        for noise in (0.0, 0.02, 0.04)
        for robots in (1, 2)
        for seed in range(10)
    }
    laps = [job for job in jobs if job.laps]
    assert {(job.world, job.noise, job.laps, job.seed) for job in laps} == {
        ("square", noise, 4, seed) for noise in (0.0, 0.02, 0.04) for seed in range(10)
    }
    assert len(grid) + len(laps) == 210


def test_a_dry_run_lists_the_jobs_and_runs_none(tmp_path):
    out = tmp_path / "out"
    done = benchmarks("run", "--suite", "smoke", "--dry-run", "--out", out)
    lines = done.stdout.splitlines()
    assert lines[0] == load_suite("smoke").jobs[0].title
    assert lines[-1] == f"smoke: {len(lines) - 1} jobs"
    assert not out.exists()


OK = 0
UNSURE = 1
LOST = 2


def episode_of(levels, errors, *, turned=0.0, kidnapped=True):
    """A run whose fault begins in its third step, with the status and the error (m) of each
    step.
    """
    steps = len(levels)
    estimated = np.column_stack((errors, np.zeros(steps), np.full(steps, turned)))
    return SimpleNamespace(
        time=0.1 * np.arange(steps),
        true=np.zeros((steps, 1, 3)),
        estimated=estimated[:, None],
        levels=np.array(levels)[:, None],
        config=SimpleNamespace(
            robot=SimpleNamespace(control_period=0.1), kidnap_at=0.2 if kidnapped else None
        ),
    )


def scores(*args, **kwargs):
    found = fault_scores(episode_of(*args, **kwargs), 0.2)
    return {name.removeprefix("fault_"): value for name, value in found.items()}


def test_a_robot_that_is_noticed_and_placed():
    found = scores([OK, UNSURE, OK, UNSURE, LOST, LOST, UNSURE, UNSURE], [0, 0, 5, 5, 5, 5, 5, 0.4])
    assert found == pytest.approx(
        {
            "at_s": 0.2,
            "alarms_before_s": 0.1,
            "doubted_s": 0.1,
            "lost_s": 0.2,
            "placed_s": 0.5,
            "wrong_place_s": 0.1,
            "wrong_place_ok_s": 0.0,
            "unnoticed_s": 0.1,
        }
    )


def test_a_robot_that_is_never_noticed_is_ok_though_it_is_wrong():
    found = scores([OK] * 6, [0, 0, 5, 5, 5, 5])
    assert (found["doubted_s"], found["lost_s"], found["placed_s"]) == (None, None, None)
    assert found["unnoticed_s"] == pytest.approx(0.4)
    assert found["wrong_place_s"] == 0.0


def test_a_place_with_a_wrong_heading_is_a_wrong_place():
    found = scores([OK, OK, LOST, OK], [0, 0, 5, 0.1], turned=0.5)
    assert found["placed_s"] is None
    assert found["wrong_place_ok_s"] == pytest.approx(0.1)


def test_a_run_that_ends_before_its_fault_is_a_failure():
    with pytest.raises(
        ValueError, match=r"the exploration ended after 0.1 s, before the fault at 0.2 s"
    ):
        scores([OK, OK], [0, 0])


def test_faults_begin_at_whole_steps_within_their_time():
    begins = [
        fault_begins(Job("env1", 0.0, fault="jump", fault_time=(60.0, 90.0), seed=seed))
        for seed in range(50)
    ]
    assert min(begins) >= 60.0
    assert max(begins) <= 90.0
    assert max(begins) - min(begins) > 20.0
    assert np.allclose(np.array(begins) * 10, np.round(np.array(begins) * 10))
    assert fault_begins(Job("env1", 0.0)) is None


def test_the_agent_gets_the_altered_readings():
    config = RunConfig("env1", 0.0, max_time=1.0, until="seen")
    healthy = run_episode(config)
    faulty = run_episode(config, alter=Fault("jump", 0.5).altered)
    jumped = np.flatnonzero((faulty.wheels[:, 0] > 4.0).all(axis=1))
    assert jumped.tolist() == [5]
    np.testing.assert_array_equal(faulty.wheels[:5], healthy.wheels[:5])
    assert faulty.levels[5, 0] > healthy.levels[5, 0] == OK


def test_a_job_with_a_fault_says_what_became_of_it():
    outcome = run_job(
        Job(
            "env1",
            0.02,
            preset="consistent",
            until="walls",
            fault="jump",
            fault_time=(2.0, 3.0),
            after_fault=1.0,
        )
    )
    assert 2.0 <= outcome.metrics["fault_at_s"] <= 3.0
    assert outcome.metrics["fault_doubted_s"] == 0.0
