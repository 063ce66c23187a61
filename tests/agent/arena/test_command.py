"""Entries that are processes: the line protocol over standard input and output."""

import numpy as np
import pytest

from limslam_agent.arena import command
from limslam_agent.arena.command import CommandActor
from limslam_env.interface import RobotSpec

ROBOT = RobotSpec()
SEEN = {"ranges": np.full(6, 1.5, dtype=np.float32), "wheels": np.array([0.01022, 0.02033], dtype=np.float32)}


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
    with pytest.raises(ValueError, match="the command has ended without stopping the robot: ZeroDivisionError"):
        started("1 / 0").act(SEEN)


@pytest.mark.parametrize(("limit", "task"), [("GREETING_WITHIN", "greet the robot"), ("ANSWER_WITHIN", "answer")])
def test_a_process_that_is_silent_is_named(started, monkeypatch, limit, task):
    greet = GREETING if limit == "ANSWER_WITHIN" else ""
    monkeypatch.setattr(command, limit, 0.05 if limit == "GREETING_WITHIN" else 0.5)
    with pytest.raises(ValueError, match=f"the command did not {task} within"):
        started(greet + "import time\ntime.sleep(60)").act(SEEN)


GREETING = "import sys\nsys.stdin.readline()\nprint('Q,1,0*515E', flush=True)\n"


def test_a_process_that_writes_without_end_is_named(started, monkeypatch):
    monkeypatch.setattr(command, "ANSWER_WITHIN", 0.3)
    with pytest.raises(ValueError, match="did not answer within"):
        started(GREETING + "while True:\n    print('words')").act(SEEN)


def test_a_command_that_does_not_exist_is_refused(tmp_path):
    actor = CommandActor(("no-such-program-at-all",), tmp_path, ROBOT)
    with pytest.raises(ValueError, match="no-such-program-at-all: cannot be started"):
        actor.reset(np.zeros(3), 0)
