"""Pictures of a batch: those of the single environment, of the world that each environment is in, all of one size."""

import cv2
import gymnasium as gym
import numpy as np
import pytest
from support.episodes import held_actions

from limslam_env.config import NoiseConfig
from limslam_env.envs.env import LimSlamEnv
from limslam_env.envs.vector_env import LimSlamVectorEnv
from limslam_env.rendering.painter import Painter
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig

QUIET = NoiseConfig(wheel_variance=0.0)
WORLDS = ["env1", "env2", "env3"]
SMALL = FloorPlanConfig(width=4.0, height=(4.0, 6.0))


def drawing(world=WORLDS, count: int = 3, **arguments) -> LimSlamVectorEnv:
    return LimSlamVectorEnv(world, count, noise=QUIET, render_mode="rgb_array", **arguments)


def single(world: str) -> LimSlamEnv:
    env = LimSlamEnv(world, noise=QUIET, render_mode="rgb_array")
    env._painter = Painter("rgb_array", square=True)
    return env


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
        assert (picture != env.render()).any(axis=2).mean() < 1e-3


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


def test_gymnasium_films_a_batch(tmp_path):
    pytest.importorskip("moviepy", reason="needs the extra video")
    envs = gym.make_vec("LimSlam-World-v0", 2, world=SMALL, render_mode="rgb_array", max_episode_steps=3)
    envs = gym.wrappers.vector.RecordVideo(envs, str(tmp_path / "film"), step_trigger=lambda n: n == 0, video_length=6)
    envs.reset(seed=0)
    for _ in range(8):
        envs.step(np.full((2, 2), 0.5))
    envs.close()
    (film,) = (tmp_path / "film").iterdir()
    video = cv2.VideoCapture(str(film))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) >= 6
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(10.0)
    assert video.get(cv2.CAP_PROP_FRAME_WIDTH) == 2 * video.get(cv2.CAP_PROP_FRAME_HEIGHT)
    video.release()
