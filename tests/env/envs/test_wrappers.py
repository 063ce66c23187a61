"""Wrappers: outputs within their spaces, values worked out by hand, and refusals."""

import math

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from limslam_env import LimSlamEnv, NoiseConfig, RobotSpec
from limslam_env.envs.wrappers import (
    FORWARD,
    FREE,
    LEFT,
    RIGHT,
    UNSEEN,
    WALL,
    DiscreteAction,
    FlattenObservation,
    FrameStackObservation,
    NormalizedObservation,
    NormalizedVectorObservation,
    PrivilegedLocalMap,
    VelocityAction,
)
from limslam_env.geometry import segment
from limslam_env.interface import beams_on_rim
from limslam_env.robots import ring

FRONT = RobotSpec(beams=beams_on_rim((0.0, 90.0, -90.0), 0.10))
NO_NOISE = NoiseConfig(wheel_variance=0.0)
STACKS = {
    "normalized": NormalizedObservation,
    "velocity": VelocityAction,
    "discrete": DiscreteAction,
    "flat": FlattenObservation,
    "stacked": lambda env: FrameStackObservation(env, 4),
    "flat and stacked": lambda env: FlattenObservation(FrameStackObservation(env, 4)),
    "local map": PrivilegedLocalMap,
    "small local map": lambda env: PrivilegedLocalMap(env, size=7),
    "normalized map": lambda env: NormalizedObservation(PrivilegedLocalMap(env)),
    "mapped and normalized": lambda env: PrivilegedLocalMap(NormalizedObservation(env)),
    "all": lambda env: FlattenObservation(
        FrameStackObservation(
            NormalizedObservation(PrivilegedLocalMap(DiscreteAction(env), size=9)), 2
        )
    ),
}


class Stranger(gym.Env):
    """Looks like one of ours and is none."""

    observation_space = spaces.Dict(
        {
            "ranges": spaces.Box(0.0, 1.0, (3,), np.float32),
            "wheels": spaces.Box(-1.0, 1.0, (2,), np.float32),
        }
    )
    action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)


@pytest.mark.parametrize("stack", STACKS)
def test_what_comes_out_lies_in_the_space(stack):
    noise = NoiseConfig.sharp(wheel_variance=1e-3)
    env = STACKS[stack](gym.make("LimSlam-Random-v0", noise=noise, max_episode_steps=100))
    env.action_space.seed(0)
    observation, _ = env.reset(seed=0)
    resets = 0
    for _ in range(200):
        assert env.observation_space.contains(observation)
        observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert type(reward) is float
        if terminated or truncated:
            observation, _ = env.reset()
            resets += 1
    assert resets == 2
    env.close()


@pytest.mark.parametrize("stack", STACKS)
def test_a_wrapper_changes_nothing_about_the_world(stack):
    env = STACKS[stack](LimSlamEnv("env1"))
    plain = LimSlamEnv("env1")
    env.action_space.seed(1)
    np.testing.assert_array_equal(env.reset(seed=3)[1]["pose"], plain.reset(seed=3)[1]["pose"])
    for _ in range(30):
        action = env.action_space.sample()
        wheels = (
            env.get_wrapper_attr("action")(action) if env.has_wrapper_attr("action") else action
        )
        _, reward, *_, info = env.step(action)
        _, expected, *_, true = plain.step(wheels)
        np.testing.assert_array_equal(info["pose"], true["pose"])
        assert reward == expected


def test_normalized_readings_by_hand():
    env = NormalizedObservation(LimSlamEnv("square", robot=FRONT, noise=NO_NOISE))
    # Walls at x = 7 and y = 0; the rim stands 0.5 m from one and 0.775 m from the other, and
    # nothing is on the left.
    observation, _ = env.reset(seed=0, options={"start": (6.4, 0.875, 0.0)})
    np.testing.assert_allclose(observation["ranges"], [0.45 / 1.45, 1.0, 0.5], atol=1e-6)
    assert observation["ranges"][1] == 1.0
    np.testing.assert_array_equal(observation["wheels"], 0.0)
    # A wheel at full speed does half of what an encoder can tell.
    observation, *_ = env.step([1.0, -0.5])
    np.testing.assert_allclose(observation["wheels"], [0.5, -0.25], atol=1e-6)
    assert observation["ranges"].dtype == observation["wheels"].dtype == np.float32


