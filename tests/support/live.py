"""Live robots for tests: an emulated robot in this process, whose clock is that of the session, and one outside."""

import subprocess
import sys
from dataclasses import replace

from limslam_agent import LimSlamAgent, preset
from limslam_agent.live.emulator.channel import Faults
from limslam_agent.live.emulator.emulator import Body, Emulator
from limslam_agent.live.link import Link
from limslam_agent.live.recording import Recording
from limslam_agent.live.session import Session
from limslam_env import NoiseConfig, NominalNoise, RobotSpec, load_world

NOISE = 0.02


def emulated(faults=None, *, seed=0, robot=None, watchdog_ms=500, name="paper"):
    noise = replace(NoiseConfig(), sensor_noise=NOISE)
    return Emulator(Body(load_world("env1"), robot or RobotSpec(), noise, name, watchdog_ms, seed), faults)


class Wire:
    """A transport to an emulated robot. Each look for lines lets it drive for a control period."""

    def __init__(self, emulator):
        self.emulator, self.is_cut, self.sent, self.true = emulator, False, [], []
        self.before = 0.0

    def clock(self):
        return self.before + self.emulator.time

    def receive(self, timeout):
        del timeout
        lines = self.emulator.step()
        self.true.append((self.emulator.time, *self.emulator.pose))
        return [] if self.is_cut else lines

    def send(self, line):
        self.sent.append(line)
        if not self.is_cut:
            self.emulator.hear(line)

    def replace(self, emulator):
        """Another robot in its place, or the same one switched on again."""
        self.before += self.emulator.time
        self.emulator = emulator

    def close(self):
        pass


def session_with(wire, *, name="consistent", policy=None, watch=lambda _: None, obey=lambda _: None):
    """A session with the robot at the end of a wire, after its hello."""
    link = Link(wire, wire.clock)
    hello = link.first_hello(30.0)
    recording = Recording(RobotSpec(), hello)
    agent = LimSlamAgent(recording.robot, preset(name, NominalNoise(NOISE)), policy)
    return Session(link, hello, agent, recording, watch, obey)


def start_emulator(*options):
    """An emulator in a process of its own, as fast as its host answers. The process, and the name of its port."""
    command = [sys.executable, "-m", "limslam_agent.live.emulator", "--speed", "0", *map(str, options)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    return process, process.stdout.readline().strip()


__all__ = ["NOISE", "Faults", "Wire", "emulated", "session_with", "start_emulator"]
