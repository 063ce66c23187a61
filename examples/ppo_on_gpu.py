"""PPO with everything on one GPU: ``python examples/ppo_on_gpu.py --steps 200000000`` (extra
``gpu``, and torch).

The environments, the network and all that is learned from stay on the device. The policy has no
map: it sees the last readings, and how much of a floor plan it sees in a minute is printed. After
Schulman et al., "Proximal policy optimization algorithms" (2017), with the settings of CleanRL's
``ppo_continuous_action``.
"""

import argparse
import time
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import torch
from torch import Tensor, nn
from torch.distributions import Normal

import limslam_env  # noqa: F401 (registers the environments)

EPISODE = 600  # steps, a minute
FRAMES = 4  # the last four observations show how the robot moves
DISCOUNT, TRACE, CLIP, ENTROPY, VALUE, LONGEST_STEP = 0.99, 0.95, 0.2, 0.001, 0.5, 0.5
ROLLOUT, EPOCHS, MINIBATCHES, LEARNING_RATE = 32, 2, 8, 1e-3


def layers(inputs: int, outputs: int, scale: float) -> nn.Sequential:
    """A network of two hidden layers; ``scale`` is the size of the last one's weights."""
    last = nn.Linear(128, outputs)
    nn.init.orthogonal_(last.weight, scale)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.Linear(inputs, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh(), last)


