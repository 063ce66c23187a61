"""How fast environments, batches, beliefs and a run are, beside others in the same process.

A shared machine changes its speed from second to second. So candidates take turns in short bursts.
A burst of each makes a round, ratios are taken within a round, and the median of the rounds counts.
"""

import itertools
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import gymnasium as gym
import numpy as np

import limslam_env  # noqa: F401 (registers the environments)
from limslam_agent import SlamVectorObservation
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.run_config import RunConfig
from limslam_env.geometry import FloatArray

Loop: TypeAlias = Callable[[], int]
"""Does some steps, and returns how many."""

Clock: TypeAlias = Callable[[], float]

Figure: TypeAlias = tuple[str, str, str]
"""What is measured, the number, and its unit."""

CARTPOLE = "CartPole of numpy, 1024"
SINGLE = "single environment"
LARGE = "batch of 8192"
BELIEFS = "beliefs of 256"
BURST = 0.02
"""Length of a burst, s."""

LONG = "fr079 6 beams", "an hour"
"""Rows of the scoreboard that take minutes."""

_SEED = 7000
DEVICE_COUNTS = 8192, 65_536, 1_048_576
_ROUNDS = 40
_RUNS = 5
_DEVICE_BURSTS = 7
_STEPS = 200  # of a burst of one environment
# steps before batches are timed: in the first ones, far more is seen for the first time than later
_FIRST = 400

_FIRST_STEP = """
import gymnasium as gym, limslam_env
env = gym.make("LimSlam-Env1-v0")
env.reset(seed=0)
env.step(env.action_space.sample())
"""


def rates_in_turn(
    candidates: dict[str, Loop], rounds: int, clock: Clock = time.perf_counter
) -> dict[str, FloatArray]:
    """Steps a second of each candidate in each round (rounds,)."""
    found: dict[str, list[float]] = {name: [] for name in candidates}
    for loop in candidates.values():
        loop()
    for _ in range(rounds):
        for name, loop in candidates.items():
            begin = clock()
            done = 0
            while clock() - begin < BURST:
                done += loop()
            found[name].append(done / (clock() - begin))
    return {name: np.array(rates) for name, rates in found.items()}


def ratio(rates: dict[str, FloatArray], one: str, other: str) -> float:
    """How many times as fast one candidate is as another: the median over the rounds."""
    return float(np.median(rates[one] / rates[other]))


def single_loop() -> Loop:
    """Steps of a single-robot environment, with autoreset."""
    env = gym.make("LimSlam-Env1-v0", sensor_noise=0.02)
    env.reset(seed=0)
    actions = itertools.cycle(
        np.random.default_rng(0).uniform(-1.0, 1.0, (1000, 2)).astype(np.float32)
    )

    def run() -> int:
        for _ in range(_STEPS):
            _, _, terminated, truncated, _ = env.step(next(actions))
            if terminated or truncated:
                env.reset()
        return _STEPS

    return run


def vector_loop(envs: gym.vector.VectorEnv[Any, Any, Any], steps: int) -> Loop:
    """Steps of a batch, with autoreset, after its first ones. A call returns how many
    environment-steps it did.
    """
    envs.reset(seed=0)
    envs.action_space.seed(0)
    actions = itertools.cycle([envs.action_space.sample() for _ in range(8)])
    return _warm(lambda: envs.step(next(actions)), envs.num_envs, steps)


def _warm(step: Callable[[], Any], num_envs: int, steps: int) -> Loop:
    """Some steps of a batch, after its first ones."""

    def run(number: int = steps) -> int:
        for _ in range(number):
            step()
        return number * num_envs

    run(_FIRST)
    return run


def batch_loop(count: int, steps: int, **arguments: Any) -> Loop:
    """Steps of a batch of our environments with 2 cm noise."""
    return vector_loop(
        gym.make_vec("LimSlam-Env1-v0", num_envs=count, sensor_noise=0.02, **arguments), steps
    )


def belief_loop(num_envs: int, steps: int) -> Loop:
    """Steps of a batch with beliefs as observations, after its first ones.

    The robots drive ahead in a slight bend, and turn away from what is near: their maps grow as
    those of explorers do.
    """
    envs = SlamVectorObservation(
        gym.make_vec("LimSlam-Env1-v0", num_envs=num_envs, sensor_noise=0.02)
    )
    seen, _ = envs.reset(seed=0)

    def step() -> None:
        nonlocal seen
        is_near = seen["ranges"][:, 1:5].min(axis=1, keepdims=True) < 0.4
        seen = envs.step(np.where(is_near, (0.5, -0.5), (1.0, 0.9)))[0]

    return _warm(step, num_envs, steps)


def times_faster(
    world: str, runs: int, clock: Clock = time.process_time, max_time: float = 1800.0
) -> float:
    """Simulated time over the time of an exploring agent, as ``limslam run`` drives it: the median
    of some runs.

    The start of the program, the final smoothing and the pictures are left out, and so is a first
    run, which loads what is needed.
    """
    found = []
    for seed in range(runs + 1):
        begin = clock()
        episode = run_episode(RunConfig(world, seed=seed, max_time=max_time))
        found.append(float(episode.time[-1]) / (clock() - begin))
    return float(np.median(found[1:]))


