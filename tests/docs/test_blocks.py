"""Every fenced block of the documentation works: Python runs, commands run or parse, data is read
by its reader.
"""

import math
import re
import runpy
import tomllib
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import typer
from support.arena import made_entry
from support.command_line import app as limslam_app
from support.markdown import ROOT, Block, all_blocks, blocks, code_spans, commands, name_of, pages

from limslam_agent import read_log
from limslam_agent.config.shared import OdometryConfig
from limslam_agent.live.emulator.__main__ import app as emulator_app
from limslam_agent.logs.table_options import TableOptions
from limslam_agent.output.summary import record_summary
from limslam_agent.replay.calibration import calibrated
from limslam_agent.robot_file import robot_named
from limslam_env import RobotSpec, load_world
from limslam_env.interface import beams_on_rim

# Blocks that no program reads, by the words that they begin with.
DIAGRAMS = {
    "action -> physics": "the stages of one step of the loop",
    "limslam_env/": "the packages and what each is for; test_docs compares it with the folders",
    "simulator    geometry <-": "which package may import which; test_architecture has the rules",
    "# t1   t2": "relations of a tape; a test below reads them",
    "docker run": "needs Docker and an entry; it is the command of a judge",
    "H,2,": "lines of the live protocol; tests/agent/live/test_protocol.py reads them",
    "limslam: warning: the odometry jumps": "a warning; test_odometry_breaks has its words",
    "turned   ": "a line of the summary; a test below prints it",
}
# Python blocks that are compiled, but not run, by the words that they begin with.
NOT_RUN = {
    "import torch\nimport gymnasium": "needs a GPU",
    "from rl_sb3 import wrapped": "needs a model that was saved; test_rl_examples compares so",
    "import minari\n": "needs what Minari needs to write datasets, and records for some minutes",
    "from pathlib import Path\nfrom "
    "benchmarks.suite.store": "needs the results of a suite, which takes minutes",
}
# Commands that are not the project's own, by their first words.
OTHERS = {
    "tensorboard": "TensorBoard's own command line; it serves until it is stopped",
    "git": "changes a checkout",
    ".venv/bin/pytest": "these tests",
    "pytest": "these tests",
    "ruff": "the project's checks, run before each change lands",
    "mypy": "the project's checks, run before each change lands",
    "python3": "sets up a virtual environment; test_readme looks at it",
    ".": "enters a virtual environment",
    "export": "sets a variable of the environment",
    "ros2": "ROS 2's own command line, which its wheels do not have",
}
# How the project's quick commands are cut short. All others are parsed, not run: they take minutes
# or recorded data.
SHORT = {
    ("limslam", "run"): ["--max-time", "1"],
    ("limslam", "worlds"): [],
    ("python -m benchmarks", "run"): ["--dry-run"],
}
NOT_SHORT = {"explore": "its jobs name 100 floor plans, which take long to draw"}


def apps() -> dict[str, typer.Typer]:
    """The command lines by their names; the benchmarks do not travel with a wheel."""
    found = {"limslam": limslam_app, "python -m limslam_agent.live.emulator": emulator_app}
    if find_spec("benchmarks"):
        from benchmarks.__main__ import app as benchmarks_app

        found["python -m benchmarks"] = benchmarks_app
    return found


APPS = apps()


def reason_for(block: Block, reasons: dict[str, str]) -> str | None:
    return next(
        (reason for start, reason in reasons.items() if block.text.lstrip().startswith(start)), None
    )


def own(words: list[str]) -> tuple[str, list[str]] | None:
    """The project's command line that a command calls, and its arguments."""
    line = " ".join(words)
    for name in (
        "limslam",
        ".venv/bin/limslam",
        "python -m limslam_agent.live.emulator",
        "python -m benchmarks",
    ):
        if line.startswith(f"{name} "):
            return name.removeprefix(".venv/bin/"), words[len(name.split()) :]
    return None


