"""The page of public names lists what the packages export and what the command line takes, and nothing else."""

import re
from collections.abc import Iterator
from typing import Any

import pytest
import typer
from support.command_line import app
from support.markdown import ROOT

import limslam_agent
import limslam_env

PAGE = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")


def documented(package: str) -> set[str]:
    section = PAGE.split(f"\n## `{package}`\n", 1)[1].split("\n## ", 1)[0]
    cells = re.findall(r"^\| (`[^|]+) \|", section, re.MULTILINE)
    return {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}


@pytest.mark.parametrize("package", [limslam_env, limslam_agent], ids=lambda package: package.__name__)
def test_the_page_lists_the_public_names(package):
    assert documented(package.__name__) == set(package.__all__)


def commands(group: Any, path: str) -> Iterator[tuple[str, set[str]]]:
    """Each command of the command line with its options."""
    for name, command in group.commands.items():
        if getattr(command, "commands", None):
            yield from commands(command, f"{path} {name}")
        if not getattr(command, "no_args_is_help", False):
            found = {max(part.opts, key=len) for part in command.params if part.param_type_name == "option"}
            yield f"{path} {name}", found - {"--help"}


def test_the_page_lists_each_command_with_its_options():
    rows = re.findall(r"^\| `(limslam [a-z ]+)` \| [^|]+ \| ([^|]+) \|$", PAGE, re.MULTILINE)
    told = {command: set(re.findall(r"--[a-z0-9-]+", options)) for command, options in rows}
    assert told == dict(commands(typer.main.get_command(app), "limslam"))
