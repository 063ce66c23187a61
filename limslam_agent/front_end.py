"""What one robot contributes to the map: readings checked, and points collected in its two buffers."""

import numpy as np

from limslam_agent.config import AgentConfig
from limslam_agent.scan_buffer import Scan, ScanBuffer
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import Observation, RobotSpec, Side

SIDES: tuple[Side, Side] = ("left", "right")


class FrontEnd:
    """The readings and scan buffers of one robot.

    Parameters
    ----------
    robot
        Body and beams.
    config
        Settings of every stage.

    Attributes
    ----------
    step
        Number of the latest observation, from 0.
    ranges, measured
        The latest readings (n_beams,), m, and which of them are new and finite.
    dropped
        Which of them (n_beams,) may have hit another robot; they are not ``measured``.
    refused_readings
        How many readings were not finite, since the start.
    buffers
        The scan buffers, left and right.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig) -> None:
        self._robot = robot
        self.step = -1
        self.ranges: FloatArray = robot.max_ranges
        self.measured: BoolArray = np.zeros(len(robot.beams), dtype=bool)
        self.dropped: BoolArray = np.zeros(len(robot.beams), dtype=bool)
        self.refused_readings = 0
        self.buffers: dict[Side, ScanBuffer] = {side: ScanBuffer(robot, side, config.buffer) for side in SIDES}

    def check(self, observation: Observation) -> None:
        """Make sure that readings can be accepted.

        Raises
        ------
        ValueError
            If there are ranges of the wrong shape.
        """
        if "ranges" in observation and np.shape(observation["ranges"]) != (len(self._robot.beams),):
            shape = np.shape(observation["ranges"])
            raise ValueError(f"ranges must be {len(self._robot.beams)} numbers, not of shape {shape}")

    def accept(self, observation: Observation) -> None:
        """Take in the readings of the next step, which have been checked."""
        self.step += 1
        self.dropped = np.zeros(len(self._robot.beams), dtype=bool)
        if "ranges" not in observation:
            self.measured = np.zeros(len(self._robot.beams), dtype=bool)
            return
        ranges = np.asarray(observation["ranges"], dtype=float)
        finite = np.isfinite(ranges)
        self.refused_readings += int(np.count_nonzero(~finite))
        self.ranges, self.measured = ranges, finite & self._robot.measures(self.step)

    def drop(self, beams: BoolArray) -> None:
        """Leave out those of the new readings that show a wall and may have hit another robot (n_beams,)."""
        self.dropped = beams & self.hits
        self.measured = self.measured & ~self.dropped

    @property
    def hits(self) -> BoolArray:
        """Readings (n_beams,) that show a wall: neither nothing seen, nor too near to be measured."""
        near_enough = self.ranges < self._robot.too_far
        return np.asarray(self.measured & (self.ranges > self._robot.too_near) & near_enough)

    def collect(self, increment: FloatArray, turn_variance: float) -> list[tuple[Side, Scan]]:
        """Carry the buffers along by a motion (3,), add the new points, and give back what is full or has ended.

        ``turn_variance`` (rad^2) is that of the motion's heading.
        """
        scans: list[tuple[Side, Scan]] = []
        for side, buffer in self.buffers.items():
            buffer.carry(increment, turn_variance)
            scans += [(side, scan) for scan in buffer.add(self.ranges, self.measured, self.hits, self.step)]
        return scans