def parsed(app: typer.Typer, words: list[str]) -> None:
    """Let the command line read its options, with their types, and go no further."""
    command = typer.main.get_command(app)
    words = list(words)
    while getattr(command, "commands", None) and words and words[0] in command.commands:
        command = command.commands[words.pop(0)]
    command.make_context(words[0] if words else "command", words)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of its own, with the world that the page of public names describes, and a plan."""
    page = blocks(ROOT / "docs" / "api.md")
    world = next(block for block in page if block.language == "toml" and "walls" in block.text)
    (tmp_path / "bedroom.toml").write_text(world.text, encoding="utf-8")
    plan = "<svg xmlns='http://www.w3.org/2000/svg'><rect width='500' height='300'/></svg>"
    (tmp_path / "plan.svg").write_text(plan, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_block_says_what_it_holds():
    allowed = {"python", "sh", "powershell", "toml", "csv", "math", "text", "bibtex"}
    assert [block.name for block in all_blocks() if block.language not in allowed] == []


def test_every_block_of_plain_text_is_a_known_diagram():
    unknown = [block.name for block in all_blocks("text") if reason_for(block, DIAGRAMS) is None]
    assert unknown == []


@pytest.mark.parametrize("block", all_blocks("math"), ids=lambda block: block.name)
def test_an_equation_is_closed(block):
    for opening, closing in (
        ("{", "}"),
        ("(", ")"),
        ("[", "]"),
        (r"\begin", r"\end"),
        (r"\left", r"\right"),
    ):
        text = block.text.replace(r"\leftarrow", "")
        assert text.count(opening) == text.count(closing), opening


def example(name: str) -> Path:
    """A file of the examples."""
    path = ROOT / "examples" / name
    if not path.is_file():
        pytest.skip("the examples do not travel with the tests: run them in a checkout")
    return path


def live_robot() -> dict:
    """What the loop for a live robot is written for: a robot that answers, and an agent."""
    parts = runpy.run_path(str(example("live_robot.py")), run_name="live_robot")
    agent = parts["LimSlamAgent"](
        parts["SPEC"], parts["preset"]("consistent", parts["NominalNoise"](0.01))
    )
    return {
        "robot": parts["FakeRobot"](in_real_time=False),
        "agent": agent,
        "spec": parts["SPEC"],
        "np": parts["np"],
    }


NEEDS = {"docs/live.md": live_robot}
# test_readme runs the README and looks at what it prints.
PYTHON_PAGES = [
    page
    for page in pages()
    if page.name != "README.md" and any(block.language == "python" for block in blocks(page))
]


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("page", PYTHON_PAGES, ids=name_of)
def test_the_python_blocks_of_a_page_run_one_after_the_other(page):
    namespace = {"__name__": "__main__"} | NEEDS.get(name_of(page), dict)()
    for block in blocks(page):
        if block.language == "python":
            if reason_for(block, NOT_RUN):
                compile(block.text, block.name, "exec")
            else:
                block.run_python(namespace)


COMMANDS = [
    pytest.param(words, id=f"{block.name} {' '.join(words)}")
    for block in all_blocks("sh")
    for words in commands(block.text)
]


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("words", COMMANDS)
def test_a_command_runs_or_has_options_that_exist(words):
    if words[0] in OTHERS:
        return
    if words[0].endswith("pip"):
        check_extras(words)
        return
    if words[:2] == ["python", "-m"] and words[2].startswith("benchmarks."):
        place = ROOT / words[2].replace(".", "/")
        is_there = place.with_suffix(".py").is_file() or (place / "__main__.py").is_file()
        assert is_there or not find_spec("benchmarks")
        return
    if words[0] == "python" and words[1].endswith(".py"):
        assert (ROOT / words[1]).is_file() or not (ROOT / "examples").is_dir()
        return
    called = own(words)
    assert called, f"neither a command of the project nor an exemption: {words}"
    name, arguments = called
    if name not in APPS:
        pytest.skip("the benchmarks do not travel with the tests: run them in a checkout")
    parsed(APPS[name], arguments)
    short = SHORT.get((name, arguments[0]))
    files = [word.rpartition(":")[0] if ".py:" in word else word for word in arguments]
    read = (".yaml", ".json", ".py", ".png", ".svg", ".dxf")
    is_there = all(Path(word).exists() for word in files if word.endswith(read))
    if short is not None and is_there and not NOT_SHORT.keys() & set(arguments):
        APPS[name]([*arguments, *short], standalone_mode=False)


def check_extras(words: list[str]) -> None:
    """The extras that a command installs are declared."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = {
        extra
        for word in words
        for found in re.findall(r"^(?:limslam|\.)\[(.+)\]$", word)
        for extra in found.split(",")
    }
    assert asked <= set(project["optional-dependencies"])


def options_of(command) -> set[str]:
    names = (
        name
        for part in command.params
        for name in (*getattr(part, "opts", []), *getattr(part, "secondary_opts", []))
    )
    own_options = {name for name in names if name.startswith("--")}
    return own_options.union(
        *(options_of(part) for part in getattr(command, "commands", {}).values())
    )


