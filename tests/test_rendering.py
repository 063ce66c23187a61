"""Pictures: their format, walls where walls are, and a robot that moves."""

import gymnasium as gym
import numpy as np
import pytest

from limslam_env.env import LimSlamEnv
from limslam_env.world import World, load_world

AHEAD = np.array([1.0, 1.0])


def picture_of(start: tuple[float, float, float], steps: int = 0, world: str | World = "env1") -> np.ndarray:
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


@pytest.mark.parametrize("world", ["env1", "square"])
def test_a_picture_is_rgb_with_even_sides(world):
    picture = picture_of((1.2, 2.0, 0.0) if world == "env1" else (1.0, 1.0, 0.0), world=world)
    assert picture.dtype == np.uint8
    assert picture.ndim == 3
    assert picture.shape[2] == 3
    # Video codecs refuse odd sides.
    assert picture.shape[0] % 2 == picture.shape[1] % 2 == 0


@pytest.mark.parametrize("size", [(5.03, 3.17), (3.3, 5.0), (30.0, 2.0)])
def test_sides_are_even_whatever_the_shape_of_the_world(size):
    width, height = size
    walls = np.array([[0, 0, width, 0], [width, 0, width, height], [width, height, 0, height], [0, height, 0, 0]])
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


def test_y_points_up():
    low, high = (picture_of((1.0, y, 0.0)).astype(int) for y in (2.0, 3.5))
    empty = picture_of((6.0, 5.5, 0.0)).astype(int)
    left = np.s_[:, : empty.shape[1] // 3]
    rows = [np.nonzero(np.abs(picture - empty)[left].sum(axis=(1, 2)) > 600)[0].mean() for picture in (low, high)]
    assert rows[0] > rows[1] + 50


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
    # From (1.2, 2.0) the robot drove 0.9 m to the right; a path lies behind it that a robot put there has not.
    placed = picture_of((2.1, 2.0, 0.0))
    behind = (after != placed).any(axis=2)
    behind[:40] = False  # the caption
    columns = np.nonzero(behind.any(axis=0))[0]
    _, _, left, right = wall_box(before)
    metres = (columns - left) * 7.0 / (right - left)
    assert metres.min() == pytest.approx(1.2, abs=0.1)


def test_a_new_episode_forgets_the_old_path():
    env = LimSlamEnv("env1", render_mode="rgb_array")
    env.reset(seed=0)
    before = env.render()
    for _ in range(20):
        env.step(AHEAD)
    env.reset(seed=0)
    np.testing.assert_array_equal(env.render(), before)


def test_rendering_changes_nothing_in_the_episode_nor_in_earlier_pictures():
    drawn, plain = LimSlamEnv("env1", sensor_noise=0.02, render_mode="rgb_array"), LimSlamEnv("env1", sensor_noise=0.02)
    drawn.reset(seed=0)
    plain.reset(seed=0)
    first = drawn.render()
    copy = first.copy()
    for _ in range(20):
        with_picture, without = drawn.step(AHEAD), plain.step(AHEAD)
        drawn.render()
        np.testing.assert_array_equal(with_picture[0]["ranges"], without[0]["ranges"])
        np.testing.assert_array_equal(with_picture[4]["pose"], without[4]["pose"])
    np.testing.assert_array_equal(first, copy)


def test_without_a_render_mode_there_is_no_picture():
    env = LimSlamEnv("env1")
    env.reset(seed=0)
    assert env.render() is None


def test_gymnasium_hands_the_picture_through():
    env = gym.make("LimSlam-Env1-v0", render_mode="rgb_array")
    env.reset(seed=0)
    env.step(AHEAD.astype(np.float32))
    assert env.render().dtype == np.uint8
    env.close()
