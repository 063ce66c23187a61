"""Entries of the arena: manifests, processes, plans, and scores."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.arena import MANIFEST, made_entry

from limslam_agent.arena import command
from limslam_agent.arena.command import CommandActor
from limslam_agent.arena.entry import read_entry
from limslam_agent.arena.scoring import correct_coverage, exploration_scores, loss
from limslam_agent.arena.tracks import COUNT, plans_of
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.runs.policy_file import made_by_file
from limslam_env import RobotSpec

GOOD = MANIFEST.format(name="Mine")


def test_the_shipped_entries_can_be_read(examples):
    found = {folder.name: read_entry(folder).manifest for folder in sorted(examples.iterdir())}
    assert {"random", "wall_follower", "frontier", "learned"} <= set(found)


def test_learned_explorers_that_share_nothing_have_a_map_each(examples):
    entry = read_entry(examples / "learned_alone")
    robots = made_by_file(entry.run, RobotSpec(), PolicyConfig(), robots=2, seed=0)
    for number, robot in enumerate(robots):
        robot.reset(np.array([float(number), 0.0, 0.0]))
        robot.act(
            {"ranges": np.full(6, 0.5, dtype=np.float32), "wheels": np.zeros(2, dtype=np.float32)}
        )
    first, second = (robot.mapper.belief for robot in robots)
    assert first.pose[0] == pytest.approx(0.0, abs=0.01)
    assert second.pose[0] == pytest.approx(1.0, abs=0.01)
    assert len(first.other_poses) == 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "Mine"\n', "", "entry.toml: name: is missing"),
        (
            'kind = "shipped"',
            'kind = "magic"',
            "kind: must be one of shipped, python, command, not 'magic'",
        ),
        ('uses = "belief"', 'uses = "truth"', "uses: must be one of belief, readings, not 'truth'"),
        ('run = "random"', 'run = "tour"', "can be chosen, not 'tour'"),
        ("robots = 2", "speed = 2", "speed"),
        ('run = "random"', 'command = ["drive"]', "a command has the key command"),
        (
            'kind = "shipped"\nrun = "random"',
            'kind = "python"\nrun = "../mine.py:Mine"',
            "not in the folder",
        ),
        ('name = "Mine"', "name = ", "is not TOML"),
    ],
)
def test_a_manifest_that_cannot_be_used_is_refused_in_one_line(tmp_path, old, new, message):
    assert old in GOOD
    with pytest.raises(ValueError, match=r"(?s).*") as refusal:
        made_entry(tmp_path / "mine", GOOD.replace(old, new))
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("place", [".hidden", "__pycache__"])
def test_what_is_run_is_part_of_the_digest(tmp_path, place):
    mine = tmp_path / "mine"
    made_entry(mine, GOOD)
    (mine / place).mkdir()
    (mine / place / "mine.py").write_text("class Mine: pass")
    kinds = (
        'kind = "python"\nrun = "{}/mine.py:Mine"',
        'kind = "command"\ncommand = ["{{python}}", "{}/mine.py"]',
    )
    for kind in kinds:
        manifest = GOOD.replace('kind = "shipped"\nrun = "random"', kind.format(place)).replace(
            "belief", "readings"
        )
        (mine / "entry.toml").write_text(manifest)
        with pytest.raises(ValueError, match="not part of the entry's digest"):
            read_entry(mine)


def test_a_link_to_a_folder_is_refused(tmp_path):
    first = made_entry(tmp_path / "mine", GOOD)
    (tmp_path / "elsewhere").mkdir()
    (first.folder / "code").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ValueError, match="code: is a link to a folder"):
        read_entry(first.folder)


def test_the_digest_covers_all_files_but_what_python_compiled(tmp_path):
    first = made_entry(tmp_path / "mine", GOOD)
    (tmp_path / "mine" / "__pycache__").mkdir()
    (tmp_path / "mine" / "__pycache__" / "x.pyc").write_bytes(b"x")
    assert read_entry(first.folder).digest == first.digest
    (tmp_path / "mine" / "weights.bin").write_bytes(b"x")
    assert read_entry(first.folder).digest != first.digest


ROBOT = RobotSpec()
SEEN = {
    "ranges": np.full(6, 1.5, dtype=np.float32),
    "wheels": np.array([0.01022, 0.02033], dtype=np.float32),
}


@pytest.fixture
def started(tmp_path, monkeypatch):
    monkeypatch.setattr(command, "_ENDING", 0.1)
    actors = []

    def start(program):
        (tmp_path / "drive.py").write_text(program)
        actors.append(CommandActor(("{python}", "drive.py"), tmp_path, ROBOT))
        actors[-1].reset(np.zeros(3), 0)
        return actors[-1]

    yield start
    for actor in actors:
        actor.close()


def test_the_example_drives_and_is_repeated_to_the_bit(examples):
    def driven():
        actor = CommandActor(("{python}", "drive.py"), examples / "line_protocol", ROBOT)
        actor.reset(np.zeros(3), 0)
        near = {**SEEN, "ranges": np.full(6, 0.2, dtype=np.float32)}
        speeds = [actor.act(seen) for seen in (SEEN, SEEN, near)]
        actor.close()
        return np.array(speeds)

    first = driven()
    assert first[0] == pytest.approx([0.8, 0.23 / 0.3], abs=1e-9)
    assert first[2] == pytest.approx([0.5, -0.5])
    np.testing.assert_array_equal(first, driven())


def test_it_gets_ticks_and_mm_and_ends_by_a_stop(started):
    actor = started(
        """
import binascii, sys
def say(body):
    print(f"{body}*{binascii.crc_hqx(body.encode(), 0xFFFF):04X}", flush=True)
