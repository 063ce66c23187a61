"""The emulated robot: a body in the simulator, the firmware, and the loop that lets it drive."""

import math
import time
from typing import IO, NamedTuple, NoReturn, Protocol

import numpy as np

from limslam_agent.live.firmware import NM_PER_TICK, Firmware, ranges_in_mm, ticks
from limslam_agent.live.protocol import MAX_BEAMS, VERSION, Hello
from limslam_env.config import NoiseConfig
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.simulation.simulation import Simulation
from limslam_env.worlds.world import World

ANSWER_WITHIN = 2.0
"""Longest time for which an emulator without a fixed speed waits for the host's answer, s."""

_LONELY_POLL = 0.02  # s, between two steps of a robot that nobody drives


class Driven(Protocol):
    """A robot with its connection to the host."""

    @property
    def truth(self) -> str:
        """The true pose as a line of text."""

    @property
    def awaits_answer(self) -> bool:
        """Whether the host has not yet answered."""

    def step(self) -> None:
        """Drive for a control period, and tell the host what was measured."""

    def listen(self, timeout: float) -> None:
        """Obey the host. Waits for its first command, at most ``timeout`` s."""


def run(robot: Driven, pace: float, truth: IO[str] | None) -> NoReturn:
    """Emulate for ever. A control period takes ``pace`` s, or with 0 as long as the host needs to
    answer.
    """
    due = time.monotonic()
    while True:
        robot.step()
        if truth is not None:
            truth.write(robot.truth)
        now = time.monotonic()
        if pace:
            due = max(due + pace, now - pace)  # no attempt to catch up
        else:
            due = now + (ANSWER_WITHIN if robot.awaits_answer else _LONELY_POLL)
        is_waiting = True
        while is_waiting:
            robot.listen(max(due - time.monotonic(), 0.0))
            is_waiting = time.monotonic() < due and bool(pace or robot.awaits_answer)


class Body(NamedTuple):
    """The robot that is emulated, and its world."""

    world: World
    robot: RobotSpec
    noise: NoiseConfig
    name: str = "paper"  # What it calls itself
    watchdog_ms: int = 500  # Time without a line from the host after which its wheels stop, ms
    seed: int = 0  # Seed of all random numbers
    imu: bool = False  # Whether it measures its heading
    token: str | None = None  # The word by which hosts in a network know it


class SimulatedRobot:
    """A robot that drives in the simulator. Each step is one control period.

    ``readings`` are what it has measured last, and ``pose`` is its true pose (3,), m and rad.
    """

    begins = 0.0  # s, the time of the robot's clock at the start

    def __init__(self, body: Body) -> None:
        self.robot = body.robot
        self._steps = 0
        self._simulation = Simulation(body.world, body.robot)
        start, *_ = np.random.SeedSequence(body.seed).spawn(4)
        self.readings, truth = self._simulation.reset(start, body.noise, imu=body.imu)
        self.pose: FloatArray = truth.poses[0]

    @property
    def time(self) -> float:
        """Time of the robot's clock, s."""
        return self.begins + self._steps * self.robot.control_period

    @property
    def truth(self) -> str:
        """The true pose as a line of text: time (s), x, y (m) and heading (rad)."""
        x, y, heading = self.pose
        return f"{self.time:.3f} {x:.5f} {y:.5f} {heading:.6f}\n"

    def drive(self, left: float, right: float) -> None:
        """Drive for a control period at wheel speeds, m/s, and measure."""
        fastest = self.robot.max_wheel_speed
        self.readings, truth = self._simulation.step([(left / fastest, right / fastest)])
        self.pose = truth.poses[0]
        self._steps += 1


class Emulator(SimulatedRobot):
    """A simulated robot behind the line protocol. Each step is one control period. Raises a
    ValueError if the protocol cannot describe the robot, or the robot cannot start in the world.
    """

    def __init__(self, body: Body) -> None:
        beams = len(body.robot.beams)
        if beams > MAX_BEAMS:
            raise ValueError(f"the protocol has room for {MAX_BEAMS} beams, not for {beams}")
        super().__init__(body)
        _, boot = np.random.SeedSequence(body.seed).spawn(2)
        self._travel = np.zeros(2)
        self.firmware = Firmware(
            Hello(
                VERSION,
                int(boot.generate_state(1)[0]),
                body.name,
                beams,
                NM_PER_TICK,
                round(1e3 * body.robot.control_period),
                body.watchdog_ms,
                body.token,
            )
        )

    def hear(self, line: bytes) -> None:
        """Take a line that the host has sent."""
        self.firmware.hear(line, self._now)

    def step(self) -> list[bytes]:
        """Drive for a control period. The lines for the host after it."""
        speeds = self.firmware.speeds(self._now)
        self.drive(*(1e-3 * speed for speed in speeds))
        self._travel += self.readings.wheels[0]
        ranges = ranges_in_mm(self.readings.ranges[0], self.robot)
        yaw = self.readings.yaw
        heading = None if yaw is None else round(1e3 * math.degrees(yaw.item(0)))
        return self.firmware.say(self._now, ticks(self._travel), ranges, heading)

    @property
    def _now(self) -> int:
        return round(1e3 * self.time)
