"""Worlds: the shipped ones are what they claim, and everything that is no usable world is refused
with its reason.
"""

import math
import re

import numpy as np
import pytest

from limslam_env import World, load_world
from limslam_env.geometry import FloatArray, segment

RADIUS = 0.10
BOX = [[0.0, 0.0, 4.0, 0.0], [4.0, 0.0, 4.0, 4.0], [4.0, 4.0, 0.0, 4.0], [0.0, 4.0, 0.0, 0.0]]
GOOD = f"""
name = "good"
size = [4.0, 4.0]
walls = {BOX}
obstacles = [[[2.0, 2.0], [3.0, 2.0], [3.0, 3.0]]]
doors = [[1.0, 0.0, 1.5, 0.0]]
starts = [[1.0, 1.0, 0.5]]
loop = [[1.0, 1.0], [3.5, 1.0], [3.5, 3.5]]
"""


def with_key(key: str, value: str) -> str:
    """GOOD with another value of one key."""
    changed = re.sub(rf"^{key} = .*$", lambda _: f"{key} = {value}", GOOD, flags=re.MULTILINE)
    assert changed != GOOD
    return changed


@pytest.fixture
def world_of(tmp_path):
    """A function that reads a world from a text."""

    def read(text: str) -> World:
        (tmp_path / "w.toml").write_text(text, encoding="utf-8")
        return load_world(tmp_path / "w.toml")

    return read


def box_world(**changes) -> World:
    fields = {
        "name": "box",
        "size": (4.0, 4.0),
        "walls": np.array(BOX),
        "starts": np.array([[1.0, 1.0, 0.0]]),
    }
    return World(**{**fields, **changes})


def test_a_world_is_shown_in_one_line():
    assert repr(load_world("env1")).startswith("<World 'env1': ")
    world = box_world()
    assert repr(world) == "<World 'box': 4 x 4 m, 4 walls, 0 obstacles, 0 doors, 1 start>"


def gap_walls(width: float, middle: float) -> FloatArray:
    """The box with a gap in its lower wall."""
    left = middle - 0.5 * width
    right = middle + 0.5 * width
    return np.array([[0.0, 0.0, left, 0.0], [right, 0.0, 4.0, 0.0], *BOX[1:]])


def segment_set(edges: FloatArray) -> set[frozenset[tuple[float, float]]]:
    """Segments without direction, to the micrometre."""
    ends = np.round(edges.reshape(-1, 2, 2), 6) + 0.0
    return {frozenset(map(tuple, pair.tolist())) for pair in ends}


def test_env1_is_the_same_after_a_quarter_turn():
    edges = load_world("env1").edges
    centred = edges.reshape(-1, 2) - 3.5
    turned = np.column_stack((-centred[:, 1], centred[:, 0])) + 3.5
    assert segment_set(turned.reshape(-1, 4)) == segment_set(edges)
    assert len(segment_set(edges)) == len(edges), "no wall stands twice"


def test_a_good_text_becomes_the_world_it_describes(world_of):
    world = world_of(GOOD)
    assert (world.name, world.size) == ("good", (4.0, 4.0))
    np.testing.assert_array_equal(world.walls, BOX)
    np.testing.assert_array_equal(world.obstacles[0], [[2.0, 2.0], [3.0, 2.0], [3.0, 3.0]])
    np.testing.assert_array_equal(world.doors, [[1.0, 0.0, 1.5, 0.0]])
    np.testing.assert_array_equal(world.starts, [[1.0, 1.0, 0.5]])
    np.testing.assert_array_equal(world.loop, [[1.0, 1.0], [3.5, 1.0], [3.5, 3.5]])
    # Edges: the walls first, then the obstacle's edges in order, the last one closing it.
    np.testing.assert_array_equal(world.edges[:4], BOX)
    np.testing.assert_array_equal(world.edges[4:], [[2, 2, 3, 2], [3, 2, 3, 3], [3, 3, 2, 2]])
    world.check(RADIUS)


