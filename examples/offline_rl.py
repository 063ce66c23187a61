"""Offline learning from recorded drives: behaviour cloning, then implicit Q-learning, in plain torch.

First record the drives, then learn from them (extras ``datasets`` and ``rl``)::

    python -m benchmarks dataset --plans 60 --out runs/dataset
    python examples/offline_rl.py --data runs/dataset

The first plans of the dataset are held out. The learned policies drive there, and their scores stand beside those of
the recorded drives.

The input is what the grid shows in 24 directions, among it how much nearer a step would bring the robot to a frontier
along free cells. An action is one of these directions, chosen every half second: the one in which the recorded robot
was 0.2 m later. Wheel speeds would be a poor action to clone: a policy that asks for full speed ahead in front of a
wall, where the collision guard stops the robot, never leaves that place, and no recorded robot shows how to.

Implicit Q-learning (IQL): Kostrikov, Nair and Levine, Offline Reinforcement Learning with Implicit Q-Learning, ICLR
2022. Its value is an expectile of the values of recorded actions, so no other action is ever evaluated.
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
from scipy.stats import bootstrap
from torch import Tensor, nn
from torch.nn import functional

from limslam_agent import SlamObservation, evaluate
from limslam_agent.grid.occupancy import GridView
from limslam_agent.policies.collision_guard import CollisionGuard
from limslam_agent.policies.controller import wheel_speeds
from limslam_agent.policies.learned.polar_view import ViewConfig, observe
from limslam_env import RobotSpec
from limslam_env.geometry.se2 import wrap_angle

ROBOT, VIEW, CELL = RobotSpec(), ViewConfig(), 0.10
HOLD, STRIDE, PATIENCE = 5, 0.2, 100
"""Steps of a decision; how far the robot goes in the direction of an action, m; and within how many steps."""
TURN_GAIN, TURN_RATE = 5.0, 2.5
"""Rate of turn per heading error, 1/s, and the largest rate, rad/s."""
GAMMA, EXPECTILE, TEMPERATURE, LARGEST_WEIGHT, TRACKING = 0.98, 0.7, 10.0, 100.0, 0.005
BEST = 1.0 / 3.0
"""Share of the decisions that are cloned: those of the drives with the most reward a step."""
BATCH, LEARNING_RATE, CHANNELS = 256, 1e-3, 32
SPREAD = 0.5
"""Temperature of the softmax from which a policy draws. The best action at every decision can alternate for ever."""

SIGNS = np.zeros(256, dtype=np.int16)
SIGNS[127], SIGNS[255] = 1, -1
"""Signs of a grid's values: free is positive, occupied is negative."""

Scores = list[dict[str, Any]]


@dataclass(frozen=True)
class Decisions:
    """Decisions of half a second: n of them, and the observations after them.

    Attributes
    ----------
    views
        Observations (m, ...), as :func:`view` makes them.
    actions, rewards, is_over
        Directions (n,), summed rewards (n,), and whether the episode has terminated (n,).
    quality
        Mean reward of the whole drive (n,).
    before, after
        Rows of the observations before and after each decision (n,).
    """

    views: NDArray[np.float32]
    actions: NDArray[np.int64]
    rewards: NDArray[np.float32]
    is_over: NDArray[np.bool_]
    quality: NDArray[np.float32]
    before: NDArray[np.int64]
    after: NDArray[np.int64]


def view(grid: NDArray[np.uint8], ranges: NDArray[np.float32]) -> NDArray[np.float32]:
    """What an observed grid (1, side, side) and the readings (6,) show in each direction, as one vector."""
    # Cells around the grid count as walls: where the grid ends is no frontier. Row 0 of a map is its lowest row.
    signs = np.pad(SIGNS[grid[0]], 1, constant_values=-1)[::-1]
    known = np.argwhere(signs[1:-1, 1:-1])
    first, last = (known.min(axis=0), known.max(axis=0)) if len(known) else (np.zeros(2, int), np.zeros(2, int))
    part = signs[first[0] : last[0] + 3, first[1] : last[1] + 3]
    low = (first[::-1] - 0.5 * len(signs)) * CELL
    # The robot looks up the picture.
    pose = np.array([0.0, 0.0, 0.5 * np.pi])
    return observe(GridView(low, CELL, part), pose, ranges.astype(float), ROBOT, VIEW)


