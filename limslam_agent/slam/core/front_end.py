"""The readings of one robot: checked, counted, and those of other robots left out."""

import numpy as np

from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import Observation, RobotSpec


class FrontEnd:
    """The readings of one robot.

    Parameters
    ----------
    robot
        Body and beams.

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
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._robot = robot
        self.step = -1
        self.ranges: FloatArray = robot.max_ranges
        self.measured: BoolArray = np.zeros(len(robot.beams), dtype=bool)
        self.dropped: BoolArray = np.zeros(len(robot.beams), dtype=bool)
        self.refused_readings = 0

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
