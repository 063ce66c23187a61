"""PPO of Stable-Baselines3 on a batch of environments: ``python examples/rl_batch.py --steps
3000000`` (extra ``rl``); ``--recurrent`` learns with a recurrent network instead of four stacked
observations.

All robots move in one call of compiled code, hundreds of thousands of steps a second. The network
then takes most of the time. At the end the model is scored on floor plans that it has not seen,
beside the frontier explorer.
"""

import argparse
from typing import Any

import gymnasium as gym
from gymnasium.wrappers import FrameStackObservation, TransformObservation
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecFrameStack, VecMonitor

import limslam_env  # noqa: F401 (registers the environments)
from limslam_agent import evaluate, medians
from limslam_env.envs.sb3 import Sb3VecEnv

EPISODE = 600  # steps
FRAMES = 4  # the last four observations show how the robot moves


def stacked(env: gym.Env, space: gym.Space[Any]) -> gym.Env:
    """A single environment with the observations of `VecFrameStack`, in ``space``."""
    frames = FrameStackObservation(env, FRAMES, padding_type="zero")
    return TransformObservation(
        frames, lambda seen: {key: part.ravel() for key, part in seen.items()}, space
    )


def main() -> None:
    """Train on 256 floor plans."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--steps", type=int, default=1_000_000)
    arguments.add_argument("--envs", type=int, default=64)
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--recurrent", action="store_true")
    arguments.add_argument("--plans", type=int, default=5, help="floor plans to score the model on")
    arguments.add_argument("--out", help="file of the model, and of its curve beside it")
    options = arguments.parse_args()
    batch = gym.make_vec(
        "LimSlam-Random-v0",
        num_envs=options.envs,
        plans=256,
        sensor_noise=0.02,
        max_episode_steps=EPISODE,
    )
    # The curve is a table with a row for each episode: reward, steps, seconds, coverage.
    env = VecMonitor(Sb3VecEnv(batch), options.out, info_keywords=("coverage",))
    settings = {"n_epochs": 4, "seed": options.seed, "device": "cpu", "verbose": 1}
    if options.recurrent:
        model = RecurrentPPO(
            "MultiInputLstmPolicy",
            env,
            n_steps=64,
            batch_size=512,
            policy_kwargs={"lstm_hidden_size": 64},
            **settings,
        )
        wrap = None
    else:
        stack = VecFrameStack(env, n_stack=FRAMES)
        model = PPO("MultiInputPolicy", stack, n_steps=32, batch_size=256, **settings)

        def wrap(env: gym.Env) -> gym.Env:
            return stacked(env, model.observation_space)

    # Prints some twenty tables of its progress.
    rollout = model.n_steps * options.envs
    model.learn(options.steps, log_interval=max(options.steps // (20 * rollout), 1))
    returns = [episode["r"] for episode in model.ep_info_buffer or []]
    reward = (
        f"reward {sum(returns) / len(returns):.1f} an episode"
        if returns
        else "no episode has ended yet"
    )
    needed = "" if returns else f" (needs about {EPISODE * options.envs} steps)"
    print(f"{model.num_timesteps} steps: {reward}{needed}")
    if options.out:
        model.save(options.out)
    plans = range(1000, 1000 + options.plans)  # the plans of training are those of 0 to 255
    for name, actor, seen in (("PPO", model, wrap), ("frontier", "frontier", None)):
        results = evaluate(
            actor, "LimSlam-Random-v0", plans, max_time=60.0, wrap=seen, sensor_noise=0.02
        )
        print(f"{name:8} sees {medians(results)['coverage_true']:.0%} of a floor plan in a minute")


if __name__ == "__main__":
    main()
