"""Pictures of a run, and the walls of its files."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image as Pictures
from support.runs import run

from limslam_agent.grid.occupancy import GridView
from limslam_agent.output.drawing import MapPicture, draw_map, legend, paint_map

WALLS = np.array([(0.0, 0.0, 4.0, 0.0), (4.0, 0.0, 4.0, 3.0)])
NOTHING = np.zeros((0, 4))


def path(y, *, drift=0.0):
    along = np.linspace(0.5, 3.5, 40)
    return np.column_stack((along, y + drift * along))


def size_of(file):
    with Pictures.open(file) as picture:
        picture.load()
        return picture.size


def painted(picture):
    axes = Figure().add_subplot()
    paint_map(axes, picture)
    return axes


def labels(picture):
    return [handle.get_label() for handle in legend(picture)]


def test_the_legend_names_what_is_there_and_nothing_else():
    bare = MapPicture("bare", WALLS, [path(1.0)], [])
    assert labels(bare) == ["walls of the map, end points", "estimated path", "start", "end"]
    full = MapPicture("full", WALLS, [path(1.0)], [path(1.2)], WALLS, [path(1.1)])
    assert labels(full)[1:] == [
        "estimated path",
        "start",
        "end",
        "path by odometry alone",
        "true path",
        "true walls",
    ]


def test_odometry_that_runs_away_is_cut_off_and_the_legend_says_so():
    picture = MapPicture("log", WALLS, [path(1.0)], [path(1.0, drift=30.0)])
    axes = painted(picture)
    assert axes.get_xlim()[0] > -2.0
    assert axes.get_ylim()[1] < 5.0
    assert "path by odometry alone, runs out of the picture" in labels(picture)
    assert "path by odometry alone" in labels(
        MapPicture("log", WALLS, [path(1.0)], [path(1.0, drift=0.1)])
    )


def test_the_grid_is_drawn_in_three_colours_as_bytes():
    values = np.array([[-7, 0, 3]], dtype=np.int16)
    picture = MapPicture.of(
        "grid", NOTHING, {"est": [path(1.0)]}, grid=GridView(np.zeros(2), 0.05, values)
    )
    (image,) = painted(picture).images
    colours = image.get_array()
    assert colours.dtype == np.uint8
    assert [f"{red:02x}{green:02x}{blue:02x}" for red, green, blue, _ in colours[0]] == [
        "c9ced6",
        "ffffff",
        "eef2f6",
    ]


def test_a_legend_of_several_pictures_names_each_thing_once():
    first = MapPicture("one", WALLS, [path(1.0)], [], WALLS, colour="#112233")
    second = MapPicture("two", WALLS, [path(1.0)], [], online=[path(1.1)], colour="#445566")
    found = [handle.get_label() for handle in legend(first, second)]
    assert len(found) == len(set(found))
    assert {"estimated path", "smoothed path", "path as estimated online", "true walls"} < {*found}
    colours = {mark.get_color() for mark in painted(first).lines if mark.get_marker() == "o"}
    assert colours == {"#112233"}


def test_no_line_is_drawn_where_a_robot_was_carried():
    carried = np.vstack((path(1.0), path(1.0) + np.array([0.0, 4.0])))
    drawn = [line.get_xydata() for line in painted(MapPicture("", WALLS, [carried])).lines]
    (line,) = [points for points in drawn if len(points) > len(carried)]
    assert np.flatnonzero(np.isnan(line[:, 0])).tolist() == [40]
    assert np.nanmax(np.hypot(*np.diff(line, axis=0).T)) < 0.2


def test_a_robot_without_a_path_is_where_it_may_be():
    spread = [0.04 * np.eye(3)]
    assert labels(MapPicture("", WALLS, [path(1.0)[:1]], covariances=spread))[1:] == [
        "robot",
        "95 % of its positions",
    ]


@pytest.mark.parametrize("robots", [1, 2, 8])
def test_a_map_is_a_png_that_can_be_looked_at(tmp_path, robots):
    ways = [path(0.3 * number) for number in range(robots)]
    title = "a $strange$ _title_, that is no mathematics"
    draw_map(tmp_path / "map.png", MapPicture(title, WALLS, ways, ways, WALLS, ways))
    width, height = size_of(tmp_path / "map.png")
    assert 700 <= width <= 2000
    assert 500 <= height <= 2000


@pytest.mark.parametrize("place", [np.zeros((1, 2)), np.full((3, 2), 50.0)])
def test_a_map_without_walls_of_a_robot_that_stood_still(tmp_path, place):
    draw_map(tmp_path / "map.png", MapPicture("still", NOTHING, [place], [place]))
    assert min(size_of(tmp_path / "map.png")) > 100


@pytest.mark.parametrize("height", [3.0, 40.0])
def test_title_and_remark_lie_within_the_picture(tmp_path, height):
    walls = np.array([(0.0, 0.0, 40.0, 0.0), (40.0, 0.0, 40.0, height)])
    remark = "lost: since 37 s the readings contradict the map, and no place explains them. " * 4
    for words in ("", remark):
        file = tmp_path / f"map{len(words)}.png"
        draw_map(file, MapPicture("a log", walls, [path(1.0)], [], remark=words))
        with Pictures.open(file) as picture:
            assert np.asarray(picture.convert("L"))[:4].min() == 255
    more = size_of(tmp_path / f"map{len(remark)}.png")[1] - size_of(tmp_path / "map0.png")[1]
    assert more >= 4 * 0.2 * 160 - 1


@pytest.fixture(scope="module")
def explored(tmp_path_factory):
    """A finished exploration of Env2, whose walls have doors."""
    return run(tmp_path_factory.mktemp("runs") / "env2", "--world", "env2", "--seed", 3)


def test_the_map_of_a_run_is_drawn_from_the_smoothed_path_and_leaves_doors_open(explored):
    final = explored.content("map.json")
    online = explored.content("map_online.json")
    assert final["segments"] != online["segments"]
    assert all(np.linalg.eigvalsh(mark["cov"]).min() > 0.0 for mark in final["landmarks"])
    assert explored.metrics["doors_open"] == 1.0


def test_the_preset_consistent_gives_the_map_of_the_filter(tmp_path, explored):
    plain = run(tmp_path / "filter", "--world", "env2", "--seed", 3, "--preset", "consistent")
    assert plain.content("map.json") == explored.content("map_online.json")
    assert not (plain.path / "trajectory_smoothed.tum").exists()
    assert "ate_smoothed_m" not in plain.metrics