def test_each_beam_is_normalized_by_its_own_limits():
    beams = (
        *beams_on_rim((0.0,), 0.1, max_range=1.0),
        *beams_on_rim((0.0,), 0.1, min_range=0.2, max_range=4.2),
    )
    env = NormalizedObservation(LimSlamEnv("square", robot=RobotSpec(beams=beams), noise=NO_NOISE))
    observation, _ = env.reset(seed=0, options={"start": (6.4, 1.0, 0.0)})
    np.testing.assert_allclose(observation["ranges"], [0.45 / 0.95, 0.3 / 4.0], atol=1e-6)


@pytest.mark.parametrize(
    ("action", "wheels"),
    [
        ((1.0, 0.0), (1.0, 1.0)),
        ((-0.4, 0.0), (-0.4, -0.4)),
        ((0.0, 1.0), (-1.0, 1.0)),
        ((0.0, -0.3), (0.3, -0.3)),
        ((0.5, 0.25), (0.25, 0.75)),
        ((0.0, 0.0), (0.0, 0.0)),
        # More than a wheel can do: both are scaled down.
        ((1.0, 0.5), (1.0 / 3.0, 1.0)),
        ((-1.0, 1.0), (-1.0, 0.0)),
        # More than there is.
        ((0.0, -9.0), (1.0, -1.0)),
        ((3.0, 0.5), (1.0 / 3.0, 1.0)),
    ],
)
def test_speed_and_turn_by_hand(action, wheels):
    env = VelocityAction(LimSlamEnv("env1"))
    np.testing.assert_allclose(env.action(np.array(action)), wheels, atol=1e-7)


def test_scaling_keeps_the_curve():
    env = VelocityAction(LimSlamEnv("env1"))
    for ahead, turn in np.random.default_rng(0).uniform(-1.0, 1.0, (500, 2)):
        left, right = env.action(np.array([ahead, turn])).astype(float)
        assert max(abs(left), abs(right)) <= 1.0
        # The turn per way driven is that of the unscaled wheels.
        assert (right - left) * ahead == pytest.approx((right + left) * turn, abs=1e-6)
        assert (right - left) * turn >= 0.0
        if abs(ahead) + abs(turn) <= 1.0:
            np.testing.assert_allclose([left, right], [ahead - turn, ahead + turn], atol=1e-6)


@pytest.mark.parametrize("action", [0.5, [0.1, 0.2, 0.3], [0.0, np.nan]])
def test_a_speed_and_turn_that_cannot_be_are_refused(action):
    env = VelocityAction(LimSlamEnv("env1"))
    env.reset(seed=0)
    with pytest.raises(ValueError, match="two finite numbers"):
        env.step(action)


def test_moves_by_number():
    env = DiscreteAction(LimSlamEnv("env1"))
    assert env.action_space == spaces.Discrete(3)
    for number, wheels in enumerate((FORWARD, LEFT, RIGHT)):
        np.testing.assert_allclose(env.action(number), wheels)
        np.testing.assert_allclose(env.action(np.int64(number)), wheels)
    _, info = env.reset(seed=0)
    (x, y, theta), turns = info["pose"], []
    *_, info = env.step(0)
    np.testing.assert_allclose(
        info["pose"], (x + 0.03 * math.cos(theta), y + 0.03 * math.sin(theta), theta), atol=1e-9
    )
    for number in (1, 2, 2):
        before = info["pose"]
        info = env.step(number)[4]
        turns.append(np.sign(info["pose"][2] - before[2]))
        np.testing.assert_allclose(info["pose"][:2], before[:2], atol=1e-9)
    assert turns == [1.0, -1.0, -1.0]


def test_moves_may_be_others():
    env = DiscreteAction(
        LimSlamEnv("env1"), moves=[(0.0, 0.0), (-1.0, -1.0), (0.2, 1.0), (1.0, 0.2)]
    )
    assert env.action_space == spaces.Discrete(4)
    np.testing.assert_allclose(env.action(2), (0.2, 1.0))
    # What becomes of an action is none of the table's business.
    env.action(2)[:] = 0.0
    np.testing.assert_allclose(env.action(2), (0.2, 1.0))


