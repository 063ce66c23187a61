"""Pictures of one environment and of a batch: their format, walls where walls are, robots that
move, and overlays.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.episodes import held_actions

from limslam_env import (
    FloorPlanConfig,
    LimSlamEnv,
    LimSlamVectorEnv,
    NoiseConfig,
    Overlay,
    RobotSpec,
    SensorSpec,
    World,
    canvas,
    load_world,
)
from limslam_env.rendering import rendering
from limslam_env.rendering.rendering import RenderState, render

AHEAD = np.array([1.0, 1.0])


def picture_of(
    start: tuple[float, float, float], steps: int = 0, world: str | World = "env1"
) -> np.ndarray:
    env = LimSlamEnv(world, render_mode="rgb_array")
    env.reset(seed=0, options={"start": start})
    for _ in range(steps):
        env.step(AHEAD)
    return env.render()


def wall_box(picture: np.ndarray) -> tuple[int, int, int, int]:
    """First and last row and column of the outer walls, by their darkness."""
    dark = picture.max(axis=2) < 110
    # The caption above the walls is dark in places too, but never along half a row.
    rows = np.nonzero(dark.mean(axis=1) > 0.5)[0]
    columns = np.nonzero(dark.mean(axis=0) > 0.5)[0]
    return rows[0], rows[-1], columns[0], columns[-1]


@pytest.mark.parametrize("size", [(5.03, 3.17), (3.3, 5.0), (30.0, 2.0)])
def test_sides_are_even_whatever_the_shape_of_the_world(size):
    width, height = size
    walls = np.array(
        [[0, 0, width, 0], [width, 0, width, height], [width, height, 0, height], [0, height, 0, 0]]
    )
    picture = picture_of((1.0, 1.0, 0.3), world=World("oblong", size, walls))
    assert picture.shape[0] % 2 == picture.shape[1] % 2 == 0
    top, bottom, left, right = wall_box(picture)
    assert (right - left) / (bottom - top) == pytest.approx(width / height, rel=0.03)


def test_walls_are_dark_where_they_stand_and_the_floor_is_light():
    world = load_world("env1")
    picture = picture_of((1.2, 2.0, 0.0)).max(axis=2).astype(int)
    top, bottom, left, right = wall_box(picture_of((1.2, 2.0, 0.0)))

    def darkest_near(x: float, y: float) -> int:
        row = round(bottom + (top - bottom) * y / 7.0)
        column = round(left + (right - left) * x / 7.0)
        return int(picture[row - 2 : row + 3, column - 2 : column + 3].min())

    for x1, y1, x2, y2 in world.edges:
        for fraction in (0.25, 0.5, 0.75):
            assert darkest_near(x1 + fraction * (x2 - x1), y1 + fraction * (y2 - y1)) < 110
    for x, y in ((6.3, 3.5), (3.5, 6.0), (0.6, 6.3), (3.5, 3.5)):
        assert darkest_near(x, y) > 180


def test_the_picture_follows_the_robot_and_draws_its_path():
    env = LimSlamEnv("env1", render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    for _ in range(30):
        env.step(AHEAD)
    after = env.render()
    assert after.shape == before.shape
    changed = (before != after).any(axis=2)
    assert 500 < changed.sum() < 0.2 * changed.size
    # From (1.2, 2.0) the robot drove 0.9 m to the right; a path lies behind it that a robot put
    # there has not.
    placed = picture_of((2.1, 2.0, 0.0))
    behind = (after != placed).any(axis=2)
    behind[:40] = False  # the caption
    columns = np.nonzero(behind.any(axis=0))[0]
    _, _, left, right = wall_box(before)
    metres = (columns - left) * 7.0 / (right - left)
    # What was seen from the start lies behind it too, as far as the body reaches and half a cell
    # more.
    assert metres.min() == pytest.approx(1.1, abs=0.15)


def test_a_new_episode_forgets_the_old_path():
    env = LimSlamEnv("env1", render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    for _ in range(20):
        env.step(AHEAD)
    env.reset(seed=0)
    np.testing.assert_array_equal(env.render(), before)


def test_rendering_changes_nothing_in_the_episode_nor_in_earlier_pictures():
    drawn = LimSlamEnv("env1", sensor_noise=0.02, render_mode="rgb_array")
    plain = LimSlamEnv("env1", sensor_noise=0.02)
    drawn.reset(seed=0)
    plain.reset(seed=0)
    first = drawn.render()
    copy = first.copy()
    for _ in range(20):
        with_picture = drawn.step(AHEAD)
        without = plain.step(AHEAD)
        drawn.render()
        np.testing.assert_array_equal(with_picture[0]["ranges"], without[0]["ranges"])
        np.testing.assert_array_equal(with_picture[4]["pose"], without[4]["pose"])
    np.testing.assert_array_equal(first, copy)


# What follows draws states made by hand, in a hall of 6 x 4 m whose lower left corner is not the
# origin.

LOW = np.array([-1.0, 2.0])
ONE_BEAM = RobotSpec(beams=(SensorSpec(0.1, 0.0, 0.0),))


def outline(*corners) -> np.ndarray:
    points = np.array(corners, dtype=float)
    return np.hstack((points, np.roll(points, -1, axis=0)))


HALL = World(
    "hall",
    (6.0, 4.0),
    outline((-1.0, 2.0), (5.0, 2.0), (5.0, 6.0), (-1.0, 6.0)),
    obstacles=(np.array([(2.5, 3.0), (3.5, 3.0), (3.5, 4.0), (2.5, 4.0)]),),
)


NOTHING_SEEN = np.zeros((1, 1), dtype=bool), np.zeros(2)


def state_of(*poses, world: World = HALL, **changes) -> RenderState:
    poses = np.array(poses or [(0.0, 5.0, 0.0)])
    nothing = np.full((len(poses), 1), -1)
    state = RenderState(
        world, ONE_BEAM, poses, nothing, np.full((len(poses), 1), 1.5), [], 0.0, 0.0, *NOTHING_SEEN
    )
    return replace(state, **changes)


def colours_at(
    picture: np.ndarray, x: float, y: float, world: World = HALL, reach: int = 1
) -> np.ndarray:
    """Colours (k, 3) of the pixels around a place, m; where it falls is told by the walls."""
    top, bottom, left, right = wall_box(picture)
    corners = world.edges.reshape(-1, 2)
    share = (np.array([x, y]) - corners.min(axis=0)) / np.ptp(corners, axis=0)
    column = round(left + share[0] * (right - left))
    row = round(bottom - share[1] * (bottom - top))
    return (
        picture[row - reach : row + reach + 1, column - reach : column + reach + 1]
        .reshape(-1, 3)
        .astype(int)
    )


def is_like(pixels: np.ndarray, colour) -> np.ndarray:
    """Which pixels are nearer to a colour than to the floor: a thin line shares its pixels with
    it.
    """
    paleness = np.abs(np.array(canvas.UNSEEN) - colour).sum()
    return np.abs(pixels - colour).sum(axis=1) < 0.6 * paleness


def shows(picture: np.ndarray, x: float, y: float, colour, **how) -> bool:
    return bool(is_like(colours_at(picture, x, y, **how), colour).any())


def seen_in_hall(*places) -> np.ndarray:
    seen = np.zeros((40, 60), dtype=bool)
    for x, y in places:
        column, row = np.floor((np.array([x, y]) - LOW) / 0.1).astype(int)
        seen[row - 1 : row + 2, column - 1 : column + 2] = True
    return seen


def test_seen_floor_is_lighter_where_it_was_seen_and_nowhere_else():
    picture = render(state_of(seen=seen_in_hall((4.0, 2.55), (4.45, 5.55)), seen_low=LOW))
    unseen = render(state_of())
    for x, y in ((4.0, 2.55), (4.45, 5.55)):
        assert (
            colours_at(picture, x, y).sum(axis=1) > colours_at(unseen, x, y).sum(axis=1) + 30
        ).all()
        for aside in ((0.3, 0.0), (-0.3, 0.0), (0.0, 0.3), (0.0, -0.3)):
            place = (x + aside[0], y + aside[1])
            np.testing.assert_array_equal(colours_at(picture, *place), colours_at(unseen, *place))


def test_beams_are_coloured_by_what_they_hit():
    ends = {}
    for hit, colour in (
        (-1, rendering._NO_HIT),
        (4, canvas.BEAM),
        (-2, rendering._ROBOT_HIT),
    ):
        picture = render(state_of(hits=np.array([[hit]]), ranges=np.array([[1.2]])))
        for x in (0.3, 0.7, 1.2):
            assert shows(picture, x, 5.0, colour)
        assert not shows(picture, 1.4, 5.0, colour)
        ends[hit] = is_like(colours_at(picture, 1.3, 5.0, reach=3), colour).sum()
    # What was hit is marked with a dot.
    assert min(ends[4], ends[-2]) > 2 * ends[-1]


def test_several_robots_have_a_colour_each_and_trails_in_it():
    poses = [(0.0, 2.5 + 0.5 * number, 0.0) for number in range(6)]
    paths = [np.array([(-0.8, y), (x, y)]) for x, y, _ in poses]
    picture = render(state_of(*poses, paths=paths))
    bodies = [tuple(colours_at(picture, x, y + 0.07, reach=0)[0]) for x, y, _ in poses]
    assert len(set(bodies)) == 6
    trails = [tuple(colours_at(picture, -0.5, y, reach=0)[0]) for _, y, _ in poses]
    assert len(set(trails)) == 6
    # More robots than colours begin anew.
    many = [(-0.7 + 0.25 * number, 5.0, 0.0) for number in range(9)]
    assert render(state_of(*many)).shape == picture.shape


def test_an_overlay_is_drawn_where_it_says_and_only_there():
    overlay = Overlay(
        segments=np.array([(1.0, 2.5, 4.0, 2.6)]),
        frontier=np.array([(4.5, 4.5), (4.5, 4.7)]),
        plan=np.array([(0.0, 5.0), (1.0, 5.5), (2.0, 5.5)]),
    )
    picture = render(state_of(overlay=[overlay]))
    plain = render(state_of())
    for x, y in ((1.0, 2.5), (2.5, 2.55), (4.0, 2.6)):
        assert shows(picture, x, y, canvas.BELIEF)
    for x, y in overlay.frontier:
        assert shows(picture, x, y, canvas.FRONTIER)
    for x, y in ((0.5, 5.25), (1.5, 5.5), (2.0, 5.5)):
        assert (colours_at(picture, x, y) != colours_at(plain, x, y)).any()
    for x, y in ((2.5, 2.8), (4.5, 4.9), (4.2, 4.5), (1.5, 5.2), (4.5, 2.6)):
        np.testing.assert_array_equal(colours_at(picture, x, y), colours_at(plain, x, y))


@pytest.mark.parametrize("turned", [0.6])
def test_the_ellipse_holds_95_percent(turned):
    axes = np.array([[math.cos(turned), math.sin(turned)], [-math.sin(turned), math.cos(turned)]])
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = axes.T @ np.diag([0.3**2, 0.1**2]) @ axes
    picture = render(
        state_of((4.5, 5.5, 0.0), overlay=[Overlay(np.array([1.0, 3.5, turned]), covariance)])
    )
    # A normal distribution of the plane lies within 2.448 standard deviations with a probability of
    # 95 %.
    for axis, std in ((axes[0], 0.3), (-axes[0], 0.3), (axes[1], 0.1), (-axes[1], 0.1)):
        tip = np.array([1.0, 3.5]) + 2.448 * std * axis
        assert shows(picture, *tip, canvas.BELIEF)
        assert not shows(picture, *(tip + 0.06 * axis), canvas.BELIEF)


@pytest.mark.parametrize("far", [1e12])
def test_a_belief_that_is_far_off_is_drawn_as_far_as_it_can_be_seen(far):
    lost = Overlay(
        np.array([far, -far, 1.0]),
        far**2 * np.eye(3),
        np.array([(2.0, 2.5, 2.0, far)]),
        np.full((2, 2), -far),
        np.array([(4.0, 2.5), (far, 2.5)]),
    )
    picture = render(state_of(overlay=[lost]))
    plain = render(state_of())
    assert shows(picture, 2.0, 5.0, canvas.BELIEF)
    assert (colours_at(picture, 4.6, 2.5) != colours_at(plain, 4.6, 2.5)).any()
    np.testing.assert_array_equal(colours_at(picture, 0.5, 3.5), colours_at(plain, 0.5, 3.5))


def test_time_and_coverage_stand_above_the_world():
    plain = render(state_of())
    top = wall_box(plain)[0]
    for changed in (state_of(time=12.5), state_of(coverage=0.4)):
        rows = np.nonzero((render(changed) != plain).any(axis=(1, 2)))[0]
        assert len(rows)
        assert rows.max() < top - 1


def test_the_outside_of_a_building_is_no_floor():
    corners = [(0, 0), (4, 0), (4, 2), (2, 2), (2, 4), (0, 4)]
    # The doorway is no hole: beyond it lies the outside all the same.
    world = World("ell", (4.0, 4.0), outline(*corners)[1:], doors=np.array([[0.0, 0.0, 4.0, 0.0]]))
    picture = render(state_of((1.0, 1.0, 0.0), world=world))
    height, width = picture.shape[:2]
    assert tuple(picture[int(0.3 * height), int(0.7 * width)]) == canvas.PAPER
    assert tuple(picture[int(0.7 * height), int(0.7 * width)]) == canvas.UNSEEN
    assert tuple(picture[int(0.3 * height), int(0.25 * width)]) == canvas.UNSEEN


QUIET = NoiseConfig(wheel_variance=0.0)
WORLDS = ["env1", "env2", "env3"]
SMALL = FloorPlanConfig(width=4.0, height=(4.0, 6.0))


def drawing(world=WORLDS, count: int = 3, **arguments) -> LimSlamVectorEnv:
    return LimSlamVectorEnv(world, count, noise=QUIET, render_mode="rgb_array", **arguments)


def single(world: str) -> LimSlamEnv:
    return LimSlamEnv(world, noise=QUIET, render_mode="rgb_array")


def square(env: LimSlamEnv):
    """The picture of a single environment, as wide as high."""
    plain = rendering.render
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            rendering,
            "render",
            lambda state: plain(state, background=rendering.square_background(state.world)),
        )
        return env.render()


def test_they_are_those_of_the_single_environment_and_all_of_one_size():
    batch = drawing()
    singles = [single(world) for world in WORLDS]
    batch.reset(seed=0)
    for env in singles:
        env.reset(seed=0)
    for actions in held_actions(40, 3):
        observations, _, _, _, infos = batch.step(actions)
        for action, env in zip(actions, singles, strict=True):
            env.step(action)
    # What the caller does with the arrays does not change the pictures.
    observations["ranges"][:] = 0.3
    infos["pose"][:] = 1.0
    pictures = batch.render()
    assert [picture.shape for picture in pictures] == [(640, 640, 3)] * 3
    for picture, env in zip(pictures, singles, strict=True):
        # Rays of the batch may differ by less than a hundredth of a pixel.
        assert (picture != square(env)).any(axis=2).mean() < 1e-3


@pytest.mark.parametrize(
    ("world", "arguments", "options"),
    [
        (WORLDS, {}, {}),
        (WORLDS, {}, {"start": np.array([[1.0, 1.0, 0.0], [0.5, 0.5, 1.0], [1.0, 1.5, 2.0]])}),
        (SMALL, {}, {}),
        (SMALL, {"plans": 2}, {}),
    ],
    ids=["worlds", "starts", "a new plan at each reset", "plans"],
)
def test_each_environment_is_drawn_in_its_own_world(world, arguments, options):
    batch = drawing(world, **arguments)
    looked_at = 0
    for seed in (1, None):
        observations, infos = batch.reset(seed=seed, options=options)
        for number in range(3):
            edges = batch._simulation.world(number).edges
            x, y, theta = infos["pose"][number]
            # A wall that is nearer than the shortest range is not where the reading ends.
            seen = np.flatnonzero(
                (infos["wall_seen"][number] >= 0) & (observations["ranges"][number] > 0.051)
            )
            looked_at += len(seen)
            angles = theta + np.array([beam.angle for beam in batch.robot.beams])[seen]
            reach = batch.robot.radius + observations["ranges"][number, seen]
            ends = np.column_stack((x + reach * np.cos(angles), y + reach * np.sin(angles)))
            for (x1, y1, x2, y2), (u, v) in zip(
                edges[infos["wall_seen"][number, seen]], ends, strict=True
            ):
                off = abs((x2 - x1) * (v - y1) - (y2 - y1) * (u - x1)) / np.hypot(x2 - x1, y2 - y1)
                assert off < 1e-5
    assert looked_at > 6


@pytest.mark.parametrize("arguments", [{}, {"plans": 9}], ids=["a new plan at each reset", "plans"])
def test_a_reset_with_a_seed_of_some_leaves_the_others_in_their_worlds(arguments):
    batch = drawing(SMALL, autoreset_mode="Disabled", **arguments)
    batch.reset(seed=0)
    worlds = [batch._simulation.world(number) for number in range(3)]
    pictures = batch.render()
    batch.reset(seed=5, options={"reset_mask": np.array([True, False, False])})
    assert [batch._simulation.world(number) == worlds[number] for number in range(3)] == [
        False,
        True,
        True,
    ]
    after = batch.render()
    assert [np.array_equal(after[number], pictures[number]) for number in range(3)] == [
        False,
        True,
        True,
    ]


def test_a_new_episode_begins_a_new_trail():
    batch = drawing(["env1"] * 2, 2, max_episode_steps=5)
    fresh = drawing(["env1"] * 2, 2)
    batch.reset(seed=0)
    for _ in range(6):
        batch.step(np.full((2, 2), 0.5))
    fresh.reset(seed=0)
    for picture, other in zip(batch.render(), fresh.render(), strict=True):
        np.testing.assert_array_equal(picture, other)


def test_without_a_render_mode_or_before_the_first_reset_there_are_none():
    assert drawing().render() is None
    plain = LimSlamVectorEnv("env1", 2)
    plain.reset(seed=0)
    assert plain.render() is None


POSE = np.array([1.0, 2.0, 0.5])


def test_empty_lists_are_no_rows():
    overlay = Overlay(segments=[], frontier=[], plan=[])
    assert (overlay.segments.shape, overlay.frontier.shape, overlay.plan.shape) == (
        (0, 4),
        (0, 2),
        (0, 2),
    )


def test_lists_and_other_number_types_will_do():
    overlay = Overlay(
        (1, 2, 0), np.eye(3, dtype=np.float32), [[0, 0, 1, 1]], [[1, 2], [3, 4]], [[5, 6]]
    )
    for name in ("pose", "covariance", "segments", "frontier", "plan"):
        assert getattr(overlay, name).dtype == float
    np.testing.assert_array_equal(overlay.frontier, [[1.0, 2.0], [3.0, 4.0]])


def test_arrays_are_copies_that_nobody_can_write_to():
    given = {
        "pose": POSE.copy(),
        "covariance": np.eye(3),
        "segments": np.ones((2, 4)),
        "frontier": np.ones((3, 2)),
        "plan": np.ones((4, 2)),
    }
    before = {name: array.copy() for name, array in given.items()}
    overlay = Overlay(**given)
    for name, array in given.items():
        array[:] = -7.0
        np.testing.assert_array_equal(getattr(overlay, name), before[name])
        with pytest.raises(ValueError, match="read-only"):
            getattr(overlay, name)[:] = 0.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"pose": [1.0, 2.0]}, r"pose must have shape \(3\), not \(2,\)"),
        ({"pose": POSE, "covariance": np.eye(2)}, r"covariance must have shape \(3, 3\)"),
        ({"covariance": np.eye(3)}, "needs a pose"),
        ({"segments": np.zeros((2, 5))}, r"segments must have shape \(n, 4\), not \(2, 5\)"),
        ({"frontier": np.zeros((2, 3))}, "frontier must have shape"),
        ({"plan": [[0.0, 1.0], [2.0]]}, "plan must be an array of numbers"),
        ({"pose": [np.nan, 0.0, 0.0]}, "pose holds a number that is not finite"),
        (
            {"pose": POSE, "covariance": np.full((3, 3), np.inf)},
            "covariance holds a number that is not finite",
        ),
    ],
)
def test_what_cannot_be_drawn_is_refused_in_one_line(arguments, words):
    with pytest.raises(ValueError, match=words) as refusal:
        Overlay(**arguments)
    assert "\n" not in str(refusal.value)
