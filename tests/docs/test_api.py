"""The page of public names lists what the packages export, and nothing else."""

import re

import pytest
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
