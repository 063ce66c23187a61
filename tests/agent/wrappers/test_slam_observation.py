"""SlamObservation: what a robot believes, told to learning agents, and nothing that is true besides
the start.
"""

import math
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import limslam_env  # noqa: F401 (registers the ids)
from limslam_agent import AgentConfig, SlamObservation, preset
from limslam_env import LimSlamEnv, NominalNoise
from limslam_env.envs.wrappers import NormalizedObservation
from limslam_env.geometry import se2

UNKNOWN = 0
FREE = 127
OCCUPIED = 255
ACTIONS = [*[(0.6, 0.6)] * 25, *[(-0.4, 0.4)] * 10, *[(0.5, 0.6)] * 25]


def driven(
    env: gym.Env[Any, Any], seed: int = 100
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Observations and infos of a short drive."""
    observation, info = env.reset(seed=seed)
    observations = [observation]
    infos = [info]
    for action in ACTIONS:
        observation, _, _, _, info = env.step(np.array(action))
        observations.append(observation)
        infos.append(info)
    return observations, infos


def test_it_satisfies_the_checker() -> None:
    with warnings.catch_warnings():
        # The checker wants bare environments; what it checks is what matters here.
        warnings.filterwarnings("ignore", message=".*unwrapped.*")
        check_env(SlamObservation(LimSlamEnv("env1")), skip_render_check=True)


def test_every_observation_lies_in_the_space_whose_bounds_are_finite() -> None:
    env = SlamObservation(gym.make("LimSlam-Env2-v0", sensor_noise=0.04))
    for box in env.observation_space.spaces.values():
        assert np.isfinite(box.low).all()
        assert np.isfinite(box.high).all()
    observations, _ = driven(env)
    assert all(env.observation_space.contains(observation) for observation in observations)
    assert set(observations[0]) == {"pose", "covariance", "grid", "ranges"}


def test_the_pose_is_told_as_seen_from_the_start() -> None:
    env = SlamObservation(LimSlamEnv("env1"), preset("paper"))
    observations, infos = driven(env)
    np.testing.assert_array_equal(observations[0]["pose"], np.zeros(3))
    true = np.array([se2.between(infos[0]["pose"], info["pose"]) for info in infos])
    told = np.array([observation["pose"] for observation in observations])
    assert np.hypot(*true[-1, :2]) > 0.5
    # Believed, so near the truth, and not the truth.
    assert np.abs(told - true)[:, :2].max() < 0.1
    assert np.abs(told - true).max() > 1e-4


def test_the_covariance_grows_from_nothing_and_is_one() -> None:
    observations, _ = driven(SlamObservation(LimSlamEnv("env1")))
    np.testing.assert_allclose(observations[0]["covariance"], np.zeros(6), atol=1e-9)
    matrix = np.zeros((3, 3))
    matrix[np.triu_indices(3)] = observations[20]["covariance"]
    matrix += np.triu(matrix, 1).T
    assert np.linalg.eigvalsh(matrix).min() > 0.0


class FalseInfo(gym.Wrapper[Any, Any, Any, Any]):
    """Lies about everything that is true, once the episode has begun."""

    def step(self, action: Any) -> Any:
        observation, reward, terminated, truncated, info = self.env.step(action)
        info["pose"][:] = 1e3
        return (
            observation,
            reward,
            terminated,
            truncated,
            {**info, "coverage": -1.0, "wall_seen": None},
        )


def test_nothing_true_goes_in_after_the_start() -> None:
    honest, _ = driven(SlamObservation(LimSlamEnv("env1", sensor_noise=0.02)))
    lied_to, _ = driven(SlamObservation(FalseInfo(LimSlamEnv("env1", sensor_noise=0.02))))
    for one, other in zip(honest, lied_to, strict=True):
        for key, value in one.items():
            np.testing.assert_array_equal(value, other[key])


def test_a_reset_forgets_everything() -> None:
    env = SlamObservation(LimSlamEnv("env1", sensor_noise=0.02))
    first, _ = driven(env)
    driven(env, seed=101)
    again, _ = driven(env)
    for one, other in zip(first, again, strict=True):
        for key, value in one.items():
            np.testing.assert_array_equal(value, other[key])


def grid_from(start: tuple[float, float, float], turns: int = 0, size: int = 41) -> np.ndarray:
    """The grid after turning on the spot at a start in Env1."""
    env = SlamObservation(LimSlamEnv("env1"), size=size)
    observation, _ = env.reset(seed=100, options={"start": start})
    for _ in range(turns):
        observation = env.step(np.array([-0.4, 0.4]))[0]
    return observation["grid"][0]


def test_the_robot_is_in_the_middle_and_looks_up() -> None:
    # One metre from the wall on the right, in the middle of a cell.
    grid = grid_from((3.45, 1.05, 0.0))
    assert grid.shape == (41, 41)
    assert grid[20, 20] == FREE
    assert set(np.unique(grid)) == {UNKNOWN, FREE, OCCUPIED}
    # The beam at -90 degrees runs to the right, and ends in the wall.
    assert (grid[20, 21:28] == FREE).all()
    assert OCCUPIED in grid[20, 29:32]
    assert (grid[20, 32:] == UNKNOWN).all()
    # The beams at 15 degrees lead up and a little to both sides; behind the robot nothing is known.
    assert (grid[8, 22:26] == FREE).any()
    assert (grid[8, 15:19] == FREE).any()
    assert (grid[23:] == UNKNOWN).all()


@pytest.mark.parametrize("heading_deg", [90.0, 180.0])
def test_the_picture_turns_with_the_robot(heading_deg: float) -> None:
    # Env1 looks the same after a quarter turn about (3.5, 3.5); cells at their edges may fall to
    # either side.
    start = np.array([3.43, 1.03]) - 3.5
    turn = math.radians(heading_deg)
    x, y = 3.5 + start @ np.array(
        [[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]
    )
    upright = grid_from((3.43, 1.03, 0.0), 40)
    turned = grid_from((x, y, turn), 40)
    assert (upright == turned).mean() > 0.9
    assert (np.rot90(upright) == turned).mean() < 0.9


def test_what_cannot_be_wrapped_is_refused() -> None:
    with pytest.raises(ValueError, match="a grid needs at least one cell, not 0"):
        SlamObservation(LimSlamEnv("env1"), size=0)
    with pytest.raises(ValueError, match="ranges must be those of the robot"):
        SlamObservation(NormalizedObservation(LimSlamEnv("env1")))
    with pytest.raises(ValueError, match="has no LimSLAM robot"):
        SlamObservation(gym.make("CartPole-v1"))
    with pytest.raises(ValueError, match="must hold ranges and wheels"):
        SlamObservation(gym.wrappers.FlattenObservation(LimSlamEnv("env1")))


def test_the_filter_is_told_the_nominal_noise_of_the_environment() -> None:
    def make() -> gym.Env[Any, Any]:
        return gym.make("LimSlam-Env1-v0", sensor_noise=0.02)

    def poses(config: AgentConfig | None) -> Any:
        return [seen["pose"] for seen in driven(SlamObservation(make(), config))[0]]

    default = poses(None)
    np.testing.assert_array_equal(default, poses(preset("graph", NominalNoise(0.02))))
    assert not np.array_equal(default, poses(preset("graph")))


def test_pictures_show_the_belief_over_the_truth() -> None:
    def picture(wrap: Any) -> Any:
        env = wrap(gym.make("LimSlam-Env1-v0", render_mode="rgb_array"))
        driven(env)
        return env, env.render()

    _, plain = picture(lambda env: env)
    env, shown = picture(SlamObservation)
    assert not np.array_equal(plain, shown)
    (overlay,) = env.unwrapped.overlay
    np.testing.assert_array_equal(overlay.pose, env.belief.pose)
    np.testing.assert_array_equal(overlay.segments, env.belief.segments)
    assert len(overlay.segments)


def test_a_normalized_belief_by_hand() -> None:
    def make() -> gym.Env[Any, Any]:
        return SlamObservation(gym.make("LimSlam-Env1-v0", sensor_noise=0.02))

    plain = driven(make())[0]
    env = NormalizedObservation(make(), reach=0.25)
    scaled = driven(env)[0]
    for believed, seen in zip(plain, scaled, strict=True):
        assert env.observation_space.contains(seen)
        x, y, theta = believed["pose"]
        place = np.clip([4.0 * x, 4.0 * y], -1.0, 1.0)
        expected = [*place, math.cos(theta), math.sin(theta)]
        np.testing.assert_allclose(seen["pose"], expected, atol=1e-6)
        variances = believed["covariance"][[0, 3, 5]]
        np.testing.assert_allclose(seen["std"] ** 2, variances, rtol=1e-5, atol=1e-12)
        np.testing.assert_allclose(seen["ranges"], (believed["ranges"] - 0.05) / 1.45, atol=1e-6)
        np.testing.assert_array_equal(seen["grid"], believed["grid"])
    assert scaled[-1]["pose"][0] == 1.0, "it has driven beyond the reach"
