"""Offline learning from recorded drives: behaviour cloning, then implicit Q-learning, in plain torch.

First record the drives, then learn from them (extras ``datasets`` and ``rl``)::

    python -m benchmarks dataset --plans 60 --out runs/dataset
    python examples/offline_rl.py --data runs/dataset

The first plans of the dataset are held out. The learned policies drive there, and their scores stand beside those of
the recorded drives.

An action is one of twelve pairs of wheel speeds, which is held for half a second. Implicit Q-learning (IQL): Kostrikov,
Nair and Levine, Offline Reinforcement Learning with Implicit Q-Learning, ICLR 2022. Its value is an expectile of the
values of recorded actions, so no other action is ever evaluated.
"""

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import minari
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.stats import bootstrap
from torch import Tensor, nn
from torch.nn import functional

from limslam_agent import SlamObservation, evaluate
from limslam_agent.policies.collision_guard import CollisionGuard
from limslam_env import RobotSpec

HOLD, ACTIONS, POOL = 5, 12, 2
GAMMA, EXPECTILE, TEMPERATURE, LARGEST_WEIGHT, TRACKING = 0.98, 0.7, 10.0, 100.0, 0.005
BEST = 1.0 / 3.0
"""Share of the decisions that are cloned: those of the drives with the most reward a step."""
BATCH, LEARNING_RATE = 256, 1e-3
SPREAD = 0.5
"""Temperature of the softmax from which a policy draws. The best action at every decision can alternate for ever."""

Scores = list[dict[str, Any]]


@dataclass(frozen=True)
class Decisions:
    """Decisions of half a second: n of them, and the observations after them.

    Attributes
    ----------
    pictures, readings
        Free and occupied shares of the grid (m, 2, side, side), 0 to 255, and beside them (m, 8): ranges in m, and the
        wheel speeds of the decision before, by which a policy goes on with a turn that it has begun.
    wheels, rewards, is_over
        Mean wheel speeds (n, 2), summed rewards (n,), and whether the episode has terminated (n,).
    quality
        Mean reward of the whole drive (n,).
    before, after
        Rows of the observations before and after each decision (n,).
    """

    pictures: NDArray[np.uint8]
    readings: NDArray[np.float32]
    wheels: NDArray[np.float32]
    rewards: NDArray[np.float32]
    is_over: NDArray[np.bool_]
    quality: NDArray[np.float32]
    before: NDArray[np.int64]
    after: NDArray[np.int64]