def test_only_name_size_and_walls_are_needed_and_whole_numbers_are_numbers(world_of):
    world = world_of('name = "n"\nsize = [4, 4]\nwalls = [[0, 0, 4, 0]]')
    assert [len(rows) for rows in (world.obstacles, world.doors, world.starts, world.loop)] == [
        0,
        0,
        0,
        0,
    ]
    assert world.starts.shape == (0, 3)


def test_worlds_are_equal_by_content_and_cannot_be_changed(world_of):
    world = world_of(GOOD)
    assert world == world_of(GOOD)
    assert hash(world) == hash(world_of(GOOD))
    assert world != world_of(with_key("starts", "[[1.0, 1.0, 0.6]]"))
    for array in (
        world.walls,
        world.obstacles[0],
        world.doors,
        world.starts,
        world.loop,
        world.edges,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 9.0


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (GOOD + "wall = [[0, 0, 1, 1]]\n", r"unknown key 'wall'"),
        (GOOD.replace('name = "good"\n', ""), r"'name' is missing"),
        (with_key("name", "3"), r"name must be a text"),
        (with_key("size", "[4.0]"), r"size must be two lengths"),
        (with_key("size", "[4.0, -4.0]"), r"size must be two lengths"),
        (with_key("size", "[4.0, nan]"), r"size must be two lengths"),
        (
            with_key("size", "[4.0, 1e6]"),
            r"size must be two lengths up to 500 m, not \[4, 1e\+06\]: are they in m\?",
        ),
        (
            with_key("starts", "[[1, 1, 90]]"),
            r"starts\[0\]: a heading is within 4 pi rad, not 90: is it in rad\?",
        ),
        (with_key("size", "4.0"), r"size must be a list of numbers"),
        (with_key("walls", "[[0, 0, 4, nan]]"), r"walls\[0\] holds a number that is not finite"),
        (with_key("walls", "[[0, 0, 4]]"), r"walls must have 4 numbers a row"),
        (
            with_key("walls", "[[0, 0, 4, 0], [0, 0, 4]]"),
            r"walls\[1\] has 3 numbers, and walls\[0\] has 4",
        ),
        (with_key("walls", '"none"'), r"walls must be a list of lists"),
        (with_key("walls", "[[0, 0, 4, 0], [1, 1, 1, 1]]"), r"walls\[1\] has no length"),
        (with_key("walls", "[[0, 0, 2000, 0]]"), r"reach further than"),
        (with_key("walls", f"[[0, 0, 1{'0' * 400}, 0]]"), r"walls must be a list of lists"),
        (with_key("obstacles", "[[[1, 1], [2, 2]]]"), r"obstacles\[0\] has 2 corners"),
        (with_key("obstacles", "[[[1, 1], [2, 1], [2, 1]]]"), r"obstacle edge 1 has no length"),
        (with_key("obstacles", "false"), r"obstacles must be a list"),
        (with_key("starts", "[[1, 1]]"), r"starts must have 3 numbers a row"),
        ('name = "n"\nsize = [1, 1]\nwalls = []\n', r"0 walls and obstacle edges"),
        ("walls = [[0, 0", r"not TOML"),
        ("a = " + "[" * 5000, r"not TOML"),
    ],
    ids=lambda value: re.sub(r"\W+", "-", value)[-40:],
)
def test_text_that_is_no_world_is_refused_with_the_reason(text, reason, world_of):
    with pytest.raises(ValueError, match=rf"w\.toml: .*{reason}"):
        world_of(text)


@pytest.mark.parametrize("key", ["doors", "starts", "loop"])
@pytest.mark.parametrize("value", ["false", "{}"])
def test_a_list_that_is_left_empty_must_still_be_a_list(key, value, world_of):
    with pytest.raises(ValueError, match=key):
        world_of(with_key(key, value))


