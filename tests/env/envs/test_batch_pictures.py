"""Pictures of a batch: those of the single environment, of the world that each environment is in, all of one size."""

import numpy as np
import pytest
from support.episodes import held_actions

from limslam_env import FloorPlanConfig, LimSlamEnv, LimSlamVectorEnv, NoiseConfig
from limslam_env.rendering import rendering

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
            rendering, "render", lambda state: plain(state, background=rendering.square_background(state.world))
        )
        return env.render()


def test_they_are_those_of_the_single_environment_and_all_of_one_size():
    batch, singles = drawing(), [single(world) for world in WORLDS]
    batch.reset(seed=0)
    for env in singles:
        env.reset(seed=0)
    for actions in held_actions(40, 3):
        observations, _, _, _, infos = batch.step(actions)
        for action, env in zip(actions, singles, strict=True):
            env.step(action)
    # What the caller does with the arrays does not change the pictures.
    observations["ranges"][:], infos["pose"][:] = 0.3, 1.0
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
    batch, looked_at = drawing(world, **arguments), 0
    for seed in (1, None):
        observations, infos = batch.reset(seed=seed, options=options)
        for number in range(3):
            edges = batch._simulation.world(number).edges
            x, y, theta = infos["pose"][number]
            # A wall that is nearer than the shortest range is not where the reading ends.
            seen = np.flatnonzero((infos["wall_seen"][number] >= 0) & (observations["ranges"][number] > 0.051))
            looked_at += len(seen)
            angles = theta + np.array([beam.angle for beam in batch.robot.beams])[seen]
            reach = batch.robot.radius + observations["ranges"][number, seen]
            ends = np.column_stack((x + reach * np.cos(angles), y + reach * np.sin(angles)))
            for (x1, y1, x2, y2), (u, v) in zip(edges[infos["wall_seen"][number, seen]], ends, strict=True):
                off = abs((x2 - x1) * (v - y1) - (y2 - y1) * (u - x1)) / np.hypot(x2 - x1, y2 - y1)
                assert off < 1e-5
    assert looked_at > 6


@pytest.mark.parametrize("arguments", [{}, {"plans": 9}], ids=["a new plan at each reset", "plans"])
def test_a_reset_with_a_seed_of_some_leaves_the_others_in_their_worlds(arguments):
    batch = drawing(SMALL, autoreset_mode="Disabled", **arguments)
    batch.reset(seed=0)
    worlds, pictures = [batch._simulation.world(number) for number in range(3)], batch.render()
    batch.reset(seed=5, options={"reset_mask": np.array([True, False, False])})
    assert [batch._simulation.world(number) == worlds[number] for number in range(3)] == [False, True, True]
    after = batch.render()
    assert [np.array_equal(after[number], pictures[number]) for number in range(3)] == [False, True, True]


def test_a_new_episode_begins_a_new_trail():
    batch, fresh = drawing(["env1"] * 2, 2, max_episode_steps=5), drawing(["env1"] * 2, 2)
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
