"""RecurrentPPO of sb3-contrib, with a recurrent network instead of a map: ``python
examples/rl_recurrent.py``.

A robot that sees 1.5 m far must remember where it has been. Here a recurrent network (LSTM) has to
learn that. Needs the extra ``rl``.
"""

import argparse

import gymnasium as gym
from sb3_contrib import RecurrentPPO

import limslam_env  # noqa: F401 (registers the environments)
from limslam_env.envs.wrappers import FlattenObservation, NormalizedObservation


def main() -> None:
    """Train, and drive for ten seconds by the trained network."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--steps", type=int, default=100_000)
    options = arguments.parse_args()
    env = gym.make("LimSlam-Random-v0", sensor_noise=0.02, max_episode_steps=600)
    env = FlattenObservation(NormalizedObservation(env))
    model = RecurrentPPO("MlpLstmPolicy", env, n_steps=128, batch_size=64, seed=0, device="cpu")
    model.learn(options.steps)

    observation, info = env.reset(seed=1)
    state = None
    is_first = True
    for _ in range(100):
        # The state is the network's memory; the start of an episode resets it.
        action, state = model.predict(observation, state, is_first, deterministic=True)
        observation, _, _, _, info = env.step(action)
        is_first = False
    print(f"{model.num_timesteps} steps: {info['coverage']:.1%} seen in ten seconds")


if __name__ == "__main__":
    main()
