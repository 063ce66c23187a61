"""Tables and lists of the pages name what is there, and all of it."""

import re
import runpy
from importlib.util import find_spec
from pathlib import Path

import gymnasium as gym
import pytest
import yaml
from support.markdown import ROOT, all_blocks

import limslam_env

DOCS = ROOT / "docs"
in_a_checkout = pytest.mark.skipif(not find_spec("benchmarks"), reason="the benchmarks do not travel with the tests")
ENVIRONMENTS = (DOCS / "environments.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    return ENVIRONMENTS.split(f"\n## {title}\n", 1)[1].split("\n## ", 1)[0]


def first_column(text: str) -> set[str]:
    cells = re.findall(r"^\| (`[^|]+) \|", text, re.MULTILINE)
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


def test_every_id_is_named():
    ids = {name for name in gym.registry if name.startswith("LimSlam-")}
    assert first_column(section("Which there are")) == ids
    assert gym.spec("LimSlam-Random-v0").max_episode_steps == limslam_env.MAX_EPISODE_STEPS


def packages_drawn() -> set[str]:
    """The folders in the tree of packages, as paths; two spaces of indentation a level."""
    (tree,) = [block.text for block in all_blocks("text") if block.text.startswith("limslam_env/")]
    found, above = set(), []
    for line in tree.splitlines():
        indent, name = re.match(r"( *)([\w/]+)", line).groups()
        above = [*above[: len(indent) // 2], name]
        if name.endswith("/"):
            found.add("".join(above).rstrip("/"))
    return found


@in_a_checkout
@pytest.mark.parametrize("top", ["limslam_env", "limslam_agent", "benchmarks"])
def test_the_tree_of_packages_is_the_one_that_is_there(top):
    folder = Path(next(iter(find_spec(top).submodule_search_locations)))
    there = {path.parent.relative_to(folder.parent).as_posix() for path in folder.rglob("*.py")}
    assert {name for name in packages_drawn() if name.split("/")[0] == top} == there


@in_a_checkout
@pytest.mark.parametrize("top", ["limslam_env", "limslam_agent", "benchmarks"])
def test_the_tree_names_the_modules_beside_the_packages(top):
    (tree,) = [block.text for block in all_blocks("text") if block.text.startswith("limslam_env/")]
    modules = {path.name for path in Path(find_spec(top).origin).parent.glob("*.py") if not path.name.startswith("__")}
    assert modules <= set(re.findall(r"\w+\.py", tree))


@in_a_checkout
def test_every_suite_is_named():
    from benchmarks.suite.suite import shipped_suites

    text = (DOCS / "benchmark.md").read_text(encoding="utf-8").split("\n## Suites\n", 1)[1].split("\n### ", 1)[0]
    assert first_column(text) == set(shipped_suites())


def test_the_release_is_the_same_everywhere():
    version, changes = limslam_env.__version__, (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    date = re.search(rf"^## {re.escape(version)} - (\d{{4}}-\d\d-\d\d)$", changes, re.MULTILINE)
    assert date is not None, "CHANGELOG.md has no dated heading of this version"
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert (citation["version"], citation["date-released"]) == (version, date[1])
    assert f"version = {{{version}}}" in (DOCS / "index.md").read_text(encoding="utf-8")


@in_a_checkout
def test_the_results_have_the_table_of_the_scoreboard_and_the_columns_that_are_drawn():
    drawn = runpy.run_path(str(DOCS / "images" / "results.py"))
    text = drawn["RESULTS"].read_text(encoding="utf-8")
    table = drawn["scoreboard_lines"](drawn["table"](drawn["read_board"](drawn["BOARD"])))
    assert drawn["lines_of_table"](text, drawn["DRIVES"])[0] == table, "python docs/images/results.py writes it"
    runs, logs, speed = (drawn["rows_of"](text, drawn[heading])[0] for heading in ("RUNS", "LOGS", "SPEED"))
    assert {f"ATE {name}, m" for name in drawn["ESTIMATES"]} <= set(runs)
    assert {"odometry, m", "LimSLAM, m"} <= set(logs)
    assert {f"{name}, million steps/s" for name in drawn["SPEEDS"]} <= set(speed)
