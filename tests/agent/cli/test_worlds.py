"""``limslam worlds`` and ``limslam play``: tables, checks, conversions, and refusals in one
line.
"""

import json
import sys

import numpy as np
import pytest
from PIL import Image
from support.command_line import limslam, refusal_of, refused
from support.data import SHIPPED_WORLDS

from limslam_env import load_world

GOOD = """
name = "closet"
size = [2.0, 1.5]
walls = [[0, 0, 2.0, 0], [2.0, 0, 2.0, 1.5], [2.0, 1.5, 0, 1.5], [0, 1.5, 0, 0]]
obstacles = [[[0.9, 0.6], [1.1, 0.6], [1.1, 0.8]]]
starts = [[0.4, 0.4, 0.0]]
"""


@pytest.fixture
def good(tmp_path):
    path = tmp_path / "closet.toml"
    path.write_text(GOOD.replace("[[0, 0, 2.0, 0]", "[[0.0, 0.0, 2.0, 0.0]"))
    return path


def test_the_list_names_every_shipped_world_and_its_id():
    code, out, error = limslam("worlds")
    assert (code, error) == (0, "")
    heading, *rows = out.splitlines()
    assert [row.split()[0] for row in rows] == SHIPPED_WORLDS
    assert heading.split() == [
        "name",
        "size,",
        "m",
        "walls",
        "obstacles",
        "doors",
        "starts",
        "loop",
        "id",
    ]
    env1 = next(row for row in rows if row.startswith("env1 "))
    assert env1.split() == ["env1", "7", "x", "7", "12", "1", "0", "2", "yes", "LimSlam-Env1-v0"]
    square = next(row for row in rows if row.startswith("square "))
    assert square.split()[-1] == "yes"


def test_a_good_file_is_summed_up_in_a_line(good):
    code, out, error = limslam("worlds", "check", good)
    assert (code, error) == (0, "")
    assert out.startswith("closet: 2 x 1.5 m, 4 walls, 1 obstacle, 0 doors, 1 start, ")
    assert out.count("\n") == 1
    # The floor without the obstacle and what the round body cannot fill of four corners.
    assert float(out.split(", ")[-1].split(" m^2")[0]) == pytest.approx(2.95, abs=0.1)


def test_a_world_that_a_robot_could_leave_is_refused_with_the_file(tmp_path):
    path = tmp_path / "hall.toml"
    walls = "[[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 4, 4], [3, 4, 0, 4], [0, 4, 0, 0]]"
    path.write_text(
        f'name = "hall"\nsize = [6.0, 4.0]\nwalls = {walls}\nstarts = [[1.0, 1.0, 0.0]]\n'
    )
    code, _, error = limslam("worlds", "check", path)
    assert code == 2
    assert f"{path}: world 'hall': starts[0] lies in a region that is not closed" in error
    assert error.count("\n") == 1


