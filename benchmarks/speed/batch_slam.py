"""How many beliefs a second a batch computes, beside single wrappers: ``python -m benchmarks.speed.batch_slam``.

First, drives in Env1 are recorded. Every robot of the batch then follows one of the drives, each with its own delay.
The time covers all parts of a belief observation: filter, occupancy grid, and the crop of the grid. Single wrappers and
batches are timed in the same run, so that the ratio holds on any machine. The table gives processor time beside
wall-clock time: on a busy machine, processor time is what the wall-clock time would be on a quiet one.
"""

import argparse
import hashlib
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from limslam_agent.agent import LimSlamAgent
from limslam_agent.config.presets import AgentConfig, preset
from limslam_agent.slam.batch.batch_slam import BatchSlam
from limslam_agent.wrappers.single import SlamObservation
from limslam_env.config import NoiseConfig
from limslam_env.envs.env import LimSlamEnv
from limslam_env.geometry import FloatArray
from limslam_env.interface import NominalNoise

BAR = 60_000
"""Belief-steps a second that two threads should reach."""

NOISE = 0.02


class _Recorded(LimSlamEnv):
    """An environment that plays back a recording, so that only the belief is timed."""

    def play(self, ranges: FloatArray, wheels: FloatArray, start: FloatArray) -> None:
        """Set the recording: readings (k, n_beams), m, wheel travel (k, 2), m, and the start pose (3,)."""
        self._told = [
            {"ranges": seen.astype(np.float32), "wheels": driven.astype(np.float32)}
            for seen, driven in zip(ranges, wheels, strict=True)
        ]
        self._begun, self._next = start, 0

    def reset(self, **_: Any) -> Any:
        self._next = 0
        return self._told[0], {"pose": self._begun}

    def step(self, action: Any) -> Any:
        del action
        self._next += 1
        return self._told[self._next], 0.0, False, False, {}


def record(steps: int, seed: int, config: AgentConfig) -> tuple[FloatArray, FloatArray, FloatArray]:
    """An exploration of Env1: readings (k, n_beams), m, wheel travel (k, 2), m, and the start (3,)."""
    env = LimSlamEnv("env1", noise=NoiseConfig(sensor_noise=NOISE), coverage_goal=None)
    seen, info = env.reset(seed=seed)
    agent, ranges, wheels, start = LimSlamAgent(env.robot, config), [], [], info["pose"]
    agent.reset(start)
    for _ in range(steps):
        ranges.append(seen["ranges"])
        wheels.append(seen["wheels"])
        action = agent.act(seen)
        seen = env.step(np.array([0.9, 0.75]) if agent.done else action)[0]
    return np.array(ranges, dtype=float), np.array(wheels, dtype=float), np.array(start)


def timed(work: Callable[[], Any]) -> tuple[float, float]:
    """Wall-clock time and processor time of a call, s."""
    begun, used = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - begun, time.process_time() - used


def gain_of_two_threads() -> float:
    """How much faster two independent threads work than one, now and on this machine."""
    data, pool = bytes(50_000_000), ThreadPoolExecutor(2)

    def digest(_: int) -> None:
        # This runs without the lock of the interpreter.
        hashlib.sha256(data).digest()

    one = timed(lambda: digest(0))[0]
    two = timed(lambda: list(pool.map(digest, range(2))))[0]
    pool.shutdown()
    return 2.0 * one / two


def time_single(logs: list[tuple[FloatArray, FloatArray, FloatArray]], config: AgentConfig) -> FloatArray:
    """Wall-clock time and processor time of a belief-step of the single wrapper (2,), s."""
    total, steps = np.zeros(2), 0
    for ranges, wheels, start in logs:
        env = _Recorded("env1")
        env.play(ranges, wheels, start)
        wrapped = SlamObservation(env, config)  # type: ignore[arg-type]
        wrapped.reset()

        def work(wrapped: SlamObservation = wrapped, steps: int = len(ranges) - 1) -> None:
            for _ in range(steps):
                wrapped.step(None)

        total += timed(work)
        steps += len(ranges) - 1
    return total / steps


def time_batch(
    logs: list[tuple[FloatArray, FloatArray, FloatArray]], config: AgentConfig, num_envs: int, threads: int
) -> tuple[FloatArray, BatchSlam]:
    """As :func:`time_single`, for a batch whose robots follow the drives in turn, each with its own delay."""
    env = LimSlamEnv("env1")
    batch = BatchSlam(env.robot, config, num_envs, num_threads=threads)
    starts = np.array([logs[number % len(logs)][2] for number in range(num_envs)])
    delays = np.arange(num_envs) // len(logs) % 50
    length = len(logs[0][0])
    # The drives begin one after another, so that rare and costly steps do not fall together.
    rows = np.clip(np.arange(length)[:, None] - delays, 0, None)
    chosen = np.arange(num_envs) % len(logs)
    ranges, wheels = np.array([log[0] for log in logs]), np.array([log[1] for log in logs])
    batch.step(ranges[chosen, 0], wheels[chosen, 0])  # loads or compiles what is needed
    batch.reset(starts)
    total = np.zeros(2)
    for row in rows:
        waiting = row == 0
        seen, driven = ranges[chosen, row], np.where(waiting[:, None], 0.0, wheels[chosen, row])
        total += timed(lambda seen=seen, driven=driven: batch.step(seen, driven))  # type: ignore[misc]
    return total / (length * num_envs), batch


def main(arguments: Sequence[str] | None = None) -> None:
    """Record, time, and print a table. The arguments are those of the command line unless they are given."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--envs", type=int, default=64, help="robots of a batch")
    parser.add_argument("--steps", type=int, default=1500, help="steps of a drive")
    parser.add_argument("--drives", type=int, default=4, help="drives that are recorded")
    chosen = parser.parse_args(arguments)
    config = preset("consistent", NominalNoise(NOISE))
    logs = [record(chosen.steps, 200 + number, config) for number in range(chosen.drives)]
    single = time_single(logs[:2], config)
    print(f"Env1, {1000 * NOISE:g} mm, {chosen.steps} steps: filter, grid and crop; bar: {BAR} a second on two threads")
    print(f"{'':>24} {'us by clock':>12} {'us of CPU':>10} {'steps/s':>9} {'x single':>9} {'':>7}")
    print(f"{'SlamObservation':>24} {1e6 * single[0]:>12.0f} {1e6 * single[1]:>10.0f} {1 / single[0]:>9.0f} {1:>9.1f}")
    for threads in (1, 2):
        each, batch = time_batch(logs, config, chosen.envs, threads)
        verdict = "" if threads == 1 else "ok" if 1 / each[0] >= BAR else "MISSED"
        print(
            f"{f'{chosen.envs} robots, {threads} thread(s)':>24} {1e6 * each[0]:>12.1f} {1e6 * each[1]:>10.1f} "
            f"{1 / each[0]:>9.0f} {single[0] / each[0]:>9.1f} {verdict:>7}"
        )
        if threads == 2:
            print(f"speed-up of two independent threads on this machine: {gain_of_two_threads():.2f}")
    print(f"memory of one robot: {batch.bytes_per_env / 1e6:.2f} MB; overflows: {batch.overflows.sum()}")


if __name__ == "__main__":
    main()