@pytest.mark.parametrize(
    ("start", "reason"),
    [
        ([2.0, 3.0, 0.0], "inside an obstacle"),
        ([0.09, 2.0, 0.0], "0.090 m from a wall"),
        ([1.45, 2.0, 0.0], "0.050 m from a wall"),
        ([4.5, 2.0, 0.0], "not closed|outside"),
        ([100.0, 100.0, 0.0], "not closed|outside"),
    ],
)
def test_a_start_that_cannot_be_is_refused(start, reason):
    block = np.array([[1.5, 1.5], [2.5, 1.5], [2.5, 3.5], [1.5, 3.5]])
    with pytest.raises(ValueError, match=reason):
        box_world(obstacles=(block,), starts=np.array([[1.0, 1.0, 0.0], start])).check(RADIUS)
    with pytest.raises(ValueError, match=reason):
        box_world(obstacles=(block,)).check_poses(np.array([start]), RADIUS)


@pytest.mark.parametrize(
    "pose", [[math.nan, 1.0, 0.0], [1.0, math.inf, 0.0], [1.0, 1.0, math.nan], [1.0, 1.0]]
)
def test_a_pose_that_is_not_three_finite_numbers_is_refused(pose):
    with pytest.raises(ValueError, match="three finite numbers"):
        box_world().check_poses(np.array([pose]), RADIUS)


def test_a_pose_that_just_fits_is_fine():
    box_world().check_poses(np.array([[RADIUS, RADIUS, 1.0]]), RADIUS)


@pytest.mark.parametrize(("width", "middle"), [(0.205, 1.993), (0.21, 2.0125), (0.5, 2.0)])
@pytest.mark.parametrize("starts", [[[1.0, 1.0, 0.0]], []], ids=["start", "no start"])
def test_a_gap_wider_than_the_robot_is_refused(width, middle, starts):
    world = box_world(walls=gap_walls(width, middle), starts=np.array(starts).reshape(-1, 3))
    with pytest.raises(ValueError, match="closed"):
        world.check(RADIUS)


def test_a_pose_from_which_a_gap_leads_out_is_refused():
    with pytest.raises(ValueError, match="closed"):
        box_world(walls=gap_walls(0.3, 2.0)).check_poses(np.array([[1.0, 1.0, 0.0]]), RADIUS)


@pytest.mark.parametrize("starts", [[[1.0, 1.0, 0.0]], []], ids=["start", "no start"])
@pytest.mark.parametrize("width", [0.02, 0.15])
def test_a_gap_narrower_than_the_robot_is_fine(width, starts):
    box_world(walls=gap_walls(width, 1.993), starts=np.array(starts).reshape(-1, 3)).check(RADIUS)


def test_a_world_without_room_is_refused():
    small = np.array(BOX) * 0.04
    with pytest.raises(ValueError, match="no closed region has room"):
        box_world(walls=small, starts=np.zeros((0, 3))).check(RADIUS)


@pytest.mark.parametrize("side", [30.013, 400.013])
def test_a_large_closed_world_is_closed(side):
    # Worlds may measure up to 1000 m; the reachability grid gets coarser, the walls no thinner.
    world = box_world(size=(side, side), walls=np.array(BOX) * (side / 4.0))
    world.check(RADIUS)


def test_load_world_takes_a_name_a_path_and_a_world(tmp_path, world_of):
    path = tmp_path / "mine.toml"
    path.write_text(GOOD, encoding="utf-8")
    assert load_world(path) == load_world(str(path)) == world_of(GOOD)
    world = load_world("env1")
    assert load_world(world) is world


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("missing.toml", None, "no such file"),
        ("folder.toml/", None, "no such file"),
        ("text.txt", b"", "not a world file"),
        ("bytes.toml", b"\xff\xfe\x00", "cannot be read"),
        ("broken.toml", b"walls = [", "not TOML"),
        ("empty.toml", b"", "is missing"),
    ],
)
def test_a_file_that_is_no_world_is_refused_and_named(tmp_path, name, content, reason):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    elif name.endswith("/"):
        path.mkdir()
    with pytest.raises(ValueError, match=f"{re.escape(str(path))}.*{reason}"):
        load_world(path)


