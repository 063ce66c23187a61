"""The page of ``limslam worlds draw`` in a headless Chromium: what is drawn is saved, can be loaded
and explored, and is checked by the rules of ``limslam worlds check``.
"""

import json
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image
from support.browser import needs_chromium
from support.command_line import limslam, refused, told
from support.data import SHIPPED_WORLDS

from limslam_agent import evaluate
from limslam_env import World, load_world
from limslam_env.worlds.formats.tables import world_table
from limslam_env.worlds.regions import start_region
from limslam_env.worlds.world import WorldError


@pytest.fixture
def opened(chromium, tmp_path):
    told("worlds", "draw", "--out", tmp_path / "page.html")
    chromium.open(tmp_path / "page.html")
    yield chromium
    assert chromium.errors == []
    assert chromium.requests == []


def pixels(opened, x, y):
    """Where a place of the world, m, is in the window."""
    box = opened.page.locator("#plan").bounding_box()
    left, top = opened.run(f"toPixels([{x}, {y}])")
    return box["x"] + left, box["y"] + top


def use(opened, tool):
    opened.page.click(f"[data-tool={tool}]")


def drag(opened, first, second):
    mouse = opened.page.mouse
    mouse.move(*pixels(opened, *first))
    mouse.down()
    mouse.move(*pixels(opened, *second), steps=3)
    mouse.up()


def click(opened, *places):
    for place in places:
        opened.page.mouse.click(*pixels(opened, *place))


def verdict(opened):
    opened.run("check()")
    return opened.run("document.body.dataset.checked")


def saved(opened, path):
    with opened.page.expect_download() as download:
        opened.page.click("#save")
    download.value.save_as(path)
    return path


def stretches(rows):
    """Walls or doors without their order and direction."""
    return {frozenset({(row[0], row[1]), (row[2], row[3])}) for row in np.round(rows, 6).tolist()}


@needs_chromium
def test_a_room_with_a_door_is_drawn_saved_checked_and_explored(opened, tmp_path):
    opened.page.fill("#name", "two rooms")
    use(opened, "room")
    drag(opened, (0, 0), (2, 2))
    drag(opened, (2, 0), (4, 2))  # the wall between both stands there already
    use(opened, "door")
    drag(opened, (2.02, 0.61), (2.03, 1.38))
    use(opened, "obstacle")
    drag(opened, (3.2, 0.4), (3.6, 0.7))
    assert verdict(opened) == "ok"
    use(opened, "start")
    drag(opened, (0.5, 0.5), (0.5, 1.5))
    assert verdict(opened) == "ok"
    path = saved(opened, tmp_path / "rooms.toml")
    assert "two rooms: 4 x 2 m, 8 walls, 1 obstacle, 1 door, 1 start" in told(
        "worlds", "check", path
    )
    world = load_world(path)
    assert stretches(world.doors) == stretches(np.array([[2, 0.6, 2, 1.4]]))
    assert stretches(np.array([[2, 0, 2, 0.6], [2, 1.4, 2, 2]])) <= stretches(world.walls)
    assert world.starts.tolist() == [[0.5, 0.5, pytest.approx(np.pi / 2)]]
    gym.make("LimSlam-World-v0", world=world).reset(seed=0)
    scores = evaluate("frontier", "LimSlam-World-v0", seeds=[0], world=world, max_time=120.0)
    assert scores[0]["coverage_true"] > 0.9


@needs_chromium
def test_keys_draw_undo_and_delete(opened):
    press = opened.page.keyboard.press
    opened.page.focus("#plan")
    press("w")
    press("Enter")
    press("Shift+ArrowRight")
    press("Enter")
    press("Shift+ArrowUp")
    press("Enter")
    press("Escape")
    assert opened.run("world.walls") == [[0, 0, 1, 0], [1, 0, 1, 1]]
    press("Control+z")
    assert opened.run("world.walls") == [[0, 0, 1, 0]]
    press("Control+y")
    assert len(opened.run("world.walls")) == 2
    opened.page.click("#drawn li:nth-child(2) button")
    opened.page.fill("[data-field='3']", "2.5")
    press("Tab")
    assert opened.run("world.walls[1]") == [1, 0, 1, 2.5]
    opened.page.focus("#plan")
    press("ArrowLeft")
    assert opened.run("world.walls[1]") == [0.9, 0, 0.9, 2.5]
    press("Delete")
    assert opened.run("world.walls") == [[0, 0, 1, 0]]
    assert verdict(opened) == "no room"


@needs_chromium
def test_a_corner_is_moved_with_the_walls_that_end_there(opened):
    use(opened, "room")
    click(opened, (0, 0), (3, 2))
    use(opened, "select")
    click(opened, (3, 1))
    drag(opened, (3, 2), (3.5, 2.5))
    assert stretches(np.array(opened.run("world.walls"))) == stretches(
        np.array([[0, 0, 3, 0], [3, 0, 3.5, 2.5], [3.5, 2.5, 0, 2], [0, 2, 0, 0]])
    )