@pytest.mark.parametrize("page", pages(), ids=name_of)
def test_commands_within_the_prose_have_options_that_exist(page):
    for span in code_spans(page):
        words = span.split()
        called = own(words)
        if called and called[0] in APPS and called[1] and re.fullmatch(r"[a-z]+", called[1][0]):
            command = typer.main.get_command(APPS[called[0]]).commands[called[1][0]]
            asked = {word.partition("=")[0] for word in called[1] if word.startswith("--")}
            assert asked - options_of(command) - {"--help"} == set(), span


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("block", all_blocks("toml"), ids=lambda block: block.name)
def test_a_toml_block_is_read_by_its_reader(block):
    keys = set(tomllib.loads(block.text))
    if "walls" in keys:
        Path("world.toml").write_text(block.text, encoding="utf-8")
        load_world("world.toml").check(radius=0.1)
    elif keys & {"grid", "log"}:
        if not find_spec("benchmarks"):
            pytest.skip("the benchmarks do not travel with the tests: run them in a checkout")
        from support.data import data_folder

        from benchmarks.suite.suite import load_suite

        if "log" in keys:
            data_folder()  # skips where there is no recorded data
        Path("mine.toml").write_text(block.text, encoding="utf-8")
        assert len(load_suite("mine.toml").jobs) > 1
    elif keys & {"agent", "true_noise"}:
        Path("mine.toml").write_text(block.text, encoding="utf-8")
        limslam_app(["run", "--config", "mine.toml", "--max-time", "1"], standalone_mode=False)
        assert len(list(Path("runs").glob("*/run.toml"))) == 1
    elif "axle" in keys:
        Path("robot.toml").write_text(block.text, encoding="utf-8")
        assert robot_named("robot.toml").radius == 0.06
    elif "uses" in keys:
        made_entry(
            Path("mine"), block.text, my_policy=example("my_policy.py").read_text(encoding="utf-8")
        )
    else:
        pytest.fail(f"{block.name}: no reader is known for a table with {sorted(keys)}")


@pytest.mark.parametrize("block", all_blocks("csv"), ids=lambda block: block.name)
def test_a_table_is_read_as_a_log(block, tmp_path):
    (tmp_path / "log.csv").write_text(block.text, encoding="utf-8")
    rim = beams_on_rim((90.0, 54.0, 18.0, -18.0, -54.0, -90.0), 0.06)
    options = TableOptions(RobotSpec(beams=rim)) if "left" in block.text else None
    assert (
        len(read_log(tmp_path / "log.csv", table=options))
        == len(block.text.strip().splitlines()) - 1
    )


def test_a_turned_beam_is_printed_as_the_page_shows():
    (block,) = (
        block for block in blocks(ROOT / "docs" / "logs.md") if block.text.startswith("turned   ")
    )
    beams = [{"angle": math.radians(58.0)}]
    turns = [{"deg": -4.2, "std_deg": 0.1}]
    summary = record_summary(
        {"record": {"beam_turns": turns}, "config": {"robot": {"beams": beams}}}
    )
    assert summary[-1] == block.text.strip()


def test_the_tape_of_the_page_gives_the_numbers_of_the_page(tmp_path):
    page = ROOT / "docs" / "logs.md"
    (block,) = (block for block in blocks(page) if block.text.startswith("# t1   t2"))
    (tape := tmp_path / "tape.relations").write_text(block.text, encoding="utf-8")
    # Two straight drives of 5 m by odometry: from 2 to 24 s and from 31 to 53.5 s.
    times = np.arange(0.0, 55.0, 0.1)
    driven = np.interp(times, [2.0, 24.0, 31.0, 53.5], [0.0, 5.0, 5.0, 10.0])
    rows = [f"{time:.1f},{x:.5f},0,0,1,1" for time, x in zip(times, driven, strict=True)]
    (log := tmp_path / "straight.csv").write_text(
        "\n".join(["t,x,y,theta,r_90,r_-90", *rows]), encoding="utf-8"
    )
    calibration = calibrated(tape, read_log(log), OdometryConfig())
    assert f"calibrated  {calibration.words}" in page.read_text(encoding="utf-8")
    turn = calibration.turn_per_metre
    scale = calibration.distance_scale
    for sign, size in ((-1.0, 0.9895), (1.0, 0.9859)):
        assert scale + sign * 0.5 * 0.115 * turn == pytest.approx(size, abs=5e-4), (
            calibration.words,
            sign,
        )
