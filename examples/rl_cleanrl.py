"""PPO in one file, in the style of CleanRL: ``python examples/rl_cleanrl.py`` (needs torch, as the
extra ``rl`` does).

Environments, network, rollout, advantages and update follow each other in this file. At the end
the network is scored on floor plans that it has not seen, beside the frontier explorer.
"""

import argparse

import gymnasium as gym
import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Normal

import limslam_env  # noqa: F401 (registers the environments)
from limslam_agent import evaluate, medians
from limslam_env.envs.wrappers import (
    FlattenObservation,
    NormalizedObservation,
    NormalizedVectorObservation,
)

NUM_ENVS = 64
ROLLOUT = 32
EPOCHS = 4
MINIBATCHES = 8
GAMMA = 0.99
LAMBDA = 0.95
CLIP = 0.2
ENTROPY = 0.001
VALUE = 0.5


def flat(seen: dict[str, np.ndarray]) -> Tensor:
    """The observations of the batch (n, 8): ranges and wheel travel."""
    return torch.as_tensor(np.hstack((seen["ranges"], seen["wheels"])))


class Agent(nn.Module):
    """A policy with a Gaussian over both wheels, and a value."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.critic = nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 1))
        self.actor = nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 2))
        self.log_std = nn.Parameter(torch.full((2,), -0.5))

    def forward(self, observation: Tensor) -> tuple[Normal, Tensor]:
        """The distribution of the action (n, 2), and the value (n,)."""
        return Normal(self.actor(observation), self.log_std.exp()), self.critic(
            observation
        ).squeeze(-1)


def advantages(rewards: Tensor, values: Tensor, dones: Tensor) -> Tensor:
    """Generalised advantage estimates (t, n); ``values`` has one more row, for the last
    observation.

    A truncated episode counts as ended here, as in CleanRL.
    """
    found = torch.zeros_like(rewards)
    after = torch.zeros(rewards.shape[1])
    for step in reversed(range(len(rewards))):
        goes_on = 1.0 - dones[step]
        error = rewards[step] + GAMMA * goes_on * values[step + 1] - values[step]
        found[step] = after = error + GAMMA * LAMBDA * goes_on * after
    return found


def main() -> None:
    """Collect rollouts and learn from them in turns."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--steps", type=int, default=1_000_000)
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--plans", type=int, default=5, help="floor plans to score it on")
    arguments.add_argument("--out", help="file of the network's weights")
    options = arguments.parse_args()
    torch.manual_seed(options.seed)
    envs = gym.make_vec(
        "LimSlam-Random-v0",
        num_envs=NUM_ENVS,
        plans=256,
        sensor_noise=0.02,
        max_episode_steps=600,
        autoreset_mode="SameStep",
    )
    envs = NormalizedVectorObservation(envs)
    observation = flat(envs.reset(seed=options.seed)[0])
    agent = Agent(observation.shape[1])
    optimizer = torch.optim.Adam(agent.parameters(), lr=3e-4)
    coverage = np.nan
    for update in range(1, max(options.steps // (NUM_ENVS * ROLLOUT), 1) + 1):
        rows: list[list[Tensor]] = []
        for _ in range(ROLLOUT):
            with torch.no_grad():
                policy, value = agent(observation)
                action = policy.sample()
            told, reward, terminated, truncated, info = envs.step(action.clamp(-1.0, 1.0).numpy())
            if "final_info" in info:
                coverage = info["final_info"]["coverage"][info["_final_info"]].mean()
            done = torch.as_tensor(np.logical_or(terminated, truncated), dtype=torch.float32)
            rows.append(
                [
                    observation,
                    action,
                    policy.log_prob(action).sum(-1),
                    value,
                    torch.as_tensor(reward).float(),
                    done,
                ]
            )
            observation = flat(told)
        observations, actions, old, values, rewards, dones = (
            torch.stack(part) for part in zip(*rows, strict=True)
        )
        with torch.no_grad():
            gain = advantages(rewards, torch.cat((values, agent(observation)[1][None])), dones)
        batch = [part.flatten(0, 1) for part in (observations, actions, old, gain, gain + values)]
        for _ in range(EPOCHS):
            for rows_of in torch.randperm(NUM_ENVS * ROLLOUT).chunk(MINIBATCHES):
                seen, chosen, before, better, worth = (part[rows_of] for part in batch)
                policy, value = agent(seen)
                ratio = (policy.log_prob(chosen).sum(-1) - before).exp()
                better = (better - better.mean()) / (better.std() + 1e-8)
                surrogate = torch.min(
                    ratio * better, ratio.clamp(1.0 - CLIP, 1.0 + CLIP) * better
                ).mean()
                loss = (
                    VALUE * (value - worth).square().mean()
                    - surrogate
                    - ENTROPY * policy.entropy().sum(-1).mean()
                )
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()
        if update % 20 == 1:
            # The first episodes end after 600 steps.
            seen_part = "" if np.isnan(coverage) else f", {coverage:.0%} of a plan seen in a minute"
            print(
                f"{update * NUM_ENVS * ROLLOUT} steps: reward {float(rewards.mean()):.4f} a step"
                f"{seen_part}"
            )
    if options.out:
        torch.save(agent.state_dict(), options.out)

    def act(seen: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            action: Tensor = agent.actor(torch.as_tensor(seen))
        return np.asarray(action.clamp(-1.0, 1.0))

    plans = range(1000, 1000 + options.plans)  # the plans of training are those of 0 to 255
    for name, actor, wrap in (
        ("PPO", act, lambda env: FlattenObservation(NormalizedObservation(env))),
        ("frontier", "frontier", None),
    ):
        results = evaluate(
            actor, "LimSlam-Random-v0", plans, max_time=60.0, wrap=wrap, sensor_noise=0.02
        )
        print(f"{name:8} sees {medians(results)['coverage_true']:.0%} of a floor plan in a minute")


if __name__ == "__main__":
    main()
