"""Tables and lists of the pages name what is there, and all of it."""

import re
import runpy
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path

import gymnasium as gym
import pytest
import yaml
from support.markdown import ROOT, all_blocks

import limslam_env
from limslam_env import NoiseConfig
from limslam_env.envs import wrappers

DOCS = ROOT / "docs"
ENVIRONMENTS = (DOCS / "environments.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    return ENVIRONMENTS.split(f"\n## {title}\n", 1)[1].split("\n## ", 1)[0]


def first_column(text: str) -> set[str]:
    cells = re.findall(r"^\| (`[^|]+) \|", text, re.MULTILINE)
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


def test_every_setting_of_the_noise_is_explained():
    assert first_column(section("Noise")) == {part.name for part in fields(NoiseConfig)}


def test_every_wrapper_is_named():
    assert first_column(section("Wrappers")) - {"limslam_env.envs.wrappers"} == set(wrappers.__all__)


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


@pytest.mark.parametrize("top", ["limslam_env", "limslam_agent", "benchmarks"])
def test_the_tree_of_packages_is_the_one_that_is_there(top):
    spec = find_spec(top)
    if spec is None:
        pytest.skip("the benchmarks do not travel with the tests: run them in a checkout")
    folder = Path(next(iter(spec.submodule_search_locations)))
    there = {path.parent.relative_to(folder.parent).as_posix() for path in folder.rglob("*.py")}
    assert {name for name in packages_drawn() if name.split("/")[0] == top} == there


@pytest.mark.parametrize("top", ["limslam_env", "limslam_agent", "benchmarks"])
def test_the_tree_names_the_modules_beside_the_packages(top):
    spec = find_spec(top)
    if spec is None or spec.origin is None:
        pytest.skip("the benchmarks do not travel with the tests: run them in a checkout")
    (tree,) = [block.text for block in all_blocks("text") if block.text.startswith("limslam_env/")]
    modules = {path.name for path in Path(spec.origin).parent.glob("*.py") if not path.name.startswith("__")}
    assert modules <= set(re.findall(r"\w+\.py", tree))


def test_every_suite_is_named():
    if not find_spec("benchmarks"):
        pytest.skip("the benchmarks do not travel with the tests: run them in a checkout")
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


def test_the_figure_of_the_results_finds_its_tables():
    figure = runpy.run_path(str(DOCS / "images" / "results.py"))
    text = figure["RESULTS"].read_text(encoding="utf-8")
    runs, logs = (figure["table"](text, figure[heading]) for heading in ("RUNS", "LOGS"))
    assert {f"ATE {name}, m" for name in figure["ESTIMATES"]} <= set(runs[0])
    assert {"odometry, m", "LimSLAM, m"} <= set(logs[0])
