"""How fast the environments and their batches are, beside others in the same run: ``python -m benchmarks.speed``.

The candidates take turns (:mod:`benchmarks.speed.rates`).
"""

import argparse
import contextlib
import itertools
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import pymunk

from benchmarks.speed.device import print_device_rates
from benchmarks.speed.rates import Clock, Loop, print_rates, rates_in_turn, ratio
from benchmarks.speed.run import BAR, times_faster
from limslam_agent import SlamVectorObservation
from limslam_env.batch.places import cores
from limslam_env.geometry import FloatArray
from limslam_env.worlds.world import World

PLAIN = "plain pymunk, 40 walls, six rays"
_BURST = 200  # steps of a loop of one environment
_BELIEFS, OURS = 256, "batch of 1024"
CARTPOLE, SINGLE, BELIEFS = "CartPole of numpy, 1024", "single environment", f"beliefs of {_BELIEFS}"

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
import sys
import gymnasium as gym, numpy as np, limslam_env

def resident():
    with open("/proc/self/status") as status:
        return next(float(line.split()[1]) for line in status if line.startswith("VmRSS"))

def made(id, count):
    envs = gym.make_vec(id, num_envs=count, sensor_noise=0.02)
    envs.reset(seed=0)
    kept = [envs.step(np.zeros((count, 2), dtype=np.float32)) for _ in range(2)]
    return envs, kept

