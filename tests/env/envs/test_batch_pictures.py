"""Pictures of a batch: those of the single environment, of the world that each environment is in, all of one size."""

import cv2
import gymnasium as gym
import numpy as np
import pytest
from support.episodes import held_actions

from limslam_env.config import NoiseConfig
from limslam_env.envs.env import LimSlamEnv
from limslam_env.envs.vector_env import LimSlamVectorEnv
from limslam_env.rendering import rendering
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig

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


def test_what_does_not_change_in_an_episode_is_drawn_once(monkeypatch):
    drawn, draw_floor = [], rendering._draw_floor
    monkeypatch.setattr(rendering, "_draw_floor", lambda *given: (drawn.append(given[1]), draw_floor(*given)))
    batch = drawing(SMALL, 10, autoreset_mode="Disabled")
    batch.reset(seed=0)
    for _ in range(3):
        batch.render()
        batch.step(np.full((10, 2), 0.5))
    # Seen and unseen are two layers.
    assert len(drawn) == 2 * len(set(drawn)) == 20
    batch.reset(options={"reset_mask": np.arange(10) == 4})
    batch.render()
    assert len(drawn) == 22


def test_a_reset_of_some_adds_no_point_to_the_trails_of_the_others(monkeypatch):
    trails, render = [], rendering.render
    monkeypatch.setattr(
        rendering, "render", lambda state, **given: (trails.append(state.paths[0]), render(state, **given))[1]
    )
    batch = drawing(["env1"] * 2, 2, autoreset_mode="Disabled")
    batch.reset(seed=0)
    poses = [batch.step(np.full((2, 2), 0.5))[-1]["pose"][1, :2] for _ in range(3)]
    start = batch.reset(options={"reset_mask": np.array([True, False])})[1]["pose"][0, :2]
    poses.append(batch.step(np.full((2, 2), 0.5))[-1]["pose"][1, :2])
    batch.render()
    np.testing.assert_array_equal(trails[0][0], start)
    assert len(trails[0]) == 2
    np.testing.assert_array_equal(trails[1][1:], poses)
    # Points that no episode has are forgotten.
    batch.reset()
    assert len(batch._pictures._trail) == 1


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