def spent_by(command: list[str], **variables: str) -> float:
    """Processor time of a process, s, from its start to its end."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, **variables})  # noqa: S603
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def first_runs() -> tuple[float, float]:
    """Processor time of ``limslam run`` without compiled code, and of the same run again, s."""
    with tempfile.TemporaryDirectory() as folder:
        options = ["--world", "env1", "--noise", "0.02", "--seed", "5", "--force", "--out", folder]
        command = [sys.executable, "-m", "limslam_agent", "run", *options]
        with tempfile.TemporaryDirectory() as cache:
            first, later = (spent_by(command, NUMBA_CACHE_DIR=cache) for _ in range(2))
    return first, later


def long_figures() -> Iterator[Figure]:
    """Processor time of long replays: a recorded building, if its log is there, and an hour."""
    from benchmarks.scoreboard.measure import measure
    from benchmarks.scoreboard.rows import read_rows

    rows = {row.name: row for row in read_rows().row}
    for name in LONG:
        try:
            cost = measure(rows, rows[name].cells(_SEED)[0]).cost
        except ValueError as error:
            yield name, f"not measured: {error}", ""
            continue
        drive, smoothing = cost["drive_cpu_s"], cost["smoothing_cpu_s"]
        yield f"{name}, drive + smoothing", f"{drive:.0f} + {smoothing:.0f}", "s of processor time"


def device_figure() -> Figure:
    """Rate of a batch on a GPU, if there is one."""
    try:
        rate = f"{np.median(_device_rates(DEVICE_COUNTS[0])) / 1e6:.1f}"
    except (ImportError, RuntimeError):
        rate = "not measured"
    return f"{DEVICE_COUNTS[0]} environments on a GPU", rate, "million steps/s"


def figures(rates: dict[str, FloatArray], clock: Clock, *, with_long: bool) -> Iterator[Figure]:
    """What is measured, the figure, and its unit."""
    yield f"{LARGE} / CartPole", f"{ratio(rates, LARGE, CARTPOLE):.3f}", ""
    yield BELIEFS, f"{np.median(rates[BELIEFS]):,.0f}", "steps/s"
    yield "`limslam run --world env1`", f"{times_faster('env1', _RUNS, clock):.0f}", "x real time"
    for name, spent in zip(("without compiled code", "again"), first_runs(), strict=True):
        yield f"`limslam run`, {name}", f"{spent:.1f}", "s of processor time"
    first = min(spent_by([sys.executable, "-c", _FIRST_STEP]) for _ in range(3))
    yield "first step of a new process", f"{first:.2f}", "s of processor time"
    yield device_figure()
    if with_long:
        yield from long_figures()


def print_rates(clock: Clock, rounds: int = _ROUNDS, *, with_long: bool = False) -> None:
    """Print Markdown tables: rates of all candidates, and what a user waits for."""
    cartpole = gym.make_vec("CartPole-v1", num_envs=1024, vectorization_mode="vector_entry_point")
    candidates = {
        CARTPOLE: vector_loop(cartpole, 20),
        SINGLE: single_loop(),
        "batch of 1024": batch_loop(1024, 20),
        LARGE: batch_loop(8192, 4),
        f"{LARGE}, one thread": batch_loop(8192, 4, num_threads=1),
        BELIEFS: belief_loop(256, 2),
    }
    rates = rates_in_turn(candidates, rounds, clock)
    references = {CARTPOLE: "CartPole", SINGLE: "single"}
    print("| candidate | steps/s |" + "".join(f" x {short} |" for short in references.values()))
    print("|---" * (2 + len(references)) + "|")
    for name, each in rates.items():
        ratios = "".join(f" {ratio(rates, name, reference):.3g} |" for reference in references)
        print(f"| {name} | {np.median(each):,.0f} |{ratios}")
    print("\n| what | now | unit |\n|---|---|---|")
    for figure in figures(rates, clock, with_long=with_long):
        print(f"| {' | '.join(figure)} |", flush=True)


def print_device_rates() -> None:
    """Print a Markdown table of batches of several sizes on a GPU."""
    print("| batch on a GPU | million steps a second | slowest burst |")
    print("|---|---|---|")
    for count in DEVICE_COUNTS:
        rates = np.array(_device_rates(count)) / 1e6
        print(f"| {count} | {np.median(rates):.1f} | {rates.min():.1f} |", flush=True)


def _device_rates(count: int) -> list[float]:
    """Steps a second of a batch on a GPU in some bursts of half a second."""
    envs: Any = gym.make_vec("LimSlam-Env1-v0", num_envs=count, sensor_noise=0.02, device="cuda")
    generator = np.random.default_rng(0)
    actions = [
        envs.to_device(generator.uniform(-1.0, 1.0, (count, 2)).astype(np.float32))
        for _ in range(8)
    ]
    envs.reset(seed=0)

    def rate(steps: int) -> float:
        envs.synchronize()
        start = time.perf_counter()
        for step in range(steps):
            envs.step(actions[step % len(actions)])
        envs.synchronize()
        return steps * count / (time.perf_counter() - start)

    steps = max(int(0.5 * rate(_FIRST) / count), len(actions))
    found = [rate(steps) for _ in range(_DEVICE_BURSTS)]
    envs.close()
    return found