def picture(grids: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The shares of free and of occupied cells (n, 2, side / 2, side / 2), 0 to 255, of grids (n, 1, side, side)."""
    side = grids.shape[-1] // POOL
    cells = grids[:, 0, : side * POOL, : side * POOL].reshape(-1, side, POOL, side, POOL)
    shares = [(cells == value).mean(axis=(2, 4)) for value in (127, 255)]
    return (255.0 * np.stack(shares, axis=1)).astype(np.uint8)


def decisions(datasets: Sequence[Any], plans: Sequence[int]) -> Decisions:
    """The decisions in episodes, which have the numbers of their plans."""
    parts: list[tuple[Any, ...]] = []
    rows = 0
    for episode in (episode for data in datasets for episode in data.iterate_episodes(plans)):
        count = len(episode.actions) // HOLD
        if count == 0:
            continue
        held = episode.actions[: count * HOLD].reshape(count, HOLD, 2).mean(axis=1)
        rewards = episode.rewards[: count * HOLD].reshape(count, HOLD).sum(axis=1)
        is_over = episode.terminations[: count * HOLD].reshape(count, HOLD).any(axis=1)
        seen = slice(0, count * HOLD + 1, HOLD)
        grids, ranges = episode.observations["grid"][seen], episode.observations["ranges"][seen]
        readings = np.column_stack((ranges, np.vstack((np.zeros((1, 2), dtype=np.float32), held))))
        quality, before = np.full(count, episode.rewards.mean()), rows + np.arange(count)
        parts.append((picture(grids), readings, held, rewards, is_over, quality, before, before + 1))
        rows += count + 1
    return Decisions(*(np.concatenate(column) for column in zip(*parts, strict=True)))


class Network(nn.Module):
    """Convolutions over the pictures, and a number for each output."""

    def __init__(self, side: int, outputs: int) -> None:
        super().__init__()
        cells = ((side + 3) // 4 + 1) // 2
        self.eyes = nn.Sequential(
            nn.ZeroPad2d((0, -side % 4, 0, -side % 4)),
            nn.Conv2d(2, 16, 4, stride=4),
            nn.ReLU(),
            nn.Conv2d(16, 32, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Flatten(),
        )
        self.head = nn.Sequential(nn.Linear(32 * cells * cells + 8, 128), nn.ReLU(), nn.Linear(128, outputs))

    def forward(self, pictures: Tensor, readings: Tensor) -> Tensor:
        """The outputs (n, outputs) for pictures (n, 2, side, side), 0 to 255, and what stands beside them (n, 8)."""
        found: Tensor = self.head(torch.cat((self.eyes(pictures / 255.0), readings), dim=1))
        return found


class Batches:
    """Random decisions, half of them mirrored: left and right are alike. ``best`` is the share that is drawn from."""

    def __init__(self, data: Decisions, seed: int, best: float = 1.0) -> None:
        self._data, self._generator = data, np.random.default_rng(seed)
        self._rows = np.flatnonzero(data.quality >= np.quantile(data.quality, 1.0 - best))
        wheels = np.concatenate((data.wheels, data.wheels[:, ::-1])).astype(float)
        self.speeds, labels = kmeans2(wheels, ACTIONS, minit="++", seed=self._generator)
        self._labels = labels.reshape(2, -1)

    def draw(self) -> tuple[tuple[Tensor, Tensor], Tensor, Tensor, Tensor, tuple[Tensor, Tensor]]:
        """Observations, actions (n,), rewards (n,), whether it goes on (n,), and the observations after that."""
        data, chosen = self._data, self._generator.choice(self._rows, size=BATCH)
        mirrored = int(self._generator.integers(2))
        return (
            self._seen(data.before[chosen], mirrored),
            torch.from_numpy(self._labels[mirrored][chosen]).long(),
            torch.from_numpy(data.rewards[chosen]),
            torch.from_numpy(1.0 - data.is_over[chosen].astype(np.float32)),
            self._seen(data.after[chosen], mirrored),
        )

    def _seen(self, rows: NDArray[np.int64], mirrored: int) -> tuple[Tensor, Tensor]:
        pictures = torch.from_numpy(self._data.pictures[rows]).float()
        ranges, wheels = torch.from_numpy(self._data.readings[rows]).split((6, 2), dim=1)
        if mirrored:
            pictures, ranges, wheels = pictures.flip(3), ranges.flip(1), wheels.flip(1)
        return pictures, torch.cat((ranges, wheels), dim=1)


def clone(batches: Batches, side: int, updates: int) -> Network:
    """Behaviour cloning: the recorded action becomes likely."""
    policy = Network(side, ACTIONS)
    optimiser = torch.optim.Adam(policy.parameters(), LEARNING_RATE)
    for _ in range(updates):
        seen, actions, *_ = batches.draw()
        loss = functional.cross_entropy(policy(*seen), actions)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return policy


def implicit_q_learning(batches: Batches, side: int, updates: int) -> Network:
    """IQL: a recorded action becomes the likelier, the better it was than what is usual there."""
    policy, critic = Network(side, ACTIONS), Network(side, 2 * ACTIONS)
    target, value = Network(side, 2 * ACTIONS), Network(side, 1)
    target.load_state_dict(critic.state_dict())
    parameters = [*policy.parameters(), *critic.parameters(), *value.parameters()]
    optimiser = torch.optim.Adam(parameters, LEARNING_RATE)
    for _ in range(updates):
        seen, actions, rewards, goes_on, after = batches.draw()
        with torch.no_grad():
            wanted = rewards + GAMMA * goes_on * value(*after)[:, 0]
            quality = both(target(*seen), actions).min(dim=0).values
        gap = quality - value(*seen)[:, 0]
        value_loss = (torch.where(gap > 0.0, EXPECTILE, 1.0 - EXPECTILE) * gap**2).mean()
        critic_loss = ((both(critic(*seen), actions) - wanted) ** 2).mean()
        weights = (TEMPERATURE * gap.detach()).exp().clamp(max=LARGEST_WEIGHT)
        policy_loss = (weights * functional.cross_entropy(policy(*seen), actions, reduction="none")).mean()
        optimiser.zero_grad()
        (value_loss + critic_loss + policy_loss).backward()
        optimiser.step()
        with torch.no_grad():
            for slow, fast in zip(target.parameters(), critic.parameters(), strict=True):
                slow.lerp_(fast, TRACKING)
    return policy


def both(values: Tensor, actions: Tensor) -> Tensor:
    """The values of actions (2, n) by both critics, of all values (n, 2 * ACTIONS)."""
    pairs = values.reshape(-1, 2, ACTIONS)
    return pairs.gather(2, actions[:, None, None].expand(-1, 2, 1))[:, :, 0].T


class Driver:
    """Drives by a policy. The collision guard, which the recorded policies have too, keeps away from what was seen."""

    def __init__(self, policy: Network, speeds: NDArray[np.float64]) -> None:
        self._policy, self._speeds = policy, speeds
        self.reset(np.zeros(3), 0)

    def reset(self, start_pose: NDArray[np.float64], seed: int) -> None:
        """Begin an episode."""
        del start_pose
        self._generator, self._guard = np.random.default_rng(seed), CollisionGuard(RobotSpec())
        self._steps, self._wheels = 0, np.zeros(2)

    def act(self, observation: dict[str, NDArray[Any]]) -> NDArray[np.float64]:
        """Wheel speeds (2,) for an observation of `SlamObservation`."""
        pose = observation["pose"].astype(float)
        self._guard.add_readings(pose, observation["ranges"])
        if self._steps % HOLD == 0:
            self._wheels = self._speeds[self._chosen(observation)]
        self._steps += 1
        return self._guard.limit_speed(pose, self._wheels)

    def _chosen(self, observation: dict[str, NDArray[Any]]) -> int:
        pictures = torch.from_numpy(picture(observation["grid"][None])).float()
        readings = torch.from_numpy(np.concatenate((observation["ranges"], self._wheels))[None]).float()
        with torch.no_grad():
            scores = self._policy(pictures, readings)[0].double().numpy()
        return int(np.argmax(scores / SPREAD + self._generator.gumbel(size=len(scores))))


def driven(driver: Driver, plans: Sequence[int], size: int, max_time: float, noise: float) -> Scores:
    """Drive on each plan, with the start and the noise of the recorded drives."""

    def observed(env: Any) -> SlamObservation:
        return SlamObservation(env, size=size)

    found: Scores = []
    for plan in plans:
        world: dict[str, Any] = {"world": f"random:{plan}", "sensor_noise": noise}
        found += evaluate(driver, "LimSlam-World-v0", [plan], max_time=max_time, wrap=observed, **world)
    return found


def recorded(folder: Path, policy: str, plans: Sequence[int]) -> Scores:
    """The scores of the recorded drives on some plans."""
    lines = (folder / "results.jsonl").read_text(encoding="utf-8").splitlines()
    rows = {row["seed"]: row["metrics"] for row in map(json.loads, lines) if row["policy"] == policy}
    return [rows[plan] for plan in plans]


def line(name: str, scores: Scores, reference: Scores, max_time: float) -> str:
    """A row of the table: medians, and what is gained on the reference, plan by plan, with a 95 % interval."""
    times = {each: reached(scores, each, max_time) for each in ("time_to_50_s", "time_to_90_s")}
    gains = reached(reference, "time_to_90_s", max_time) - times["time_to_90_s"]
    middles = [f"{np.median(values):5.0f}" for values in times.values()]
    ended = np.median([row["coverage_true"] for row in scores])
    contacts = np.mean([row["collisions"] for row in scores])
    gained = f"{np.mean(gains):+.0f}"
    if len(gains) > 1 and np.ptp(gains) > 0.0:
        low, high = bootstrap((gains,), np.mean, rng=np.random.default_rng(0)).confidence_interval
        gained += f" [{low:+.0f}, {high:+.0f}]"
    return f"{name:12}| {middles[0]} | {middles[1]} | {ended:8.2f} | {contacts:8.2f} | {gained}"


def reached(scores: Scores, name: str, max_time: float) -> NDArray[np.float64]:
    """The times (n,) at which a coverage was reached, s; the longest time where it never was."""
    return np.array([max_time if row[name] is None else row[name] for row in scores], dtype=float)


def arguments() -> argparse.Namespace:
    """The arguments of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("runs/dataset"), help="folder of the datasets")
    parser.add_argument("--policies", default="frontier,learned,random", help="datasets that are learned from")
    parser.add_argument("--held-out", type=int, default=20, help="number of plans that are kept for the evaluation")
    parser.add_argument("--updates", type=int, default=4000, help="gradient steps of each method")
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