@pytest.mark.parametrize("moves", [(), [(0.0, 0.0, 0.0)], [(0.0, -1.01)], [(math.nan, 0.0)], 0.5])
def test_moves_that_cannot_be_are_refused(moves):
    with pytest.raises(ValueError, match="moves are pairs of wheel speeds"):
        DiscreteAction(LimSlamEnv("env1"), moves)


@pytest.mark.parametrize("action", [3, -1, 0.5, None])
def test_a_move_that_there_is_not_is_refused(action):
    env = DiscreteAction(LimSlamEnv("env1"))
    env.reset(seed=0)
    with pytest.raises(ValueError, match="number of a move, 0 to 2"):
        env.step(action)


def test_flat_observations_hold_ranges_and_then_wheels():
    env = FlattenObservation(LimSlamEnv("env1"))
    plain = LimSlamEnv("env1")
    assert env.observation_space.shape == (8,)
    flat, _ = env.reset(seed=0)
    observation, _ = plain.reset(seed=0)
    for _ in range(5):
        np.testing.assert_array_equal(
            flat, np.concatenate((observation["ranges"], observation["wheels"]))
        )
        assert flat.dtype == np.float32
        flat, *_ = env.step([1.0, 0.5])
        observation, *_ = plain.step([1.0, 0.5])


def test_stacked_observations_hold_the_last_ones_in_order():
    env = FrameStackObservation(LimSlamEnv("env1"), 3)
    plain = LimSlamEnv("env1")
    env.reset(seed=0)
    frames = [plain.reset(seed=0)[0]]
    for _ in range(5):
        stacked, *_ = env.step([1.0, 0.5])
        frames.append(plain.step([1.0, 0.5])[0])
    for key in ("ranges", "wheels"):
        np.testing.assert_array_equal(stacked[key], [frame[key] for frame in frames[-3:]])


def map_of(
    world: str, start: tuple[float, float, float], size: int = 40, turns: int = 0, **arguments
) -> np.ndarray:
    """What lies around a robot that sees all around, after as many steps of turning on the spot."""
    env = PrivilegedLocalMap(LimSlamEnv(world, robot=ring(180), **arguments), size=size)
    observation, _ = env.reset(seed=0, options={"start": start})
    for _ in range(turns):
        observation, *_ = env.step((0.0, 0.0))
    return observation["local_map"][0]


@pytest.mark.parametrize("quarter", range(4))
def test_ahead_is_up_and_left_is_left(quarter):
    # In the corner of the square, walls stand 1 m below (y = 0) and 1 m to the left (x = 0) of the
    # robot in the world.
    picture = map_of("square", (1.0, 1.0, quarter * math.pi / 2.0))
    low_y, low_x = np.zeros((2, 40, 40), dtype=bool)
    # Nine cells and a half from the middle: the walls' cells are the first ones of the room.
    low_y[29] = True
    low_x[29] = True
    of_heading = {
        # Facing right, the lower wall is on the right hand and the left wall behind.
        0: ((slice(None), 29), (29, slice(None))),
        1: ((29, slice(None)), (slice(None), 10)),
        2: ((slice(None), 10), (10, slice(None))),
        3: ((10, slice(None)), (slice(None), 29)),
    }
    lower, left = of_heading[quarter]
    near = picture[10:30, 10:30] == WALL
    expected = np.zeros((40, 40), dtype=bool)
    expected[lower] = expected[left] = True
    # Within a metre of the robot all is seen, and nothing else is a wall.
    np.testing.assert_array_equal(near, expected[10:30, 10:30])
    assert (picture[10:30, 10:30][~near] == FREE).all()


