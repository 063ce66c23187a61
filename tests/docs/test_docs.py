"""Pages name what is there, and all of it: tables, lists, public names, commands, and links that
lead somewhere.
"""

import re
import runpy
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
import typer
import yaml
from support.command_line import app
from support.markdown import ROOT, all_blocks, anchors, code_spans, links, name_of, pages

import limslam_agent
import limslam_env

DOCS = ROOT / "docs"
in_a_checkout = pytest.mark.skipif(
    not find_spec("benchmarks"), reason="the benchmarks do not travel with the tests"
)
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
    found = set()
    above = []
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
    modules = {
        path.name
        for path in Path(find_spec(top).origin).parent.glob("*.py")
        if not path.name.startswith("__")
    }
    assert modules <= set(re.findall(r"\w+\.py", tree))


@in_a_checkout
def test_every_suite_is_named():
    from benchmarks.suite.suite import shipped_suites

    text = (
        (DOCS / "benchmark.md")
        .read_text(encoding="utf-8")
        .split("\n## Suites\n", 1)[1]
        .split("\n### ", 1)[0]
    )
    assert first_column(text) == set(shipped_suites())


def test_the_release_is_the_same_everywhere():
    version = limslam_env.__version__
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
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
    assert drawn["lines_of_table"](text, drawn["DRIVES"])[0] == table, (
        "python docs/images/results.py writes it"
    )
    runs, logs, speed = (
        drawn["rows_of"](text, drawn[heading])[0] for heading in ("RUNS", "LOGS", "SPEED")
    )
    assert {f"ATE {name}, m" for name in drawn["ESTIMATES"]} <= set(runs)
    assert {"odometry, m", "LimSLAM, m"} <= set(logs)
    assert {f"{name}, million steps/s" for name in drawn["SPEEDS"]} <= set(speed)


PAGE = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")


def documented(package: str) -> set[str]:
    section = PAGE.split(f"\n## `{package}`\n", 1)[1].split("\n## ", 1)[0]
    cells = re.findall(r"^\| (`[^|]+) \|", section, re.MULTILINE)
    return {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}


@pytest.mark.parametrize(
    "package", [limslam_env, limslam_agent], ids=lambda package: package.__name__
)
def test_the_page_lists_the_public_names(package):
    assert documented(package.__name__) == set(package.__all__)


def commands(group: Any, path: str) -> Iterator[tuple[str, set[str]]]:
    """Each command of the command line with its options."""
    for name, command in group.commands.items():
        if getattr(command, "commands", None):
            yield from commands(command, f"{path} {name}")
        if not getattr(command, "no_args_is_help", False):
            found = {
                max(part.opts, key=len)
                for part in command.params
                if part.param_type_name == "option"
            }
            yield f"{path} {name}", found - {"--help"}


def test_the_page_lists_each_command_with_its_options():
    rows = re.findall(r"^\| `(limslam [a-z ]+)` \| [^|]+ \| ([^|]+) \|$", PAGE, re.MULTILINE)
    told = {command: set(re.findall(r"--[a-z0-9-]+", options)) for command, options in rows}
    assert told == dict(commands(typer.main.get_command(app), "limslam"))


# Only what travels with the tests can be looked for outside of a checkout.
IS_CHECKOUT = (ROOT / "CONTRIBUTING.md").is_file()
TRAVELS = ("docs", "README.md", "examples")


def problem_of(page, target: str) -> str | None:
    """What is wrong with a link of a page; None if it leads somewhere."""
    file, _, anchor = target.partition("#")
    path = (page.parent / file).resolve() if file else page
    inside = path.relative_to(ROOT.resolve()) if path.is_relative_to(ROOT.resolve()) else None
    if inside is None:
        return f"{target}: lies outside of the project"
    if not IS_CHECKOUT and inside.parts[0] not in TRAVELS:
        return None
    if not path.exists():
        return f"{target}: there is no such file"
    if anchor and anchor not in anchors(path):
        return f"{target}: there is no such heading"
    return None


@pytest.mark.parametrize("page", pages(), ids=name_of)
def test_links_lead_somewhere(page):
    assert [problem for target in links(page) if (problem := problem_of(page, target))] == []


def exists(name: str) -> bool:
    """Whether a path such as ``limslam_env/geometry/`` or ``slam/core/ekf.py`` is one of the
    project's.
    """
    tops = ("", "limslam_agent", "limslam_env", "limslam_agent/slam", "benchmarks")
    return any((ROOT / top / name).exists() for top in tops)


def importable(name: str) -> bool:
    """Whether a dotted name is a module, or a name within one."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        try:
            found = find_spec(".".join(parts[:length]))
        except ModuleNotFoundError:
            continue
        if found is not None:
            return length >= len(parts) - 2 and (
                length == len(parts) or has_name(found.name, parts[length])
            )
    return False


def has_name(module: str, name: str) -> bool:
    """Whether a module defines a name, by its source: importing it may need an extra."""
    path = find_spec(module).origin
    words = rf"^(?:class|def) {name}\b|^{name}\b.*=|\"{name}\"|^\s*{name},?$"
    return re.search(words, Path(path).read_text(encoding="utf-8"), re.MULTILINE) is not None


@pytest.mark.parametrize("page", pages(), ids=name_of)
def test_modules_that_a_page_names_exist(page):
    if not IS_CHECKOUT:
        pytest.skip("the sources do not travel with the tests: run them in a checkout")
    paths = {
        span
        for span in code_spans(page)
        if re.fullmatch(r"[a-z_]+/[\w/]*(\.py|/)?", span) and "/" in span
    }
    paths = {
        span
        for span in paths
        if span.endswith((".py", "/")) and not span.startswith(("runs/", "lists/"))
    }
    assert {span for span in paths if not exists(span)} == set()
    dotted = {
        span
        for span in code_spans(page)
        if re.fullmatch(r"(limslam_env|limslam_agent|benchmarks)(\.\w+)+", span)
    }
    assert {span for span in dotted if not importable(span)} == set()
