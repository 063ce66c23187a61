"""Faults of a robot that begin in the middle of an exploration, for tests and measurements of the status."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from limslam_agent import LimSlamAgent
from limslam_agent.config.presets import preset
from limslam_agent.runs.kidnapping import another_place
from limslam_env.envs.env import LimSlamEnv
from limslam_env.geometry import FloatArray
from limslam_env.interface import NominalNoise, Observation

KINDS = ("kidnapped", "reversed", "swapped", "delayed", "jump")
DELAY = 10
"""Steps by which a beam is delayed: 1 s."""


@dataclass(eq=False)
class Fault:
    """One fault of a robot.

    Attributes
    ----------
    kind
        ``kidnapped``: the robot is carried to a random free place and turned, and its wheels do not turn.
        ``reversed``: both wheels report the opposite of their travel. ``swapped``: each wheel reports the travel of the
        other one. ``delayed``: one beam reports its reading of a second ago. ``jump``: the wheels report 5 m once.
    begin
        Time at which the fault begins, s.
    seed
        Of the place that the robot is carried to, and of the beam.
    """

    kind: str
    begin: float = 60.0
    seed: int = 0
    _late: deque[FloatArray] = field(default_factory=deque)
    _has_begun: bool = False

    def carry(self, env: LimSlamEnv, pose: FloatArray) -> None:
        """Move the body of a robot that is kidnapped."""
        env.carry(0, another_place(env.world, env.robot, pose, np.random.default_rng(self.seed)))

    def altered(self, told: Observation, time: float) -> Observation:
        """The observation as the robot with the fault reports it."""
        ranges, wheels = told["ranges"], told["wheels"]
        self._late.append(ranges)
        old = self._late.popleft() if len(self._late) > DELAY else self._late[0]
        if time < self.begin - 1e-9:
            return told
        is_first, self._has_begun = not self._has_begun, True
        if self.kind == "delayed":
            beam = self.seed % len(ranges)
            ranges = np.where(np.arange(len(ranges)) == beam, old, ranges)
        if self.kind == "jump" and is_first:
            wheels = wheels + np.float32(5.0)
        change: dict[str, Callable[[Any], Any]] = {"reversed": lambda w: -w, "swapped": lambda w: w[::-1].copy()}
        return Observation(ranges=ranges, wheels=change.get(self.kind, lambda w: w)(wheels))


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
    agent = LimSlamAgent(env.robot, settings if finds_places else replace(settings, places=None))
    told, info = env.reset(seed=seed)
    agent.reset(info["pose"], seed)
    rows = []
    while info["time"] < fault.begin + lasts:
        seen = fault.altered(told, info["time"])
        action = agent.act(seen)
        rows.append({**info, "observation": seen})
        if note is not None:
            note.append(agent.status)
        if fault.kind == "kidnapped" and abs(info["time"] - fault.begin) < 1e-6:
            fault.carry(env, info["pose"])
        told, _, _, _, info = env.step(action)
    return agent, rows
