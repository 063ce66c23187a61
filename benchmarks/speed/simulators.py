"""Other simulators beside ours, for :mod:`benchmarks.speed.vector`: extra ``peers``.

Where a simulator allows it, it has six rays, their reach, and 40 walls as ours.
"""

import itertools
import math
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.speed.rates import Loop

REACH = 1.5
NUM_WALLS = 40
SIDE = 7.0
BATCH = 1024
"""Number of environments of a batch."""

_IRSIM_WORLD = """
world: {{height: {side}, width: {side}, step_time: 0.1, sample_time: 0.1, collision_mode: stop}}
robot:
  kinematics: {{name: diff}}
  shape: {{name: circle, radius: 0.1}}
  state: [3.5, 3.5, 0.0]
  goal: [6.9, 6.9, 0.0]
  sensors:
    - {{name: lidar2d, type: lidar2d, range_min: 0.0, range_max: {reach}, angle_range: 3.14, number: 6, noise: false}}
obstacle:
"""


def walls() -> np.ndarray[Any, np.dtype[np.float64]]:
    """Short walls (40, 4), m, away from the middle."""
    generator = np.random.default_rng(0)
    found: list[list[float]] = []
    while len(found) < NUM_WALLS:
        middle, angle = generator.uniform(0.5, SIDE - 0.5, 2), generator.uniform(0.0, math.pi)
        half = 0.4 * np.array([math.cos(angle), math.sin(angle)])
        if np.hypot(*(middle - 0.5 * SIDE)) > 1.0:
            found.append([*(middle - half), *(middle + half)])
    return np.array(found)


def repeated(step: Callable[[], object], times: int, robots: int) -> Loop:
    """A loop that makes some steps of so many robots."""

    def run() -> int:
        for _ in range(times):
            step()
        return times * robots

    return run


def vmas_loop() -> Loop:
    """Steps of a batch of vmas with one robot in each environment."""
    import torch
    from vmas import make_env
    from vmas.simulator.core import Agent, Landmark, Line, Sphere, World
    from vmas.simulator.scenario import BaseScenario
    from vmas.simulator.sensors import Lidar

    class Rays(BaseScenario):  # type: ignore[misc,unused-ignore]
        """Six rays among walls."""

        def make_world(self, batch_dim: int, device: Any, **_: Any) -> Any:
            world = World(batch_dim, device, dt=0.1)
            lidar = Lidar(world, angle_start=-0.5 * math.pi, angle_end=0.5 * math.pi, n_rays=6, max_range=REACH)
            world.add_agent(Agent("robot", shape=Sphere(0.1), sensors=[lidar]))
            for number in range(NUM_WALLS):
                world.add_landmark(Landmark(f"wall {number}", collide=True, shape=Line(length=0.8)))
            return world

        def reset_world_at(self, env_index: int | None = None) -> None:
            self.world.agents[0].set_pos(torch.zeros(2), batch_index=env_index)
            for landmark, (x1, y1, x2, y2) in zip(self.world.landmarks, walls(), strict=True):
                middle = torch.tensor([0.5 * (x1 + x2 - SIDE), 0.5 * (y1 + y2 - SIDE)], dtype=torch.float32)
                landmark.set_pos(middle, batch_index=env_index)
                turn = torch.tensor([math.atan2(y2 - y1, x2 - x1)], dtype=torch.float32)
                landmark.set_rot(turn, batch_index=env_index)

        def observation(self, agent: Any) -> Any:
            return agent.sensors[0].measure()

        def reward(self, agent: Any) -> Any:
            return torch.zeros(agent.state.pos.shape[0])

    envs = make_env(Rays(), num_envs=BATCH, device="cpu", continuous_actions=True, seed=0)
    envs.reset()
    generator = torch.Generator().manual_seed(0)
    actions = itertools.cycle([[torch.rand(BATCH, 2, generator=generator) * 2.0 - 1.0] for _ in range(8)])

    return repeated(lambda: envs.step(next(actions)), 4, BATCH)


