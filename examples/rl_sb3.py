"""Stable-Baselines3's PPO on one environment: ``python examples/rl_sb3.py --steps 100000`` (extra
``rl``).

Ranges are scaled to 0..1, and there are three moves (ahead, left, right). This is enough to learn
to keep moving. At the end the model is scored beside the frontier explorer, on the same floor plans
from the same starts.
"""

import argparse

import gymnasium as gym
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

import limslam_env  # noqa: F401 (registers the environments)
from limslam_agent import evaluate, medians
from limslam_env.envs.wrappers import (
    DiscreteAction,
    FlattenObservation,
    FrameStackObservation,
    NormalizedObservation,
)


def wrapped(env: gym.Env) -> gym.Env:
    """The environment as the model sees it: scaled and stacked observations, three moves."""
    return FrameStackObservation(FlattenObservation(DiscreteAction(NormalizedObservation(env))), 4)


def make_env() -> Monitor:
    """Episodes of one minute on random floor plans."""
    return Monitor(wrapped(gym.make("LimSlam-Random-v0", sensor_noise=0.02, max_episode_steps=600)))


def main() -> None:
    """Train, print the mean reward, and save."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--steps", type=int, default=100_000)
    arguments.add_argument("--out", default="")
    arguments.add_argument("--plans", type=int, default=5, help="floor plans to score the model on")
    options = arguments.parse_args()
    model = PPO(
        "MlpPolicy",
        make_env(),
        n_steps=min(options.steps, 2048),
        batch_size=64,
        seed=0,
        device="cpu",
        verbose=1,
    )
    model.learn(options.steps)  # prints a table of its progress every 2048 steps
    mean, std = evaluate_policy(model, make_env(), n_eval_episodes=2)
    # The reward is the area seen, m^2, minus penalties for time and collisions.
    print(f"{model.num_timesteps} steps: reward {mean:.1f} +- {std:.1f}")
    plans = range(1000, 1000 + options.plans)  # the training begins with the plan of seed 0
    for name, actor, wrap in (("PPO", model, wrapped), ("frontier", "frontier", None)):
        results = evaluate(
            actor, "LimSlam-Random-v0", plans, max_time=60.0, wrap=wrap, sensor_noise=0.02
        )
        print(f"{name:8} sees {medians(results)['coverage_true']:.0%} of a floor plan in a minute")
    if options.out:
        model.save(options.out)


if __name__ == "__main__":
    main()