def main() -> None:
    """Learn by both methods, and compare on the held-out plans with what was recorded there."""
    options = arguments()
    folders = [options.data / f"limslam/{name}-v0/data" for name in options.policies.split(",")]
    datasets = [minari.MinariDataset(folder) for folder in folders]
    seeds = [each["seed"] for each in datasets[0].storage.get_episode_metadata(datasets[0].episode_indices)]
    data = decisions(datasets, range(options.held_out, len(seeds)))
    spec = datasets[0].env_spec
    max_time, noise = spec.max_episode_steps / 10.0, spec.kwargs["sensor_noise"]
    size, side = datasets[0].observation_space["grid"].shape[-1], data.pictures.shape[-1]
    print(f"{len(data.rewards)} decisions on {len(seeds) - options.held_out} plans")

    plans = seeds[: options.held_out]
    results = {name: recorded(options.data, name, plans) for name in options.policies.split(",")}
    for name, method, best in (("clone", clone, BEST), ("IQL", implicit_q_learning, 1.0)):
        torch.manual_seed(options.seed)
        begin, batches = time.process_time(), Batches(data, options.seed, best)
        driver = Driver(method(batches, side, options.updates), batches.speeds)
        print(f"{name}: {options.updates} updates in {time.process_time() - begin:.0f} s of processor time", flush=True)
        results[name] = driven(driver, plans, size, max_time, noise)
    first = next(iter(results))
    print(f"            | 50 % s | 90 % s | coverage | contacts | 90 % sooner than {first}, s (mean)")
    for name, scores in results.items():
        print(line(name, scores, results[first], max_time))


if __name__ == "__main__":
    main()