@contextmanager
def irsim_world(lines: str = "") -> Iterator[str]:
    """Path of a world file for ir-sim with one robot, while the context is open."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "world.yaml"
        path.write_text(_IRSIM_WORLD.format(side=SIDE, reach=REACH) + lines, encoding="utf-8")
        yield str(path)


def irsim_loop() -> Loop:
    """Steps of ir-sim with one robot."""
    import irsim

    lines = "".join(
        f"  - {{shape: {{name: linestring, vertices: [[{x1:.3f}, {y1:.3f}], [{x2:.3f}, {y2:.3f}]]}}}}\n"
        for x1, y1, x2, y2 in walls()
    )
    with irsim_world(lines) as path:
        env = irsim.make(path, headless=True, disable_all_plot=True)
    actions = itertools.cycle(np.random.default_rng(0).uniform(-0.3, 0.3, (100, 2, 1)))

    def step() -> None:
        env.step(next(actions))
        env.get_lidar_scan()

    return repeated(step, 20, 1)


def irsim_x_loop() -> Loop:
    """Steps of a batch of irsim-x with one robot in each environment."""
    import irsim

    with irsim_world() as path:
        envs = irsim.make(path, batch_size=BATCH)
    for x1, y1, x2, y2 in walls().tolist():
        envs.batch_cpp.add_linestring_obstacle([[x1, y1], [x2, y2]])
    rows = np.random.default_rng(0).uniform(-0.3, 0.3, (8, BATCH, 2)).astype(np.float32)
    actions = itertools.cycle(rows)

    def step() -> None:
        envs.step(next(actions))
        envs.get_lidar_scan()

    return repeated(step, 4, BATCH)


def kheperax_loop() -> Loop:
    """Steps of a batch of Kheperax, compiled by JAX, in its unit square."""
    import dataclasses

    import jax
    from kheperax.simu.geoms import Pos, Segment
    from kheperax.simu.maze import Maze
    from kheperax.tasks.config import KheperaxConfig
    from kheperax.tasks.main import KheperaxTask

    if not hasattr(jax, "tree_leaves"):  # the name that Kheperax uses, which today's JAX has no more
        jax.tree_leaves = jax.tree_util.tree_leaves
    segments = [Segment(Pos(x1, y1), Pos(x2, y2)) for x1, y1, x2, y2 in (walls() / SIDE).tolist()]
    default = KheperaxConfig.get_default()
    robot = default.robot.replace(laser_ranges=REACH / SIDE)
    config = dataclasses.replace(default, maze=Maze.create(segments_list=segments), robot=robot)
    env = KheperaxTask.create_default_task(config, jax.random.PRNGKey(0))[0]
    step = jax.jit(jax.vmap(env.step))
    state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.PRNGKey(0), BATCH))
    actions = itertools.cycle(jax.random.uniform(jax.random.PRNGKey(1), (8, BATCH, 2), minval=-1.0))

    def run() -> int:
        nonlocal state
        for _ in range(4):
            state = step(state, next(actions))
        jax.block_until_ready(state.obs)
        return 4 * BATCH

    return run


def minigrid_loop() -> Loop:
    """Steps of a batch of envpool's MiniGrid, with autoreset."""
    import envpool

    envs = envpool.make_gymnasium("MiniGrid-FourRooms-v0", num_envs=BATCH, seed=0)
    envs.reset()
    actions = itertools.cycle(np.random.default_rng(0).integers(0, 3, (8, BATCH)).astype(np.int32))

    return repeated(lambda: envs.step(next(actions)), 4, BATCH)


class Simulator(NamedTuple):
    """Another simulator.

    Attributes
    ----------
    distribution
        The name under which pip installs it.
    make
        Makes its loop.
    computes
        What a step of it computes.
    """

    distribution: str
    make: Callable[[], Loop]
    computes: str


SIMULATORS = {
    "vmas, 1024": Simulator(
        "vmas", vmas_loop,
        "one robot, forces and collisions with 40 walls, six rays; float32 in PyTorch; no noise, no coverage",
    ),
    "ir-sim, one environment": Simulator(
        "ir-sim", irsim_loop, "one robot, collisions with 40 walls, six rays by Shapely; no noise, no coverage",
    ),
    "irsim-x, 1024": Simulator(
        "irsim-x", irsim_x_loop,
        "one robot, collisions with 40 walls, six rays; float32 in C++; no noise, no coverage, no reset",
    ),
    "Kheperax, 1024": Simulator(
        "kheperax", kheperax_loop,
        "one robot, collisions with 44 walls, three rays, two bumpers; float32 in JAX; no noise, no coverage, no reset",
    ),
    "MiniGrid of envpool, 1024": Simulator(
        "envpool", minigrid_loop, "a move between cells and a view of 7 x 7 cells; no geometry; C++",
    ),
}  # fmt: skip
"""The simulators of the table. ir-sim and irsim-x install the same package, so that only one of them can be there."""


def is_installed(distribution: str) -> bool:
    """Whether pip has installed a distribution."""
    try:
        version(distribution)
    except PackageNotFoundError:
        return False
    return True


def simulator_loops() -> tuple[dict[str, Loop], dict[str, str]]:
    """The loops of the simulators that work here, and why the others do not."""
    found, skipped = {}, {}
    for name, simulator in SIMULATORS.items():
        if not is_installed(simulator.distribution):
            skipped[name] = f"{simulator.distribution} is not installed"
            continue
        try:
            found[name] = simulator.make()
            found[name]()
        except Exception as error:  # noqa: BLE001 (whatever goes wrong in one, the others are measured)
            found.pop(name, None)
            skipped[name] = " ".join(f"{type(error).__name__}: {error}".split())[:100]
    return found, skipped