def directions(poses: NDArray[np.float32]) -> NDArray[np.int64]:
    """The direction (n,) in which the robot was when it had gone one stride, from every decision's pose, of (t, 3).

    -1 where the robot went nowhere.
    """
    found = np.full(len(poses) // HOLD, -1)
    for number in range(len(found)):
        x, y, heading = poses[number * HOLD]
        way = poses[number * HOLD : number * HOLD + PATIENCE, :2] - (x, y)
        gone = np.hypot(*way.T) >= STRIDE
        if gone.any():
            ahead, left = way[np.argmax(gone)]
            angle = np.arctan2(left, ahead) - heading
            found[number] = round(float(angle) / VIEW.angle(1)) % VIEW.directions
    return found


def decisions(datasets: Sequence[Any], plans: Sequence[int]) -> Decisions:
    """The decisions in episodes, which have the numbers of their plans."""
    parts: list[tuple[Any, ...]] = []
    rows = 0
    for episode in (episode for data in datasets for episode in data.iterate_episodes(plans)):
        count = len(episode.actions) // HOLD
        chosen = directions(episode.observations["pose"][: count * HOLD])
        rewards = episode.rewards[: count * HOLD].reshape(count, HOLD).sum(axis=1)
        is_over = episode.terminations[: count * HOLD].reshape(count, HOLD).any(axis=1)
        grids, ranges = (episode.observations[name][: count * HOLD + 1 : HOLD] for name in ("grid", "ranges"))
        seen = np.array([view(*each) for each in zip(grids, ranges, strict=True)])
        quality, before = np.full(count, episode.rewards.mean()), rows + np.arange(count)
        moves = chosen >= 0
        parts.append((seen, *(each[moves] for each in (chosen, rewards, is_over, quality, before, before + 1))))
        rows += count + 1
    return Decisions(*(np.concatenate(column) for column in zip(*parts, strict=True)))


class Around(nn.Module):
    """A convolution around the circle of directions, of values (n, directions, inputs). Its three taps lie ``spread``
    directions apart.
    """

    def __init__(self, inputs: int, spread: int) -> None:
        super().__init__()
        self.spread, self.taps = spread, nn.Linear(3 * inputs, CHANNELS)

    def forward(self, values: Tensor) -> Tensor:
        """Values (n, directions, CHANNELS)."""
        found: Tensor = self.taps(torch.cat([values.roll(self.spread * tap, dims=1) for tap in (-1, 0, 1)], dim=2))
        return found


class Network(nn.Module):
    """Convolutions around the circle of directions. All directions share their weights."""

    def __init__(self, outputs: int = 1) -> None:
        super().__init__()
        inputs = VIEW.rows + 2
        self.first, self.second, self.third = Around(inputs, 1), Around(CHANNELS, 2), Around(CHANNELS, 3)
        self.state, self.score = nn.Linear(len(ROBOT.beams) + 2, CHANNELS), nn.Linear(CHANNELS + inputs, outputs)
        angles = 2.0 * np.pi * torch.arange(VIEW.directions) / VIEW.directions
        self.register_buffer("compass", torch.stack((angles.cos(), angles.sin()), dim=1))

    def forward(self, views: Tensor) -> Tensor:
        """The outputs (n, outputs, directions) for observations (n, ...)."""
        size = VIEW.rows * VIEW.directions
        around = views[:, :size].reshape(-1, VIEW.rows, VIEW.directions).transpose(1, 2)
        told = torch.cat((around, self.compass.expand(len(views), -1, -1)), dim=2)
        values = functional.relu(self.first(told) + self.state(views[:, size:])[:, None])
        values = functional.relu(self.third(functional.relu(self.second(values))))
        found: Tensor = self.score(torch.cat((values, told), dim=2))
        return found.transpose(1, 2)


class Batches:
    """Random decisions, half of them mirrored: left and right are alike. ``best`` is the share that is drawn from."""

    def __init__(self, data: Decisions, seed: int, best: float = 1.0) -> None:
        self._data, self._generator = data, np.random.default_rng(seed)
        self._rows = np.flatnonzero(data.quality >= np.quantile(data.quality, 1.0 - best))

    def draw(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Observations, actions (n,), rewards (n,), whether it goes on (n,), and the observations after that."""
        data, chosen = self._data, self._generator.choice(self._rows, size=BATCH)
        before, actions, after = data.views[data.before[chosen]], data.actions[chosen], data.views[data.after[chosen]]
        if self._generator.integers(2):
            before, actions, after = mirrored(before), -actions % VIEW.directions, mirrored(after)
        goes_on = 1.0 - data.is_over[chosen].astype(np.float32)
        before, actions, rewards, goes_on, after = map(
            torch.from_numpy, (before, actions, data.rewards[chosen], goes_on, after)
        )
        return before, actions, rewards, goes_on, after


def mirrored(views: NDArray[np.float32]) -> NDArray[np.float32]:
    """Observations (n, ...) with left and right exchanged."""
    found, size, beams = views.copy(), VIEW.rows * VIEW.directions, len(ROBOT.beams)
    around = views[:, :size].reshape(-1, VIEW.rows, VIEW.directions)
    found[:, :size] = np.roll(around[:, :, ::-1], 1, axis=2).reshape(len(views), size)
    found[:, size : size + beams] = views[:, size : size + beams][:, ::-1]
    return found


def clone(batches: Batches, updates: int) -> Network:
    """Behaviour cloning: the recorded action becomes likely."""
    policy = Network()
    optimiser = torch.optim.Adam(policy.parameters(), LEARNING_RATE)
    for _ in range(updates):
        seen, actions, *_ = batches.draw()
        loss = functional.cross_entropy(policy(seen)[:, 0], actions)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return policy


def implicit_q_learning(batches: Batches, updates: int) -> Network:
    """IQL: a recorded action becomes the likelier, the better it was than what is usual there."""
    policy, critic, target, value = Network(), Network(2), Network(2), Network()
    target.load_state_dict(critic.state_dict())
    parameters = [*policy.parameters(), *critic.parameters(), *value.parameters()]
    optimiser = torch.optim.Adam(parameters, LEARNING_RATE)
    for _ in range(updates):
        seen, actions, rewards, goes_on, after = batches.draw()
        with torch.no_grad():
            wanted = (rewards + GAMMA * goes_on * value(after).mean(dim=(1, 2)))[:, None]
            quality = of(target(seen), actions).min(dim=1).values
        gap = quality - value(seen).mean(dim=(1, 2))
        value_loss = (torch.where(gap > 0.0, EXPECTILE, 1.0 - EXPECTILE) * gap**2).mean()
        critic_loss = ((of(critic(seen), actions) - wanted) ** 2).mean()
        weights = (TEMPERATURE * gap.detach()).exp().clamp(max=LARGEST_WEIGHT)
        policy_loss = (weights * functional.cross_entropy(policy(seen)[:, 0], actions, reduction="none")).mean()
        optimiser.zero_grad()
        (value_loss + critic_loss + policy_loss).backward()
        optimiser.step()
        with torch.no_grad():
            for slow, fast in zip(target.parameters(), critic.parameters(), strict=True):
                slow.lerp_(fast, TRACKING)
    return policy


def of(values: Tensor, actions: Tensor) -> Tensor:
    """The values (n, critics) of actions (n,), of those of all directions (n, critics, directions)."""
    return values[torch.arange(len(actions)), :, actions]


class Driver:
    """Drives by a policy. The collision guard, which the recorded policies have too, keeps away from what was seen."""

    def __init__(self, policy: Network) -> None:
        self._policy = policy
        self.reset(np.zeros(3), 0)

    def reset(self, start_pose: NDArray[np.float64], seed: int) -> None:
        """Begin an episode."""
        del start_pose
        self._generator, self._guard = np.random.default_rng(seed), CollisionGuard(ROBOT)
        self._steps, self._heading = 0, 0.0

    def act(self, observation: dict[str, NDArray[Any]]) -> NDArray[np.float64]:
        """Wheel speeds (2,) for an observation of `SlamObservation`."""
        pose = observation["pose"].astype(float)
        self._guard.add_readings(pose, observation["ranges"])
        if self._steps % HOLD == 0:
            self._heading = pose[2] + VIEW.angle(self._chosen(observation))
        self._steps += 1
        error = float(wrap_angle(self._heading - pose[2]))
        turn = float(np.clip(TURN_GAIN * error, -TURN_RATE, TURN_RATE))
        wheels = wheel_speeds(ROBOT.max_wheel_speed * max(float(np.cos(error)), 0.0), turn, ROBOT)
        return self._guard.limit_speed(pose, wheels)

    def _chosen(self, observation: dict[str, NDArray[Any]]) -> int:
        with torch.no_grad():
            seen = torch.from_numpy(view(observation["grid"], observation["ranges"]))
            scores = self._policy(seen[None])[0, 0].double().numpy()
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
    parser.add_argument("--updates", type=int, default=1000, help="gradient steps of each method")
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
    size = datasets[0].observation_space["grid"].shape[-1]
    print(f"{len(data.rewards)} decisions on {len(seeds) - options.held_out} plans")

    plans = seeds[: options.held_out]
    results = {name: recorded(options.data, name, plans) for name in options.policies.split(",")}
    for name, method, best in (("clone", clone, BEST), ("IQL", implicit_q_learning, 1.0)):
        torch.manual_seed(options.seed)
        begin, batches = time.process_time(), Batches(data, options.seed, best)
        driver = Driver(method(batches, options.updates))
        print(f"{name}: {options.updates} updates in {time.process_time() - begin:.0f} s of processor time", flush=True)
        results[name] = driven(driver, plans, size, max_time, noise)
    first = next(iter(results))
    print(f"            | 50 % s | 90 % s | coverage | contacts | 90 % sooner than {first}, s (mean)")
    for name, scores in results.items():
        print(line(name, scores, results[first], max_time))


if __name__ == "__main__":
    main()