def test_an_unknown_name_is_refused_with_those_that_there_are():
    with pytest.raises(ValueError, match=r"no world is called 'env9'; there are .*env1.*square"):
        load_world("env9")


@pytest.mark.parametrize("name", ["", "x" * 5000, "nul\0", "x" * 5000 + ".toml"], ids=range(4))
def test_a_name_that_no_file_can_have_is_refused(name):
    with pytest.raises(ValueError):
        load_world(name)


PAPER = {"env1": (7.0, 7.0), "env2": (9.0, 5.3), "env3": (7.0, 5.5)}
NARROW = (0.60, 0.70)
CLEARLY_WIDER = 0.90
LOOP_CLEARANCE = 0.35
NARROWEST_PASSAGE = 0.60


@pytest.fixture(params=PAPER)
def world(request) -> World:
    return load_world(request.param)


def interior_regions(world: World, radius: float) -> list[int]:
    """Cells of each region that a disc of a radius (m) cannot leave the world from."""
    space = world.free_space(radius)
    sizes = np.bincount(space.labels.ravel())
    border = np.concatenate(
        (space.labels[0], space.labels[-1], space.labels[:, 0], space.labels[:, -1])
    )
    sizes[[0, *np.unique(border)]] = 0
    return [int(size) for size in sizes if size]


def collinear_gaps(walls: FloatArray) -> set[tuple[float, float, float, float]]:
    """Openings (x1, y1, x2, y2) between neighbouring axis-parallel walls on one line, lower end
    first.
    """
    gaps = set()
    for axis in (0, 1):
        across = 1 - axis
        for at in np.unique(walls[walls[:, across] == walls[:, across + 2], across]):
            on_line = walls[(walls[:, across] == at) & (walls[:, across + 2] == at)][
                :, [axis, axis + 2]
            ]
            pieces = np.sort(on_line, axis=1)[np.argsort(on_line.min(axis=1))]
            for end, start in zip(pieces[:-1, 1], pieces[1:, 0], strict=True):
                if start > end:
                    gaps.add((end, at, start, at) if axis == 0 else (at, end, at, start))
    return gaps


def test_it_has_the_paper_s_size(world):
    assert world.size == PAPER[world.name]


def test_passages_are_wide_enough_to_pass_with_ease(world):
    # A larger disc still gets everywhere, so nothing hangs on a robot's last centimetre.
    assert len(interior_regions(world, 0.5 * NARROWEST_PASSAGE - 0.01)) == 1


def test_the_loop_is_a_closed_tour_with_clearance_round_something(world):
    tour, _ = segment.sample(segment.polygon_edges(world.loop), 0.01)
    assert segment.distances(tour, world.edges).min() >= LOOP_CLEARANCE
    middles = 0.5 * (world.edges[:, :2] + world.edges[:, 2:])
    assert segment.inside_polygon(middles, world.loop).sum() >= 4


def test_doors_are_open_and_lie_between_wall_ends_on_one_line(world):
    assert {tuple(door) for door in world.doors.tolist()} <= collinear_gaps(world.walls)
    for door in world.doors:
        points, _ = segment.sample(door[None], 0.01)
        to_jambs = np.minimum(
            *(np.linalg.norm(points - end, axis=1) for end in (door[:2], door[2:]))
        )
        np.testing.assert_allclose(
            segment.distances(points, world.edges).min(axis=1), to_jambs, atol=1e-9
        )


def test_env2_has_perpendicular_walls_and_nothing_else():
    world = load_world("env2")
    spans = np.abs(world.walls[:, 2:] - world.walls[:, :2])
    assert (spans.min(axis=1) == 0.0).all()
    assert (spans > 0.0).any(axis=0).all(), "walls run both ways"
    assert not world.obstacles


def test_env2_has_one_narrow_door_and_it_comes_first():
    widths = segment.lengths(load_world("env2").doors)
    assert NARROW[0] <= widths[0] <= NARROW[1]
    assert (widths[1:] >= CLEARLY_WIDER).all()


def hall(walls, **more):
    return World("hall", (17.0, 14.0), np.array(walls, dtype=float), **more)