id, few, many = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
small = made(id, few)
before = resident()
large = made(id, many)
print((resident() - before) / many)
"""

_PLANS, _STARTS = 256, 1000

# Steps before batches are timed: in the first ones, far more is seen for the first time than later.
_FIRST = 400


def plain_loop() -> Loop:
    """Pymunk alone: a body that moves among walls, and six rays a step."""
    generator = np.random.default_rng(0)
    space = pymunk.Space()
    for _ in range(40):
        start = generator.uniform(0.0, 7.0, 2)
        wall = pymunk.Segment(
            space.static_body, tuple(start.tolist()), tuple((start + generator.uniform(-1.0, 1.0, 2)).tolist()), 0.0
        )
        wall.filter = pymunk.ShapeFilter(categories=1)
        space.add(wall)
    body = pymunk.Body(1.0, 1.0)
    body.position = (3.5, 3.5)
    space.add(body, pymunk.Circle(body, 0.1))
    rays = pymunk.ShapeFilter(mask=1)
    angles = np.radians([90.0, 45.0, 15.0, -15.0, -45.0, -90.0]).tolist()

    def run() -> int:
        for _ in range(_BURST):
            body.velocity = (0.1 * math.cos(body.angle), 0.1 * math.sin(body.angle))
            body.angular_velocity = 0.3
            space.step(0.1)
            x, y = body.position
            for angle in angles:
                ahead = body.angle + angle
                space.segment_query_first((x, y), (x + 1.6 * math.cos(ahead), y + 1.6 * math.sin(ahead)), 0.0, rays)
        return _BURST

    return run


def single_loop(env: gym.Env[Any, Any]) -> Loop:
    """Steps of a single-robot environment, with autoreset."""
    env.reset(seed=0)
    actions = itertools.cycle(np.random.default_rng(0).uniform(-1.0, 1.0, (1000, 2)).astype(np.float32))

    def run() -> int:
        for _ in range(_BURST):
            _, _, terminated, truncated, _ = env.step(next(actions))
            if terminated or truncated:
                env.reset()
        return _BURST

    return run


def rooms(num_walls: int) -> World:
    """Square rooms of 2.3 m with a door in each wall. The size of the building grows with the number of walls."""
    # Each room adds two walls, below it and to its left; a door divides each of them into two pieces.
    side = round(math.sqrt(num_walls / 4.0))
    cell, jamb, walls = 2.3, 0.8, []
    for i, j in itertools.product(range(side + 1), range(side)):
        for x1, y1, x2, y2 in ((i, j, i, j + 1), (j, i, j + 1, i)):
            start, end = np.array([x1, y1]) * cell, np.array([x2, y2]) * cell
            along = (end - start) / cell
            if i in {0, side}:
                walls.append([*start, *end])
            else:
                walls.extend([[*start, *(start + jamb * along)], [*(end - jamb * along), *end]])
    return World("rooms", (cell * side, cell * side), np.array(walls))


def vector_loop(envs: gym.vector.VectorEnv[Any, Any, Any], steps: int, first: int = 0) -> Loop:
    """Steps of a batch, with autoreset, after its ``first`` steps. A call returns how many environment-steps it did."""
    envs.reset(seed=0)
    envs.action_space.seed(0)
    actions = itertools.cycle([envs.action_space.sample() for _ in range(8)])
    for _ in range(first):
        envs.step(next(actions))

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


def batch_of(count: int, **arguments: Any) -> gym.vector.VectorEnv[Any, Any, Any]:
    """A batch of our environments with 2 cm noise, in Env1 unless a world is given."""
    place = "LimSlam-World-v0" if "world" in arguments else "LimSlam-Env1-v0"
    return gym.make_vec(place, num_envs=count, sensor_noise=0.02, **arguments)


def belief_loop(num_envs: int, steps: int, first: int) -> Loop:
    """Steps of a batch with beliefs as observations, after its ``first`` steps.

    The robots drive ahead in a slight bend, and turn away from what is near: their maps grow as those of explorers do.
    """
    envs = SlamVectorObservation(batch_of(num_envs))
    seen, _ = envs.reset(seed=0)

    def run(number: int = steps) -> int:
        nonlocal seen
        for _ in range(number):
            is_near = seen["ranges"][:, 1:5].min(axis=1, keepdims=True) < 0.4
            seen = envs.step(np.where(is_near, (0.5, -0.5), (1.0, 0.9)))[0]
        return number * num_envs

    run(first)
    return run


def loops() -> dict[str, Loop]:
    """The loops that are compared."""

    def ours(count: int, steps: int, **arguments: Any) -> Loop:
        return vector_loop(batch_of(count, **arguments), steps, _FIRST)

    cartpole = gym.make_vec("CartPole-v1", num_envs=1024, vectorization_mode="vector_entry_point")
    found: dict[str, Loop] = {
        CARTPOLE: vector_loop(cartpole, 20),
        SINGLE: single_loop(gym.make("LimSlam-Env1-v0", sensor_noise=0.02)),
        PLAIN: plain_loop(),
        OURS: ours(1024, 20),
        "batch of 8192": ours(8192, 4),
        "batch of 8192, one thread": ours(8192, 4, num_threads=1),
        "batch of 8192, rooms of 40 walls": ours(8192, 4, world=rooms(40)),
        "batch of 8192, rooms of 2000 walls": ours(8192, 4, world=rooms(2000)),
        "batch of 8192, 64 floor plans": ours(8192, 4, world="random", plans=64),
        "two robots each, batch of 4096, a robot-step": team_loop(4096, 4),
        BELIEFS: belief_loop(_BELIEFS, 2, _FIRST),
    }
    return found


@contextlib.contextmanager
def busy_process() -> Iterator[None]:
    """Another process that uses a core all the time."""
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        process.kill()
        process.wait()


def median_rate(loop: Loop) -> float:
    """Environment-steps a second over three seconds: the median over parts of that time."""
    rates, end = [], time.perf_counter() + 3.0
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


def memory_of(name: str, few: int, many: int) -> float:
    """Memory of an environment in a batch of ``many``, made after one of a ``few``, kB; NaN where it is not known."""
    # A process of its own for each: memory that was given back would be used again, and not be counted.
    return of_new_process(_MEMORY, name, str(few), str(many))[0] if sys.platform == "linux" else math.nan


def seconds_of_plans() -> float:
    """Wall-clock time in which 8192 floor plans would be drawn and prepared, s."""
    gym.make_vec("LimSlam-Random-v0", num_envs=1).reset(seed=0)  # compiles what is not on disk
    envs = gym.make_vec("LimSlam-Random-v0", num_envs=_PLANS)
    begin = time.perf_counter()
    envs.reset(seed=0)
    return (time.perf_counter() - begin) * 8192 / _PLANS


def seconds_of_starts() -> float:
    """Wall-clock time of a reset with a thousand given starts, s: the median of five."""
    envs = gym.make_vec("LimSlam-Env1-v0", num_envs=_STARTS)
    _, infos = envs.reset(seed=0)
    starts = infos["pose"] + np.random.default_rng(0).uniform(-0.02, 0.02, (_STARTS, 3))
    times = []
    for _ in range(5):
        begin = time.perf_counter()
        envs.reset(options={"start": starts})
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


def print_bars(rates: dict[str, FloatArray], batch: Loop, clock: Clock) -> None:
    """Print what this run should reach, and what it has reached."""
    forty, thousands = (f"batch of 8192, rooms of {walls} walls" for walls in (40, 2000))
    alone = median_rate(batch)
    with busy_process():
        beside = median_rate(batch)
    # Before the memory is measured: a process that compiles has memory left over, which the arrays would be put into.
    plans = seconds_of_plans()
    loading, first = min(of_new_process(_FIRST_STEP) for _ in range(3))
    memory, own = memory_of("LimSlam-Env1-v0", 1024, 16384), memory_of("LimSlam-Random-v0", 64, 576)
    most = cores()
    print("\n| bar | measured | wanted |\n|---|---|---|")
    print(f"| batch of 8192 / CartPole | {ratio(rates, 'batch of 8192', CARTPOLE):.3f} | >= 0.37 |")
    print(
        f"| `limslam run --world env1`: simulated time / time | {times_faster('env1', 5, clock):.0f} | >= {BAR:.0f} |"
    )
    print(f"| batch of 1024 / single | {ratio(rates, OURS, SINGLE):.1f} | >= 38 |")
    print(f"| 40 walls / 2000 walls | {ratio(rates, forty, thousands):.2f} | <= 1.3 |")
    print(f"| single / plain pymunk | {ratio(rates, SINGLE, PLAIN):.2f} | >= 2.3 |")
    print(f"| beside a busy process / alone, {most} cores | {beside / alone:.2f} | >= {1.0 - 1.0 / most:.2f} |")
    print(f"| import, then first step | {loading:.2f} s, {first:.2f} s | first step <= 1.5 s |")
    beliefs = float(np.median(rates[BELIEFS]))
    print(f"| belief observations a second, {most} cores | {beliefs:,.0f} | >= 60,000 on two |")
    print(f"| 1000 given starts | {1e3 * seconds_of_starts():.0f} ms | <= 50 ms |")
    print(f"| 8192 floor plans, from {_PLANS} of them | {plans:.0f} s | <= 60 s on two cores |")
    print(f"| memory of an environment, with its grid and the results of two steps | {memory:.1f} kB | <= 20 kB |")
    print(f"| memory of 8192 with plans of their own, from 576 of them | {own * 8.192:.0f} MB | <= 300 MB |")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print Markdown tables. The arguments are those of the command line unless they are given."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bursts", dest="rounds", type=int, default=40, help="bursts of each candidate")
    parser.add_argument("--no-bars", action="store_true", help="only the table of rates")
    parser.add_argument(
        "--processor-time",
        action="store_true",
        help="count processor time, for a machine that is busy; threads then count as one after the other",
    )
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="cuda: only batches on a GPU")
    options = parser.parse_args(arguments)
    if options.device == "cuda":
        print_device_rates()
        return
    candidates = loops()
    clock: Clock = time.process_time if options.processor_time else time.perf_counter
    rates = rates_in_turn(candidates, options.rounds, clock)
    print_rates(rates, {CARTPOLE: "CartPole", SINGLE: "single", PLAIN: "pymunk"})
    if not options.no_bars:
        print_bars(rates, candidates["batch of 8192"], clock)
