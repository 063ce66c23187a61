"""One PPO policy for two robots that share a building, by SuperSuit: ``python
examples/rl_two_robots.py``.

Stable-Baselines3 sees each robot as an environment of its own, and both train the same network
(extra ``rl``).
"""

import argparse

import numpy as np
import supersuit
from gymnasium import spaces
from pettingzoo import ParallelEnv
from stable_baselines3 import PPO

import limslam_env
from limslam_agent import evaluate


def in_a_row(team: ParallelEnv) -> ParallelEnv:
    """The same robots with flat observations, which SuperSuit needs."""
    return supersuit.observation_lambda_v0(
        team,
        lambda observation, space: np.asarray(spaces.flatten(space, observation)),
        spaces.flatten_space,
    )


def main() -> None:
    """Train, and score both robots by the metrics of `limslam run`."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--steps", type=int, default=100_000)
    options = arguments.parse_args()
    team = limslam_env.parallel_env(world="env2", num_robots=2, sensor_noise=0.02, max_cycles=600)
    robots = supersuit.pettingzoo_env_to_vec_env_v1(in_a_row(team))
    # Four buildings side by side: eight robots.
    env = supersuit.concat_vec_envs_v1(robots, 4, base_class="stable_baselines3")
    # SuperSuit's batch takes no seed, so two trainings differ.
    model = PPO("MlpPolicy", env, n_steps=32, batch_size=64, device="cpu")
    model.learn(options.steps)

    (score,) = evaluate(
        model,
        "limslam/Env2-v0",
        seeds=[1],
        wrap=in_a_row,
        max_time=10.0,
        num_robots=2,
        sensor_noise=0.02,
    )
    print(f"{model.num_timesteps} steps: {score['coverage_true']:.1%} seen by both in ten seconds")


if __name__ == "__main__":
    main()
