"""The README does what it says."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from limslam_env.worlds.formats.toml import parse_world

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def test_the_first_example_explores_env1():
    result = subprocess.run([sys.executable, "-c", blocks("python")[0]], capture_output=True, text=True, check=True)
    share, seconds, walls = re.match(r"(\d+)% seen after (\d+) s, (\d+) walls", result.stdout).groups()
    assert int(share) >= 95
    assert int(seconds) < 600
    assert int(walls) >= 16


def test_the_example_world_can_be_lived_in():
    world = parse_world(blocks("toml")[0], "README.md")
    world.check(radius=0.1)


def test_the_two_commands_make_all_that_they_need():
    first, second = (block.strip() for block in blocks("sh")[:2])
    for command, last in ((first, ".venv/bin/limslam"), (second, ".venv/bin/pytest")):
        steps = [shlex.split(step) for step in command.split("&&")]
        assert steps[0] == ["python3", "-m", "venv", ".venv"]
        assert steps[1][:2] == [".venv/bin/pip", "install"]
        assert steps[2][0] == last


@pytest.mark.parametrize("command", [line for block in blocks("sh") for line in block.splitlines() if line])
def test_every_option_in_a_shell_example_exists(command):
    words = shlex.split(command.split("&&")[-1])
    if not words[0].endswith("limslam"):
        pytest.skip("not a limslam command")
    shown = subprocess.run(
        [sys.executable, "-m", "limslam_agent.cli.main", words[1], "--help"],
        capture_output=True, text=True, check=True, env={"COLUMNS": "200", "TERM": "dumb"},
    ).stdout  # fmt: skip
    assert all(word in shown for word in words if word.startswith("--"))


def test_every_link_to_a_file_leads_somewhere():
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", README) if "://" not in link]
    assert links
    # Only what travels with the tests can be looked for outside of a checkout.
    present = [link for link in links if link.startswith("docs/")]
    assert [link for link in present if not (ROOT / link).is_file()] == []


def test_nothing_was_left_to_be_filled_in():
    documents = [README, *(path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md"))]
    assert len(documents) > 3
    # Names of environment variables stand as code.
    prose = [re.sub(r"`[^`]*`", "", text) for text in documents]
    assert [re.findall(r"\b[A-Z]{3,}_[A-Z0-9]+\b", text) for text in prose] == [[]] * len(documents)