@pytest.mark.parametrize(("heading", "size"), [(0.7, 25), (-2.4, 40)])
def test_every_cell_is_what_was_truly_seen_there(heading, size):
    env = PrivilegedLocalMap(LimSlamEnv("env3"), size=size)
    observation, info = env.reset(seed=0, options={"start": (1.2, 2.2, heading)})
    for action in np.random.default_rng(0).uniform(-0.3, 1.0, (60, 2)):
        observation, *_, info = env.step(action)
    truth, (x, y, theta) = env.unwrapped, info["pose"]
    seen = truth.seen
    low = truth.coverage_grid.low
    edges = truth.world.edges
    picture = observation["local_map"][0]
    for row in range(size):
        for column in range(size):
            ahead = (0.5 * (size - 1) - row) * 0.1
            left = (0.5 * (size - 1) - column) * 0.1
            px = x + ahead * math.cos(theta) - left * math.sin(theta)
            py = y + ahead * math.sin(theta) + left * math.cos(theta)
            i = math.floor((py - low[1]) / 0.1)
            j = math.floor((px - low[0]) / 0.1)
            is_inside = 0 <= i < seen.shape[0] and 0 <= j < seen.shape[1]
            if picture[row, column] == FREE:
                assert is_inside
                assert seen[i, j]
            elif picture[row, column] == WALL:
                # Half a diagonal of the cell at most, and something beside it was seen.
                centre = low + 0.1 * (np.array([j, i]) + 0.5)
                assert segment.distances(centre[None], edges).min() <= 0.1 * math.sqrt(0.5) + 1e-6
                assert seen[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2].any()
            else:
                assert picture[row, column] == UNSEEN
                assert not (is_inside and seen[i, j])
    assert set(np.unique(picture)) == {UNSEEN, FREE, WALL}


def test_the_map_follows_the_world_of_the_episode():
    env = PrivilegedLocalMap(LimSlamEnv("env1", robot=ring(180)))
    start = (1.2, 2.0, 0.0)
    own, _ = env.reset(seed=0, options={"start": start})
    other, _ = env.reset(seed=0, options={"start": start, "world": "square"})
    assert (own["local_map"] != other["local_map"]).any()
    back, _ = env.reset(seed=0, options={"start": start})
    np.testing.assert_array_equal(back["local_map"], own["local_map"])
    np.testing.assert_array_equal(other["local_map"][0], map_of("square", start))


@pytest.mark.parametrize("size", [0, -3])
def test_a_map_without_cells_is_refused(size):
    with pytest.raises(ValueError, match=f"at least one cell, not {size}"):
        PrivilegedLocalMap(LimSlamEnv("env1"), size=size)


def test_there_is_no_truth_to_show_of_other_environments():
    for other in (Stranger(), gym.make("CartPole-v1")):
        with pytest.raises(ValueError, match="no truth to show"):
            PrivilegedLocalMap(other)


def test_observations_without_ranges_and_wheels_are_refused():
    for other in (gym.make("CartPole-v1"), FlattenObservation(LimSlamEnv("env1"))):
        with pytest.raises(ValueError, match="must hold ranges, not"):
            NormalizedObservation(other)
    with pytest.raises(ValueError, match="must hold ranges and wheels"):
        PrivilegedLocalMap(FlattenObservation(LimSlamEnv("env1")))


@pytest.mark.parametrize("mode", AutoresetMode)
def test_a_batch_is_normalized_as_single_environments_are(mode):
    settings = {"num_envs": 2, "max_episode_steps": 3, "autoreset_mode": mode}
    plain = gym.make_vec("LimSlam-Env1-v0", **settings)
    batch = NormalizedVectorObservation(gym.make_vec("LimSlam-Env1-v0", **settings))
    alone = NormalizedObservation(LimSlamEnv("env1"))
    assert batch.single_observation_space == alone.observation_space
    told, expected = batch.reset(seed=0)[0], plain.reset(seed=0)[0]
    for step in range(3):
        for row in range(2):
            single = alone.observation({key: part[row] for key, part in expected.items()})
            for key, part in single.items():
                np.testing.assert_array_equal(told[key][row], part)
        assert batch.observation_space.contains(told)
        told, *_, info = batch.step(np.full((2, 2), 0.5))
        expected, *_, said = plain.step(np.full((2, 2), 0.5))
        assert ("final_obs" in info) == (step == 2 and mode is AutoresetMode.SAME_STEP)
        if "final_obs" in info:
            for one, other in zip(info["final_obs"], said["final_obs"], strict=True):
                np.testing.assert_array_equal(one["wheels"], alone.observation(other)["wheels"])


@pytest.mark.parametrize("reach", [0.0, -1.0, np.nan, "far"])
def test_a_reach_that_cannot_be_is_refused(reach):
    with pytest.raises(ValueError, match="the reach must be a number from"):
        NormalizedObservation(LimSlamEnv("env1"), reach=reach)