PLAN = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 400 300">
<g id="walls"><rect width="400" height="300" fill="none" stroke="black"/></g>
<g id="beds"><rect x="100" y="100" width="50" height="50"/></g></svg>"""


def test_a_plan_is_checked_converted_and_run_with_its_scale(tmp_path):
    plan = tmp_path / "plan.svg"
    plan.write_text(PLAN)
    assert "--metres-per-unit 0.001" in refused("worlds", "check", plan)
    scale = ("--metres-per-unit", "0.01")
    code, out, error = limslam("worlds", "check", plan, *scale)
    assert (code, error) == (0, f"limslam: warning: {plan}: layers that are not used: beds\n")
    assert out.startswith("plan: 4 x 3 m, 4 walls, 0 obstacles, ")
    both = (*scale, "--layers", "walls, Beds")
    assert limslam("worlds", "convert", plan, tmp_path / "plan.toml", *both)[0] == 0
    world = load_world(tmp_path / "plan.toml")
    assert (len(world.walls), world.size) == (8, (4.0, 3.0))
    run = ("run", "--max-time", "1", "--world", plan, *both, "--out", tmp_path / "run")
    assert limslam(*run)[0] == 0
    assert load_world(tmp_path / "run" / "world.toml") == world
    settings = ("--config", tmp_path / "run" / "run.toml", "--out", tmp_path / "again")
    assert limslam("run", *settings)[0] == 0


def test_a_picture_needs_the_side_of_a_pixel(tmp_path):
    plan = tmp_path / "plan.pgm"
    cells = bytes(40) + 28 * (b"\0" + 38 * b"\xff" + b"\0") + bytes(40)
    plan.write_bytes(b"P5\n40 30\n255\n" + cells)
    assert "--metres-per-pixel 0.02" in refused("worlds", "check", plan)
    code, out, error = limslam("worlds", "check", plan, "--metres-per-pixel", "0.1")
    assert (code, error) == (0, "")
    assert out.startswith("plan: 4 x 3 m, ")
    _, _, error = limslam("worlds", "check", plan, "--metres-per-pixel", "4")
    assert "its walls measure 158 x 118 m: are its lengths in m?" in error


def test_the_place_where_an_outline_is_open_is_named(tmp_path):
    plan = tmp_path / "plan.json"
    walls = [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 4, 4], [3, 4, 0, 4], [0, 4, 0, 0]]
    plan.write_text(json.dumps({"id": "plan", "walls": walls}))
    assert "open at (3.50, 4.00), 1.00 m wide" in refused("worlds", "check", plan)
    # A closet that is closed has room for the robot, and the rest of the building has not.
    closet = [[0.0, 0.5, 0.5, 0.5], [0.5, 0.5, 0.5, 0.0]]
    plan.write_text(json.dumps({"id": "plan", "walls": walls + closet}))
    code, _, error = limslam("worlds", "check", plan)
    assert code == 0
    assert "the outer wall is open" in error
    assert "open at (3.50, 4.00), 1.00 m wide" in error


@pytest.mark.parametrize("name", SHIPPED_WORLDS)
def test_every_shipped_world_passes_its_check(name):
    assert limslam("worlds", "check", name)[0] == 0


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda text: text.replace("0.4, 0.4", "0.05, 0.4"), "starts[0]"),
        (lambda text: text.replace(", [0, 1.5, 0, 0]", ""), "could leave the world"),
        (lambda text: text.replace("1.5, 0, 1.5]", "nan, 0, 1.5]"), "walls[2]"),
        (lambda _: "", "missing"),
    ],
)
def test_a_bad_file_is_refused_with_the_reason(good, damage, words):
    good.write_text(damage(good.read_text()))
    result = limslam("worlds", "check", good)
    assert words in refusal_of(result)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("worlds", "check"), "FILE"),
        (("worlds", "check", "atlantis"), "atlantis"),
        (("worlds", "check", "env1", "--radius", "2"), "starts[0]"),
        (("worlds", "check", "env1", "--radius", "0"), "--radius"),
    ],
)
def test_bad_arguments_get_one_line(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert words in refused(*arguments)
    assert not list(tmp_path.iterdir())


def test_a_converted_world_is_the_same_world(tmp_path):
    target = tmp_path / "copy.toml"
    code, out, error = limslam("worlds", "convert", "env1", target)
    assert (code, error) == (0, "")
    assert str(target) in out
    assert load_world(target) == load_world("env1")


def test_play_without_pygame_or_a_display_says_so(monkeypatch):
    for name in ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    pytest.importorskip("pygame")
    assert "no display" in refused("play")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setitem(sys.modules, "pygame", None)
    assert "limslam[play]" in refused("play")


def test_a_folder_of_maps_becomes_worlds(tmp_path):
    maps = tmp_path / "maps"
    maps.mkdir()
    for name, left in (("one", 40), ("two", 60)):
        pixels = np.full((120, 200), 127, dtype=np.uint8)
        pixels[20:100, 20:180] = 195
        pixels[30:46, left : left + 16] = 208
        Image.fromarray(pixels).save(maps / f"{name}.png")
    out = tmp_path / "worlds"
    arguments = ("worlds", "import", maps, "--metres-per-pixel", "0.02", "--out", out)
    code, text, error = limslam(*arguments)
    assert (code, text, error) == (0, f"worlds      2 worlds in {out}\n", "")
    world = load_world(out / "two.toml")
    assert world == load_world(maps / "two.png", metres_per_pixel=0.02)
    assert world.starts[0].tolist() == pytest.approx([68 * 0.02, 82 * 0.02, 0.0])
    assert refused(*arguments) == f"{out}/one.toml: already exists; --force replaces it"
    assert "no pictures there" in refused("worlds", "import", out, "--metres-per-pixel", "1")
