"""How fast the batched environment is, beside others in the same run: ``python -m benchmarks.speed.vector``.

As in :mod:`benchmarks.speed.env`, candidates take turns in short bursts, and the best burst of each counts: it shows
what the machine can do when no other program uses it. ``vmas`` and ``ir-sim`` are measured too where they are installed
(extra ``peers``).
"""

import argparse
import contextlib
import importlib.util
import itertools
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.speed.env import rooms, single_loop
from benchmarks.speed.peers import irsim_loop, vmas_loop

SECONDS = 0.02
Loop = Callable[[], int]

_FIRST_STEP = """
import time
start = time.perf_counter()
import gymnasium as gym, numpy as np, limslam_env
imported = time.perf_counter()
envs = gym.make_vec("LimSlam-Env1-v0", num_envs=64, sensor_noise=0.02)
envs.reset(seed=0)
envs.step(np.zeros((64, 2), dtype=np.float32))
print(imported - start, time.perf_counter() - imported)
"""

_MEMORY = """
import gymnasium as gym, numpy as np, limslam_env

def resident():
    with open("/proc/self/status") as status:
        return next(float(line.split()[1]) for line in status if line.startswith("VmRSS"))

def made(count):
    envs = gym.make_vec("LimSlam-Env1-v0", num_envs=count, sensor_noise=0.02)
    envs.reset(seed=0)
    kept = [envs.step(np.zeros((count, 2), dtype=np.float32)) for _ in range(2)]
    return envs, kept

small = made(1024)
before = resident()
large = made(16384)
print((resident() - before) / 16384)
"""


def vector_loop(envs: gym.vector.VectorEnv[Any, Any, Any], steps: int) -> Loop:
    """Steps of a batch, with autoreset. A call returns the number of environment-steps that it has done."""
    envs.reset(seed=0)
    envs.action_space.seed(0)
    actions = itertools.cycle([envs.action_space.sample() for _ in range(8)])

    def run() -> int:
        for _ in range(steps):
            envs.step(next(actions))
        return steps * envs.num_envs

    return run


def team_loop(num_envs: int, steps: int) -> Loop:
    """Robot-steps of two robots in each environment."""
    import limslam_env

    envs = limslam_env.parallel_vector_env("env1", num_envs=num_envs, num_robots=2, sensor_noise=0.02)
    envs.reset(seed=0)
    rows = np.random.default_rng(0).uniform(-1.0, 1.0, (8, 2, num_envs, 2))
    actions = itertools.cycle([dict(zip(envs.agents, row, strict=True)) for row in rows])

    def run() -> int:
        for _ in range(steps):
            envs.step(next(actions))
        return 2 * steps * num_envs

    return run


def loops() -> dict[str, Loop]:
    """The loops that are compared. All rates are given as ratios to the first two loops."""
    single = single_loop(gym.make("LimSlam-Env1-v0", sensor_noise=0.02))

    def one() -> int:
        single(1000)
        return 1000

    def ours(count: int, steps: int, **arguments: Any) -> Loop:
        place = {"id": "LimSlam-World-v0" if "world" in arguments else "LimSlam-Env1-v0", "sensor_noise": 0.02}
        return vector_loop(gym.make_vec(**{**place, **arguments}, num_envs=count), steps)

    cartpole = gym.make_vec("CartPole-v1", num_envs=1024, vectorization_mode="vector_entry_point")
    found: dict[str, Loop] = {
        "CartPole of numpy, 1024": vector_loop(cartpole, 100),
        "single environment": one,
        "batch of 1024": ours(1024, 20),
        "batch of 8192": ours(8192, 4),
        "batch of 8192, one thread": ours(8192, 4, num_threads=1),
        "batch of 8192, rooms of 40 walls": ours(8192, 4, world=rooms(40)),
        "batch of 8192, rooms of 2000 walls": ours(8192, 4, world=rooms(2000)),
        "batch of 8192, 64 floor plans": ours(8192, 4, world="random", plans=64),
        "two robots each, batch of 4096, a robot-step": team_loop(4096, 4),
    }
    if importlib.util.find_spec("vmas"):
        found["vmas, six rays, 40 walls, 1024"] = vmas_loop(1024)
    if importlib.util.find_spec("irsim"):
        found["ir-sim, six rays, 40 walls"] = irsim_loop()
    return found


def best_rates(candidates: dict[str, Loop], bursts: int) -> dict[str, float]:
    """Environment-steps a second of each candidate, the best of bursts that take turns."""
    best = dict.fromkeys(candidates, 0.0)
    for loop in candidates.values():
        loop()
    for _ in range(bursts):
        for name, loop in candidates.items():
            start, done = time.perf_counter(), 0
            while time.perf_counter() - start < SECONDS:
                done += loop()
            best[name] = max(best[name], done / (time.perf_counter() - start))
    return best


@contextlib.contextmanager
def busy_process() -> Iterator[None]:
    """Another process that uses a core all the time."""
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        process.kill()
        process.wait()


def median_rate(loop: Loop, seconds: float = 3.0) -> float:
    """Environment-steps a second over a longer period: the median over parts of the period."""
    rates, end = [], time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        done = sum(loop() for _ in range(4))
        rates.append(done / (time.perf_counter() - start))
    return float(np.median(rates))


def of_new_process(code: str, *arguments: str) -> list[float]:
    """The numbers that a program prints in a new process."""
    command = [sys.executable, "-c", code, *arguments]
    output = subprocess.run(command, check=True, capture_output=True, text=True, env=os.environ)  # noqa: S603 (see above)
    return [float(word) for word in output.stdout.split()]


def print_rates(rates: dict[str, float]) -> None:
    """Print a table of rates, and the ratios to CartPole and to the single environment."""
    cartpole, single = itertools.islice(rates.values(), 2)
    print("| candidate | steps/s | x CartPole | x single |\n|---|---|---|---|")
    for name, rate in rates.items():
        print(f"| {name} | {rate:,.0f} | {rate / cartpole:.3f} | {rate / single:.1f} |")


def print_bars(rates: dict[str, float], batch: Loop) -> None:
    """Print the ratios that this run should reach, and what it has reached."""
    few, many = (rates[f"batch of 8192, rooms of {walls} walls"] for walls in (40, 2000))
    alone = median_rate(batch)
    with busy_process():
        beside = median_rate(batch)
    loading, first = min(of_new_process(_FIRST_STEP) for _ in range(3))
    (memory,) = of_new_process(_MEMORY) if sys.platform == "linux" else (math.nan,)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    print("\n| bar | measured | wanted |\n|---|---|---|")
    print(f"| 8192 / CartPole | {rates['batch of 8192'] / rates['CartPole of numpy, 1024']:.3f} | >= 0.35 |")
    print(f"| 1024 / single | {rates['batch of 1024'] / rates['single environment']:.1f} | >= 30 |")
    print(f"| 40 walls / 2000 walls | {few / many:.2f} | <= 1.3 |")
    print(f"| beside a busy process / alone, {cores} cores | {beside / alone:.2f} | >= {1.0 - 1.0 / cores:.2f} |")
    print(f"| import, then first step | {loading:.2f} s, {first:.2f} s | first step <= 1.5 s |")
    print(f"| memory of an environment, with its grid and the results of two steps | {memory:.1f} kB | <= 20 kB |")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print Markdown tables. The arguments are those of the command line unless they are given."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bursts", type=int, default=100)
    options = parser.parse_args(arguments)
    candidates = loops()
    rates = best_rates(candidates, options.bursts)
    print_rates(rates)
    print_bars(rates, candidates["batch of 8192"])


if __name__ == "__main__":
    main()
