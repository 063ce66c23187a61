"""Other simulators with six rays and 40 walls, for :mod:`benchmarks.speed.vector`: extra ``peers``."""

import itertools
import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

DEGREES = (90.0, 45.0, 15.0, -15.0, -45.0, -90.0)
REACH = 1.5
NUM_WALLS = 40
SIDE = 7.0

_IRSIM_WORLD = """
world: {{height: {side}, width: {side}, step_time: 0.1, sample_time: 0.1, collision_mode: stop}}
robot:
  - kinematics: {{name: diff}}
    shape: {{name: circle, radius: 0.1}}
    state: [3.5, 3.5, 0.0]
    goal: [6.9, 6.9, 0.0]
    sensors:
      - {{type: lidar2d, range_min: 0.0, range_max: {reach}, angle_range: 3.14, number: 6, noise: false}}
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


def vmas_loop(num_envs: int, steps: int = 4) -> Callable[[], int]:
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

    envs = make_env(Rays(), num_envs=num_envs, device="cpu", continuous_actions=True, seed=0)
    envs.reset()
    generator = torch.Generator().manual_seed(0)
    actions = itertools.cycle([[torch.rand(num_envs, 2, generator=generator) * 2.0 - 1.0] for _ in range(8)])

    def run() -> int:
        for _ in range(steps):
            envs.step(next(actions))
        return steps * num_envs

    return run


def irsim_loop(steps: int = 20) -> Callable[[], int]:
    """Steps of ir-sim with one robot."""
    import irsim

    lines = "".join(
        f"  - {{shape: {{name: linestring, vertices: [[{x1:.3f}, {y1:.3f}], [{x2:.3f}, {y2:.3f}]]}}}}\n"
        for x1, y1, x2, y2 in walls()
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "world.yaml"
        path.write_text(_IRSIM_WORLD.format(side=SIDE, reach=REACH) + lines, encoding="utf-8")
        env = irsim.make(str(path), headless=True, disable_all_plot=True)
    actions = itertools.cycle(np.random.default_rng(0).uniform(-0.3, 0.3, (100, 2, 1)))

    def run() -> int:
        for _ in range(steps):
            env.step(next(actions))
            env.get_lidar_scan()
        return steps

    return run