print("some words of its own", flush=True)
for line in sys.stdin:
    if line[0] == "H":
        say("Q,1,1")
    elif line.split(",")[3:5] == ["204", "406"]:
        say("X,3")
    else:
        assert "65535" in line and line.split(",")[3:5] == ["102", "203"], line
        say("V,2,0,300,-300")
"""
    )
    np.testing.assert_array_equal(actor.act(SEEN), [1.0, -1.0])
    assert not actor.done
    np.testing.assert_array_equal(actor.act(SEEN), [0.0, 0.0])
    assert actor.done
    assert actor.stop_reason == "the command has stopped the robot"


def test_a_process_that_ends_is_named(started):
    with pytest.raises(
        ValueError, match="the command has ended without stopping the robot: ZeroDivisionError"
    ):
        started("1 / 0").act(SEEN)


def test_a_process_that_ends_without_an_error_has_given_up(started):
    actor = started(GREETING)
    np.testing.assert_array_equal(actor.act(SEEN), [0.0, 0.0])
    assert actor.done
    assert actor.stop_reason == "the command has ended by itself: not explored"


@pytest.mark.parametrize(
    ("limit", "task"), [("GREETING_WITHIN", "greet the robot"), ("ANSWER_WITHIN", "answer")]
)
def test_a_process_that_is_silent_is_named(started, monkeypatch, limit, task):
    greet = GREETING if limit == "ANSWER_WITHIN" else ""
    monkeypatch.setattr(command, limit, 0.05 if limit == "GREETING_WITHIN" else 0.5)
    with pytest.raises(ValueError, match=f"the command did not {task} within"):
        started(greet + "import time\ntime.sleep(60)").act(SEEN)


GREETING = "import sys\nsys.stdin.readline()\nprint('Q,1,0*515E', flush=True)\n"


def test_a_command_that_does_not_exist_is_refused(tmp_path):
    actor = CommandActor(("no-such-program-at-all",), tmp_path, ROBOT)
    with pytest.raises(ValueError, match="no-such-program-at-all: cannot be started"):
        actor.reset(np.zeros(3), 0)


def test_a_seed_gives_its_own_plans_every_time():
    assert plans_of(7) == plans_of(7)
    assert len(plans_of(7)) == COUNT
    assert not {plan.world for plan in plans_of(7)} & {plan.world for plan in plans_of()}


def test_faults_are_in_the_simulator_and_not_in_what_is_told():
    plans = {plan.fault: plan for plan in plans_of()}
    assert abs(plans["wheels"].true_noise.wheel_mismatch) == 0.02
    assert plans["dropout"].true_noise.dropout == 0.1
    assert plans["sharp"].true_noise.fold_back > 0.0
    assert plans["none"].true_noise == type(plans["none"].true_noise)()


PLAN = replace(plans_of()[0], max_time=100.0)
TIME = np.array([0.0, 10.0, 20.0, 30.0])
COVERAGE = np.array([0.1, 0.8, 0.96, 0.99])


def floor():
    """A floor of 2 x 3 m, all of which can be seen."""
    return SimpleNamespace(coverable=np.ones((20, 30), dtype=bool), low=np.zeros(2))


def free(shift=0.0, columns=30):
    """A map that calls the left part of that floor free, moved to the right by some metres."""
    x, y = np.meshgrid(np.arange(columns), np.arange(20))
    centres = np.column_stack((0.1 * (x.ravel() + 0.5) + shift, 0.1 * (y.ravel() + 0.5)))
    return SimpleNamespace(
        free=np.ones(len(centres), dtype=bool), centres=lambda index: centres[index.ravel()]
    )


@pytest.mark.parametrize(
    ("seen_columns", "grid", "share"),
    [
        (30, free(), 1.0),
        (15, free(), 0.5),  # a map of what was never seen
        (30, free(columns=14), 0.5),  # cells beside a free cell count
        (30, free(shift=0.1), 1.0),
        (30, free(shift=0.6), 25 / 30),
        (30, free(shift=9.0), 0.0),
        (30, free(columns=0), 0.0),
    ],
)
def test_coverage_is_correct_where_it_was_seen_and_the_map_says_so(seen_columns, grid, share):
    seen = np.zeros((20, 30), dtype=bool)
    seen[:, :seen_columns] = True
    assert correct_coverage(floor(), seen, grid) == pytest.approx(share)


def test_a_plan_takes_the_time_to_its_coverage():
    scores = exploration_scores(PLAN, TIME, COVERAGE, 0.97, is_finished=True)
    assert (scores["plan_time_to_80_s"], scores["plan_time_to_95_s"], scores["lost"]) == (
        10.0,
        20.0,
        "",
    )


def test_the_time_since_the_last_new_cell_is_that_of_the_end():
    waited = np.append(TIME, [40.0, 55.0]), np.append(COVERAGE, [0.99, 0.99])
    assert exploration_scores(PLAN, *waited, 0.97, is_finished=True)["since_new_s"] == 25.0
    assert exploration_scores(PLAN, TIME, COVERAGE, 0.97, is_finished=True)["since_new_s"] == 0.0


def test_a_lost_plan_takes_the_longest_time():
    scores = exploration_scores(PLAN, TIME, COVERAGE, 0.94, is_finished=True)
    assert (scores["plan_time_to_80_s"], scores["plan_time_to_95_s"]) == (100.0, 100.0)
    assert scores["time_to_95_s"] == 20.0
    assert scores["lost"] == "claims to be done and is not"
    assert loss(0.94, is_finished=False) == "not explored in time"