class Policy(nn.Module):
    """Wheel speeds with normal noise, and the value of an observation."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.mean, self.value = layers(inputs, 2, 0.01), layers(inputs, 1, 1.0)
        self.log_std = nn.Parameter(torch.full((2,), -0.5))

    def actions(self, seen: Tensor) -> Normal:
        """The distribution of actions."""
        return Normal(self.mean(seen), self.log_std.exp())


class Frames:
    """The last observations of all environments, side by side; empty ones before an episode."""

    def __init__(self, num_envs: int, width: int, scale: Tensor) -> None:
        self.seen = torch.zeros(num_envs, FRAMES, width, device="cuda")
        self._scale = scale

    def add(self, observation: dict[str, Any], is_first: Tensor) -> Tensor:
        """Take a new observation, the first of an episode where ``is_first`` (n,); returns (n,
        FRAMES * width).
        """
        # No copies are made of the simulator's arrays here, and the next step writes into them.
        parts = [torch.as_tensor(observation[name], device="cuda") for name in ("ranges", "wheels")]
        older = self.seen[:, 1:] * ~is_first[:, None, None]
        self.seen = torch.cat((older, (torch.cat(parts, 1) / self._scale)[:, None]), 1)
        return self.seen.flatten(1)


@dataclass
class Rollout:
    """What happened in some steps (steps, n): all that is learned from."""

    seen: Tensor
    actions: Tensor
    log_probs: Tensor
    values: Tensor
    rewards: Tensor
    ends: Tensor
    is_driven: Tensor

    @classmethod
    def empty(cls, num_envs: int, width: int) -> "Rollout":
        """Memory for it."""

        def made(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.zeros(ROLLOUT, num_envs, *shape, dtype=dtype, device="cuda")

        return cls(
            made(width),
            made(2),
            made(),
            made(),
            made(),
            made(dtype=torch.bool),
            made(dtype=torch.bool),
        )

    def advantages(self, last_value: Tensor) -> Tensor:
        """Generalised advantages (steps, n); ``last_value`` (n,) is that of the observation after
        the last step.
        """
        found, trace, following = (
            torch.zeros_like(self.rewards),
            torch.zeros_like(last_value),
            last_value,
        )
        for step in reversed(range(ROLLOUT)):
            goes_on = (~self.ends[step]).float()
            error = self.rewards[step] + DISCOUNT * following * goes_on - self.values[step]
            trace = error + DISCOUNT * TRACE * goes_on * trace
            found[step], following = trace, self.values[step]
        return found


def learn(
    policy: Policy, optimizer: torch.optim.Optimizer, rollout: Rollout, last_value: Tensor
) -> None:
    """Some epochs of PPO on a rollout."""
    advantages = rollout.advantages(last_value)
    targets = (advantages + rollout.values).flatten()
    # The step after an end begins the next episode and ignores the action: nothing is to be learned
    # from it.
    rows = rollout.is_driven.flatten().nonzero().flatten()
    seen, actions = rollout.seen.flatten(0, 1), rollout.actions.flatten(0, 1)
    log_probs, gains = rollout.log_probs.flatten(), advantages.flatten()
    for _ in range(EPOCHS):
        for part in rows[torch.randperm(len(rows), device="cuda")].chunk(MINIBATCHES):
            distribution = policy.actions(seen[part])
            ratio = (distribution.log_prob(actions[part]).sum(1) - log_probs[part]).exp()
            gain = gains[part]
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            surrogate = torch.min(ratio * gain, ratio.clamp(1.0 - CLIP, 1.0 + CLIP) * gain).mean()
            error = (policy.value(seen[part])[:, 0] - targets[part]).square().mean()
            loss = VALUE * error - surrogate - ENTROPY * distribution.entropy().sum(1).mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(policy.parameters(), LONGEST_STEP)
            optimizer.step()


def main() -> None:
    """Train on random floor plans."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--steps", type=int, default=200_000_000)
    arguments.add_argument("--envs", type=int, default=8192)
    arguments.add_argument("--plans", type=int, default=256)
    arguments.add_argument("--seed", type=int, default=0)
    options = arguments.parse_args()
    torch.manual_seed(options.seed)
    count = options.envs
    envs: Any = gym.make_vec(
        "LimSlam-Random-v0",
        num_envs=count,
        plans=options.plans,
        sensor_noise=0.02,
        max_episode_steps=EPISODE,
        device="cuda",
    )
    high = [
        torch.as_tensor(envs.single_observation_space[name].high) for name in ("ranges", "wheels")
    ]
    scale = torch.cat(high).cuda()
    frames, width = Frames(count, len(scale), scale), FRAMES * len(scale)
    policy = Policy(width).cuda()
    optimizer = torch.optim.Adam(policy.parameters(), LEARNING_RATE, eps=1e-5)
    rollout = Rollout.empty(count, width)
    observation, _ = envs.reset(seed=options.seed)
    over = torch.ones(count, dtype=torch.bool, device="cuda")
    seen = frames.add(observation, over)
    over = ~over
    coverages = ends = torch.zeros((), device="cuda")
    updates, begin, simulated = max(options.steps // (count * ROLLOUT), 1), time.perf_counter(), 0.0
    for update in range(1, updates + 1):
        torch.cuda.synchronize()
        start = time.perf_counter()
        with torch.no_grad():
            for step in range(ROLLOUT):
                distribution = policy.actions(seen)
                actions = distribution.sample()
                rollout.seen[step], rollout.actions[step] = seen, actions
                rollout.log_probs[step] = distribution.log_prob(actions).sum(1)
                rollout.values[step], rollout.is_driven[step] = policy.value(seen)[:, 0], ~over
                observation, rewards, terminated, truncated, info = envs.step(actions)
                is_first = over
                over = torch.as_tensor(terminated, device="cuda") | torch.as_tensor(
                    truncated, device="cuda"
                )
                rollout.rewards[step], rollout.ends[step] = (
                    torch.as_tensor(rewards, device="cuda"),
                    over,
                )
                coverages = (
                    coverages + (torch.as_tensor(info["coverage"], device="cuda") * over).sum()
                )
                ends = ends + over.sum()
                seen = frames.add(observation, is_first)
            last_value = policy.value(seen)[:, 0]
        torch.cuda.synchronize()
        simulated += time.perf_counter() - start
        learn(policy, optimizer, rollout, last_value)
        if update % max(updates // 20, 1) == 0:
            taken, done = time.perf_counter() - begin, update * ROLLOUT * count
            share = (
                f"{float(coverages / ends):.0%} of a floor plan seen in a minute"
                if ends
                else "no episode has ended"
            )
            print(
                f"{done / 1e6:.0f} M steps, {taken:.0f} s ({simulated:.0f} s driving), {share}",
                flush=True,
            )
            coverages = ends = torch.zeros((), device="cuda")


if __name__ == "__main__":
    main()
