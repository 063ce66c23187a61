"""Steps a second of batches on a GPU, beside the batch on processors: ``python -m benchmarks.speed --device cuda``."""

import time
from typing import Any

import gymnasium as gym
import numpy as np

import limslam_env  # noqa: F401 (registers the environments)

COUNTS = 4096, 65_536, 1_048_576
_ACTIONS, _WARM, _SHORTEST, _ROUNDS = 8, 400, 0.5, 7


def device_rate(count: int, **arguments: Any) -> tuple[float, float, float]:
    """Seconds of making and resetting a batch, and steps a second: the median and the lowest of some bursts.

    The first 400 steps, in which far more is seen for the first time than later, are not counted.
    """
    begin = time.perf_counter()
    envs = gym.make_vec("LimSlam-Env1-v0", num_envs=count, sensor_noise=0.02, **arguments)
    envs.reset(seed=0)
    finish = getattr(envs, "synchronize", lambda: None)
    finish()
    made = time.perf_counter() - begin
    generator = np.random.default_rng(0)
    actions = [generator.uniform(-1.0, 1.0, (count, 2)).astype(np.float32) for _ in range(_ACTIONS)]
    if "device" in arguments:
        actions = [envs.to_device(each) for each in actions]  # type: ignore[attr-defined]

    def rate(steps: int) -> float:
        start = time.perf_counter()
        for step in range(steps):
            envs.step(actions[step % _ACTIONS])
        finish()
        return steps * count / (time.perf_counter() - start)

    first = rate(_WARM)
    steps = max(int(_SHORTEST * first / count), _ACTIONS)
    rates = [rate(steps) for _ in range(_ROUNDS)]
    envs.close()
    return made, float(np.median(rates)), min(rates)


def print_device_rates() -> None:
    """A Markdown table of batches of several sizes."""
    print("| batch | made and reset in | million steps a second | slowest burst |")
    print("|---|---|---|---|")
    for count in COUNTS:
        _print_row(f"GPU, {count}", *device_rate(count, device="cuda"))
    _print_row("processors, 8192", *device_rate(8192))


def _print_row(name: str, made: float, median: float, lowest: float) -> None:
    print(f"| {name} | {made:.1f} s | {median / 1e6:.1f} | {lowest / 1e6:.1f} |", flush=True)
