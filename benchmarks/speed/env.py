"""How fast the environments are, beside a plain pymunk loop in the same run: ``python -m benchmarks.speed.env``.

The candidates take turns (:mod:`benchmarks.speed.rates`). ``--plans`` also loads the largest wall list of a folder.
"""

import argparse
import itertools
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import gymnasium as gym
import numpy as np
import pymunk

import limslam_env
from benchmarks.speed.rates import Loop, print_rates, rates_in_turn
from limslam_env.worlds.formats.loading import load_world
from limslam_env.worlds.world import World

BURST = 200
StepLoop = Callable[[int], None]
PLAIN = "plain pymunk, 40 walls, six rays"


def plain_loop() -> StepLoop:
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

    def run(steps: int) -> None:
        for _ in range(steps):
            body.velocity = (0.1 * math.cos(body.angle), 0.1 * math.sin(body.angle))
            body.angular_velocity = 0.3
            space.step(0.1)
            x, y = body.position
            for angle in angles:
                ahead = body.angle + angle
                space.segment_query_first((x, y), (x + 1.6 * math.cos(ahead), y + 1.6 * math.sin(ahead)), 0.0, rays)

    return run


def random_actions(count: int = 1000) -> list[np.ndarray]:
    """Actions of an untrained policy."""
    return list(np.random.default_rng(0).uniform(-1.0, 1.0, (count, 2)).astype(np.float32))


def single_loop(env: gym.Env) -> StepLoop:
    """Steps of a single-robot environment, with autoreset."""
    env.reset(seed=0)
    actions = itertools.cycle(random_actions())

    def run(steps: int) -> None:
        for _ in range(steps):
            _, _, terminated, truncated, _ = env.step(next(actions))
            if terminated or truncated:
                env.reset()

    return run


def team_loop(num_robots: int) -> StepLoop:
    """Robot-steps of the parallel environment, with autoreset."""
    env = limslam_env.parallel_env(world="env1", num_robots=num_robots, sensor_noise=0.02)
    env.reset(seed=0)
    generator = np.random.default_rng(0)
    rows = generator.uniform(-1.0, 1.0, (100, num_robots, 2)).astype(np.float32)
    actions = itertools.cycle([dict(zip(env.possible_agents, row, strict=True)) for row in rows])

    def run(steps: int) -> None:
        for _ in range(steps // num_robots):
            env.step(next(actions))
            if not env.agents:
                env.reset()

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


def counted(loop: StepLoop, steps: int) -> Loop:
    """A loop of so many steps a call."""

    def run() -> int:
        loop(steps)
        return steps

    return run


def print_speeds(rounds: int) -> None:
    """Print a table of speeds, and the ratio of each to the speed of the plain loop."""
    small, large = rooms(40), rooms(2000)
    loops = {
        PLAIN: plain_loop(),
        "LimSlam-Env1-v0": single_loop(gym.make("LimSlam-Env1-v0", sensor_noise=0.02)),
        "two robots, a robot-step": team_loop(2),
        "eight robots, a robot-step": team_loop(8),
        f"rooms of {len(small.edges)} walls": single_loop(gym.make("LimSlam-World-v0", world=small)),
        f"rooms of {len(large.edges)} walls": single_loop(gym.make("LimSlam-World-v0", world=large)),
    }
    rates = rates_in_turn({name: counted(loop, BURST) for name, loop in loops.items()}, rounds)
    print_rates(rates, {PLAIN: "plain pymunk"})


def print_loading(folder: Path) -> None:
    """Print the times to load, check, and reset the largest of the floor plans in a folder, s."""
    largest = max(folder.glob("*.json"), key=lambda path: path.stat().st_size)
    start = time.perf_counter()
    world = load_world(largest)
    world.check(0.10)
    loaded = time.perf_counter()
    env = gym.make("LimSlam-World-v0", world=world)
    env.reset(seed=0)
    end = time.perf_counter()
    print(f"\n{largest.stem}: {len(world.edges)} walls, {world.size[0]:.0f} x {world.size[1]:.0f} m")
    print(f"loaded and checked in {loaded - start:.2f} s; made and reset for the first time in {end - loaded:.2f} s")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print Markdown tables. The arguments are those of the command line unless they are given."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--plans", type=Path, help="folder of wall lists")
    options = parser.parse_args(arguments)
    print_speeds(options.rounds)
    if options.plans:
        print_loading(options.plans)


if __name__ == "__main__":
    main()
