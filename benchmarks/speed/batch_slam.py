"""How many beliefs a second many robots form, beside single ones: ``python -m benchmarks.speed.batch_slam``.

Drives round Env1 are recorded first; every robot of the batch follows one of them, from another place of it on. What
is timed is all that makes an observation of a belief: filter, occupancy grid, and its crop. Single wrappers and batches
take turns in one run, so that the ratio says something on any machine. Processor time is told beside the time that
went by: on a machine that does other things, too, the former says what the latter would have been.
"""

import argparse
import hashlib
import time
from collections.abc import Callable
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

BAR = 20_000
"""Belief-steps a second that two threads should do."""

NOISE = 0.02


class _Recorded(LimSlamEnv):
    """An environment that tells again what was recorded, so that nothing but the belief is timed."""

    def play(self, ranges: FloatArray, wheels: FloatArray, start: FloatArray) -> None:
        """What to tell: readings (k, n_beams), m, wheel travel (k, 2), m, and the start (3,)."""
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
    """Seconds that go by, and of processor time."""
    begun, used = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - begun, time.process_time() - used


def gain_of_two_threads() -> float:
    """How much more two threads get done than one, now and on this machine, when they have nothing in common."""
    data, pool = bytes(50_000_000), ThreadPoolExecutor(2)

    def digest(_: int) -> None:
        # This runs without Python's lock.
        hashlib.sha256(data).digest()

    one = timed(lambda: digest(0))[0]
    two = timed(lambda: list(pool.map(digest, range(2))))[0]
    pool.shutdown()
    return 2.0 * one / two


def time_single(logs: list[tuple[FloatArray, FloatArray, FloatArray]], config: AgentConfig) -> FloatArray:
    """Seconds a belief-step of the single wrapper (2,): by the clock, and of processor time."""
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
    """The same of a batch whose robots follow the drives in turn, each some steps after the one before."""
    env = LimSlamEnv("env1")
    batch = BatchSlam(env.robot, config, num_envs, num_threads=threads)
    starts = np.array([logs[number % len(logs)][2] for number in range(num_envs)])
    delays = np.arange(num_envs) // len(logs) % 50
    length = len(logs[0][0])
    # Drives begin one after the other, so that not all robots do the rare and costly things at once.
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


def main() -> None:
    """Record, time, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--envs", type=int, default=64, help="robots of a batch")
    parser.add_argument("--steps", type=int, default=1500, help="steps of a drive")
    parser.add_argument("--drives", type=int, default=4, help="drives that are recorded")
    chosen = parser.parse_args()
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
            print(f"what two threads gain at all here: {gain_of_two_threads():.2f}")
    print(f"memory set aside for one robot: {batch.bytes_per_env / 1e6:.2f} MB; no room for {batch.overflows.sum()}")


if __name__ == "__main__":
    main()