@needs_chromium
def test_a_picture_is_scaled_by_two_points(opened, tmp_path):
    Image.new("RGB", (200, 100), "white").save(tmp_path / "plan.png")
    told("worlds", "draw", "--over", tmp_path / "plan.png", "--out", tmp_path / "over.html")
    opened.open(tmp_path / "over.html")
    opened.wait_for("document.body.dataset.picture === 'ready'")
    click(opened, (1.08, 0.97), (6.08, 0.97))  # the picture is ten metres wide at first
    opened.page.fill("#metres", "4")
    opened.page.click("#scale-dialog [value=scale]")
    assert opened.run("picture.place.scale * 200") == pytest.approx(8.0, rel=0.01)
    # The first point stands 1.08 and 0.97 of ten metres from the corner, and moves onto the grid.
    place = opened.run("[picture.place.x, picture.place.y]")
    assert place == pytest.approx([1.1 - 0.864, 1.0 - 0.776], abs=0.02)
    for wrong in ("plan.txt", "missing.png"):
        assert wrong in refused(
            "worlds", "draw", "--over", tmp_path / wrong, "--out", tmp_path / "x.html"
        )


@needs_chromium
@pytest.mark.parametrize("name", SHIPPED_WORLDS)
def test_a_world_that_is_opened_is_saved_as_it_was(opened, tmp_path, name):
    told("worlds", "draw", name, "--out", tmp_path / "shipped.html")
    opened.open(tmp_path / "shipped.html")
    path = saved(opened, tmp_path / "saved.toml")
    assert load_world(path) == load_world(name)
    # The page itself reads what it and the command have written.
    opened.page.set_input_files("#file", path)
    opened.wait_for("past.length === 1")
    told("worlds", "convert", name, tmp_path / "written.toml")
    for file in (path, tmp_path / "written.toml"):
        text = json.dumps(file.read_text(encoding="utf-8"))
        table = opened.run(f"toml(readToml({text}))")
        file.write_text(table, encoding="utf-8")
        assert load_world(file) == load_world(name)


@needs_chromium
@pytest.mark.parametrize(
    "text", ["name = 3", 'name = "a"\nwalls = [[1, 2]]', 'name = "a"\nwalls = [}', "walls"]
)
def test_a_file_that_is_no_world_is_refused_in_words(opened, tmp_path, text):
    (tmp_path / "bad.toml").write_text(text)
    opened.page.set_input_files("#file", tmp_path / "bad.toml")
    opened.wait_for("document.getElementById('hint').textContent.startsWith('bad.toml: ')")
    assert opened.run("world.walls") == []


SQUARE = [[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0]]
WITH_ROOM = [*SQUARE, [2, 0, 2, 1], [2, 1.5, 2, 3]]


def made(walls, **more):
    return World("made", (4.0, 3.0), walls, **more)


EXAMPLES = {
    "square": made(SQUARE),
    "open": made(SQUARE[:3]),
    "narrow gap": made([[0, 0, 3.85, 0], *SQUARE[1:]]),
    "wide gap": made([[0, 0, 3.7, 0], *SQUARE[1:]]),
    "start at a wall": made(SQUARE, starts=[[1, 1, 0], [0.05, 1, 0]]),
    "start in an obstacle": made(
        SQUARE, obstacles=[[[1, 1], [2, 1], [2, 2]]], starts=[[1.7, 1.5, 0]]
    ),
    "start outside": made(SQUARE, starts=[[6, 1, 0]]),
    "start in a cupboard": made(
        [*SQUARE, [1, 0, 1, 1], [1, 1, 0, 1]], starts=[[0.5, 0.5, 0], [0.6, 0.4, 1]]
    ),
    "door": made(WITH_ROOM, doors=[[2, 1, 2, 1.5]], starts=[[1, 1, 0]]),
    "slanted": made([[0, 0, 4, 1], [4, 1, 3, 4], [3, 4, -1, 3], [-1, 3, 0, 0]]),
    "one wall": made([[0, 0, 4, 0]]),
    "tiny": made([[0, 0, 0.1, 0], [0.1, 0, 0.1, 0.1], [0.1, 0.1, 0, 0.1], [0, 0.1, 0, 0]]),
    **{name: load_world(name) for name in (*SHIPPED_WORLDS, "random:3", "random:4:20x14")},
}


def reason_of(world, radius):
    """Why ``limslam worlds check`` refuses a world, as the page calls it."""
    try:
        world.check(radius)
    except WorldError as error:
        words = {"collides": "collides", "not closed": "open", "has room": "no room"}
        return next(reason for part, reason in words.items() if part in str(error))
    return None


@needs_chromium
def test_the_page_and_the_check_agree(opened):
    found = set()
    for name, world in EXAMPLES.items():
        for example in (world, replace(world, starts=np.zeros((0, 3)))):
            for radius in (0.06, 0.1, 0.26):
                reason = reason_of(example, radius)
                shown = opened.run(
                    "(({reason, share, isOpen, area, floor}) => ({reason, share, isOpen, area, "
                    f"floor}}))(checked(worldOf({json.dumps(world_table(example))}), {radius}))"
                )
                assert shown["reason"] == reason, (name, radius)
                region = start_region(example, radius)
                assert shown["area"] == pytest.approx(region.area, abs=1e-6), (name, radius)
                assert shown["floor"] == pytest.approx(region.floor, abs=1e-6), (name, radius)
                assert shown["isOpen"] == region.is_open
                found.add(reason or (region.is_small, region.is_open))
    assert {"collides", "open", "no room", (True, False), (False, False)} <= found


def test_the_command_refuses_what_it_cannot_use(tmp_path):
    told("worlds", "draw", cwd=tmp_path)
    assert "already exists" in refused("worlds", "draw", cwd=tmp_path)
    assert "--radius" in refused("worlds", "draw", "--radius", 0, cwd=tmp_path)
    assert limslam("worlds", "draw", "random:17", cwd=tmp_path).returncode == 0
    assert (tmp_path / "random_17.html").is_file()
