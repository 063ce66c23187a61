"""Explorations in which a fault begins, for tests of the status."""

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.suite.faults import Fault
from benchmarks.suite.jobs import KIDNAPPED
from limslam_agent import LimSlamAgent, preset
from limslam_agent.runs.episode import another_place
from limslam_env import LimSlamEnv, NominalNoise


def steps_with(
    fault: Fault,
    world: str,
    noise: float,
    lasts: float,
    seed: int,
    note: list[str] | None = None,
    *,
    finds_places: bool = True,
) -> tuple[LimSlamAgent, list[dict[str, Any]]]:
    """Explore until some seconds (``lasts``) after a fault began. A lost robot may look for its place.

    Returns
    -------
    agent
        The agent at the end.
    rows
        For each step the true ``info``, and the ``observation`` that the agent got. Its status is added to ``note``.
    """
    env = LimSlamEnv(world, sensor_noise=noise, coverage_goal=None)
    settings = preset("consistent", NominalNoise(noise))
    agent = LimSlamAgent(env.robot, settings if finds_places else replace(settings, finds_places=False))
    told, info = env.reset(seed=seed)
    agent.reset(info["pose"], seed)
    rows = []
    while info["time"] < fault.begin + lasts:
        seen = fault.altered(told, info["time"])
        action = agent.act(seen)
        rows.append({**info, "observation": seen})
        if note is not None:
            note.append(agent.status)
        if fault.kind == KIDNAPPED and abs(info["time"] - fault.begin) < 1e-6:
            env.carry(0, another_place(env.world, env.robot, info["pose"], np.random.default_rng(fault.seed)))
        told, _, _, _, info = env.step(action)
    return agent, rows
