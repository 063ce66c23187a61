"""Live robots for tests: an emulated robot in this process, whose clock is that of the session, and
one outside.
"""

import subprocess
import sys
from dataclasses import dataclass, replace

import numpy as np

from limslam_agent import LimSlamAgent, preset
from limslam_agent.live.emulator.emulator import Body, Emulator
from limslam_agent.live.link import Link
from limslam_agent.live.recording import Recording
from limslam_agent.live.session import Session
from limslam_env import NoiseConfig, NominalNoise, RobotSpec, load_world

NOISE = 0.02


@dataclass(frozen=True)
class Faults:
    """What a connection does to lines: probabilities that one is lost, late (by 0.2 s), doubled or
    damaged.
    """

    loss: float = 0.0
    late: float = 0.0
    double: float = 0.0
    damage: float = 0.0


class Channel:
    """One direction of a connection, in the robot's time."""

    def __init__(self, faults, random):
        self._faults = faults
        self._random = random
        self._waiting = []
        self._count = 0

    def push(self, line, now):
        faults = self._faults
        lost, late, double, damaged = self._random.random(4) < (
            faults.loss,
            faults.late,
            faults.double,
            faults.damage,
        )
        if lost:
            return
        if damaged:
            place = int(self._random.integers(len(line) - 1))  # the newline stays
            line = line[:place] + bytes([line[place] ^ 1]) + line[place + 1 :]
        for _ in range(2 if double else 1):
            self._waiting.append((now + 0.2 * late, self._count, line))
            self._count += 1

    def due(self, now):
        """The lines that arrive up to the time ``now``, s, in the order of their arrival."""
        arrived = sorted(each for each in self._waiting if each[0] <= now + 1e-9)
        self._waiting = [each for each in self._waiting if each[0] > now + 1e-9]
        return [line for _, _, line in arrived]


def emulated(*, seed=0, robot=None, watchdog_ms=500, name="paper", imu=False, world="env1"):
    noise = replace(NoiseConfig(), sensor_noise=NOISE)
    body = Body(load_world(world), robot or RobotSpec(), noise, name, watchdog_ms, seed, imu)
    return Emulator(body)


class Wire:
    """A transport to an emulated robot. Each look for lines lets it drive for a control period."""

    def __init__(self, emulator, faults=None, seed=0):
        self.emulator = emulator
        self.is_cut = False
        self.sent = []
        self.true = []
        self.before = 0.0
        _, _, *ways = np.random.SeedSequence(seed).spawn(4)
        self._down, self._up = (
            Channel(faults or Faults(), np.random.default_rng(way)) for way in ways
        )

    def clock(self):
        return self.before + self.emulator.time

    def receive(self, timeout):
        del timeout
        for line in self._up.due(self.emulator.time):
            self.emulator.hear(line)
        for line in self.emulator.step():
            self._down.push(line, self.emulator.time)
        lines = self._down.due(self.emulator.time)
        self.true.append((self.emulator.time, *self.emulator.pose))
        return [] if self.is_cut else lines

    def send(self, line):
        self.sent.append(line)
        if not self.is_cut:
            self._up.push(line, self.emulator.time)

    def replace(self, emulator):
        """Another robot in its place, or the same one switched on again."""
        self.before += self.emulator.time
        self.emulator = emulator

    def close(self):
        pass


def session_with(
    wire,
    *,
    name="consistent",
    policy=None,
    watch=lambda _: None,
    orders=None,
    listen=lambda: None,
    prior_map=None,
):
    """A session with the robot at the end of a wire, after its hello."""
    link = Link(wire, wire.clock)
    hello = link.first_hello(30.0)
    recording = Recording(RobotSpec(), hello)
    config = preset(name, NominalNoise(NOISE))
    agent = LimSlamAgent(recording.robot, config, policy, prior_map=prior_map)
    return Session(link, hello, agent, recording, watch, orders, listen)


def start_emulator(*options):
    """An emulator in a process of its own, as fast as its host answers. The process, and the name
    of its port.
    """
    command = [
        sys.executable,
        "-m",
        "limslam_agent.live.emulator",
        "--speed",
        "0",
        *map(str, options),
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    return process, process.stdout.readline().strip()


__all__ = ["NOISE", "Faults", "Wire", "emulated", "session_with", "start_emulator"]
