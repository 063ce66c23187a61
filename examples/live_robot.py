"""The loop for a live robot: read wheels and ranges from anywhere, call the agent, send wheel
speeds.

    python examples/live_robot.py --out my_room

``FakeRobot`` replaces a real robot: it moves and measures in an empty room. For your robot, write a
class with the same four methods that talks to it (by a serial port, a UDP socket, or a ROS node),
describe its beams in ``SPEC``, and keep the loop. This file imports nothing of the simulator, so it
also runs on the robot.
"""

import argparse
import math
import time
from pathlib import Path
from typing import Protocol

import numpy as np

from limslam_agent import LimSlamAgent, preset, save_map
from limslam_env.interface import NominalNoise, RobotSpec, beams_on_rim

# Measure your robot: radius and axle in m, top speed in m/s, time between two readings in s, the
# beams' angles in deg.
RADIUS = 0.08
SPEC = RobotSpec(
    radius=RADIUS,
    axle=0.14,
    max_wheel_speed=0.30,
    control_period=0.1,
    beams=beams_on_rim((90.0, 45.0, 15.0, -15.0, -45.0, -90.0), RADIUS, max_range=1.5),
)
RANGE_STD = 0.01
WHEEL_VARIANCE = 2e-5


class Robot(Protocol):
    """What the loop needs from a robot."""

    def read_wheels(self) -> tuple[float, float]:
        """Left and right wheel travel since the last call, m (ticks times metres per tick)."""

    def read_ranges(self) -> list[float]:
        """The reading of each beam of ``SPEC``, m; infinity where it saw nothing, and NaN where
        there is no reading.
        """

    def send_wheel_speeds(self, left: float, right: float) -> None:
        """Set the wheel speeds, m/s, until the next call."""

    def wait(self) -> None:
        """Return when it is time for the next readings."""


class FakeRobot:
    """A robot in an empty room of 3 x 2 m. Replace it with your own.

    With a serial port ``read_ranges`` might be ``[float(word) for word in
    port.readline().split()]``, and ``send_wheel_speeds`` might be ``port.write(b"%.3f %.3f;" %
    (left, right))``.
    """

    ROOM = np.array([3.0, 2.0])

    def __init__(self, *, in_real_time: bool) -> None:
        self._random = np.random.default_rng(0)
        self._pose = np.array([1.0, 0.6, 0.3])
        self._travel = np.zeros(2)
        self._pace = SPEC.control_period if in_real_time else 0.0

    def read_wheels(self) -> tuple[float, float]:
        """Encoders have a variance per metre of travel."""
        told = self._travel + self._random.normal(size=2) * np.sqrt(
            WHEEL_VARIANCE * np.abs(self._travel)
        )
        self._travel = np.zeros(2)
        return float(told[0]), float(told[1])

    def read_ranges(self) -> list[float]:
        """Each beam ends at the first of the room's four walls."""
        x, y, heading = self._pose
        ranges = []
        for beam in SPEC.beams:
            angle = heading + beam.angle
            start = np.array([x, y]) + RADIUS * np.array([math.cos(angle), math.sin(angle)])
            towards = np.array([math.cos(angle), math.sin(angle)])
            wall = np.where(towards > 0.0, self.ROOM, 0.0)
            distance = float(
                np.min((wall - start) / np.where(np.abs(towards) < 1e-9, 1e-9, towards))
            )
            seen = distance + self._random.normal(0.0, RANGE_STD)
            ranges.append(max(seen, 0.0) if seen < beam.max_range else math.inf)
        return ranges

    def send_wheel_speeds(self, left: float, right: float) -> None:
        """The wheels turn for one period; walls stop the body and let the wheels spin."""
        self._travel = np.array([left, right]) * SPEC.control_period
        ahead = self._travel.mean()
        turn = (self._travel[1] - self._travel[0]) / SPEC.axle
        middle = self._pose[2] + 0.5 * turn
        place = self._pose[:2] + ahead * np.array([math.cos(middle), math.sin(middle)])
        self._pose = np.array([*np.clip(place, RADIUS, self.ROOM - RADIUS), self._pose[2] + turn])

    def wait(self) -> None:
        """A real robot gives its readings at a fixed rate."""
        time.sleep(self._pace)


def explore(robot: Robot, agent: LimSlamAgent, steps: int, log: Path | None = None) -> np.ndarray:
    """Drive until the agent is done, or for ``steps`` steps. Returns the estimated pose after each
    step (n, 3), m, rad.

    ``log`` is a text file to write, which ``limslam replay`` can read.
    """
    rows = ["t,x,y,theta," + ",".join(f"r_{math.degrees(beam.angle):g}" for beam in SPEC.beams)]
    step = 0
    path = []
    try:
        while step < steps and not agent.done:
            wheels = robot.read_wheels()
            ranges = robot.read_ranges()
            action = agent.act({"wheels": np.array(wheels), "ranges": np.array(ranges)})
            path.append(agent.slam.pose)
            # A log holds the pose by odometry, and ranges from the robot's centre. These beams
            # start on its rim.
            row = (
                step * SPEC.control_period,
                *agent.mapper.odometry[0],
                *(reading + RADIUS for reading in ranges),
            )
            rows.append(",".join(f"{value:.6g}" for value in row))
            left, right = SPEC.max_wheel_speed * action
            robot.send_wheel_speeds(float(left), float(right))
            robot.wait()
            step += 1
    finally:  # also after an error, the robot must stop
        robot.send_wheel_speeds(0.0, 0.0)
        if log is not None:
            log.write_text("\n".join(rows) + "\n", encoding="utf-8")
    agent.finish()
    return np.array(path)


def main() -> None:
    """Explore, then write ``map.json``, ``map.pgm`` with ``map.yaml``, ``map.png`` and
    ``log.csv``.
    """
    parser = argparse.ArgumentParser(description="Explore with a live robot.")
    parser.add_argument(
        "--out", type=Path, default=Path("live_robot"), help="folder for the map and the log"
    )
    parser.add_argument("--steps", type=int, default=6000, help="longest run")
    parser.add_argument("--real-time", action="store_true", help="run at the speed of a real robot")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)

    agent = LimSlamAgent(SPEC, preset("consistent", NominalNoise(RANGE_STD, WHEEL_VARIANCE)))
    robot = FakeRobot(in_real_time=options.real_time)
    path = explore(robot, agent, options.steps, options.out / "log.csv")
    found = agent.snapshot()
    save_map(options.out, found, path, "live robot")
    walls = f"{len(found.segments)} walls in {options.out}/map.json and map.png"
    print(f"{len(path)} steps: {agent.stop_reason or 'time is up'}; {walls}")


if __name__ == "__main__":
    main()
