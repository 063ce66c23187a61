"""Front end of one robot: checks its readings, counts the steps, and drops beams that may have hit
other robots.
"""

import math
from collections.abc import Mapping

import numpy as np

from limslam_agent.kernels.tables import HOLD, MOVED
from limslam_agent.readings import TURN_LENGTH, new_repeats
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.numbers import floats
from limslam_env.interface import Observation, RobotSpec
from limslam_env.messages import described


class FrontEnd:
    """The latest readings of one robot.

    Parameters
    ----------
    robot
        Body and beams.

    Attributes
    ----------
    step
        Number of the latest observation, from 0.
    reported
        The latest readings (n_beams,), m, as `limslam_agent.readings` defines them.
    ranges, measured
        The same, corrected for what is known of the sensor, and which of them are new and not NaN.
    hits
        New readings (n_beams,) that show a wall: not at the sensor's limits.
    repeats
        What is known of the beams that repeat their readings (n_beams, 13), as
        ``limslam_agent.kernels.tables`` names it. A repeated reading is not ``measured``.
    dropped
        Readings (n_beams,) that may have hit another robot. They are not ``measured``.
    refused_readings
        Number of readings since the start that were skipped: no readings (NaN), and negative
        numbers.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._robot = robot
        self.step = -1
        self.reported: FloatArray = np.array(robot.max_ranges)
        self.ranges = self.reported
        self.measured: BoolArray = np.zeros(len(robot.beams), dtype=bool)
        self.dropped: BoolArray = np.zeros(len(robot.beams), dtype=bool)
        self.hits: BoolArray = np.zeros(len(robot.beams), dtype=bool)
        self.repeats = new_repeats(len(robot.beams))
        self.refused_readings = 0

    @property
    def holds(self) -> list[float]:
        """For how many steps an equal reading of each beam counts as repeated; 0 if it is new."""
        found: list[float] = self.repeats[:, HOLD].tolist()
        return found

    def check(self, observation: Observation) -> None:
        """Check that an observation can be accepted.

        Raises
        ------
        TypeError
            If it is not a dictionary.
        ValueError
            If its ranges have the wrong shape or are no real numbers, or its heading is no number.
        """
        _check_kind(observation)
        yaw_of(observation)
        if "ranges" not in observation:
            return
        if floats(observation["ranges"]).shape != (len(self._robot.beams),):
            raise ValueError(
                f"ranges must be {len(self._robot.beams)} numbers, not "
                f"{described(observation['ranges'])}"
            )

    def accept(self, observation: Observation, motion: FloatArray) -> None:
        """Store the readings of the next step, which have been checked and are not corrected yet.

        The robot has moved by ``motion`` (3,) since the last one, m, m, rad.
        """
        moved = math.hypot(motion[0], motion[1]) + TURN_LENGTH * abs(float(motion[2]))
        self.step += 1
        self.dropped = np.zeros(len(self._robot.beams), dtype=bool)
        if "ranges" not in observation:
            self.measured = self.hits = np.zeros(len(self._robot.beams), dtype=bool)
            self.repeats[:, MOVED] += moved
            return
        from limslam_agent.kernels.readings import sort_readings

        robot = self._robot
        values = np.array(observation["ranges"], dtype=float)
        limits = np.array([robot.min_ranges, robot.max_ranges, robot.too_near, robot.too_far])
        self.reported, self.measured, self.hits = (
            np.empty(len(values)),
            robot.measures(self.step),
            self.dropped.copy(),
        )
        self.refused_readings += sort_readings(
            values, limits, moved, self.repeats, self.reported, self.measured, self.hits
        )

    def know_repeats(self, other: "FrontEnd") -> None:
        """Take those beams to repeat their readings of which the same robot has found it before."""
        self.repeats[:, HOLD] = other.repeats[:, HOLD]

    def correct(self, sensor: RangeSensor) -> None:
        """Correct the readings for what is known of the sensor. Broken beams have seen nothing that
        counts.
        """
        for beam in sensor.broken:
            self.reported[beam] = self._robot.max_ranges[beam]
            self.measured[beam] = False
            self.hits[beam] = False
        self.ranges = sensor.corrected(self.reported, self._robot)

    def drop(self, beams: BoolArray) -> None:
        """Drop those of the given beams (n_beams,) that hit something: they may have hit another
        robot.
        """
        self.dropped = beams & self.hits
        self.measured, self.hits = self.measured & ~self.dropped, self.hits & ~self.dropped


def yaw_of(observation: Observation) -> float:
    """The heading of an observation, rad; NaN where it has none.

    Raises
    ------
    ValueError
        If it is no single number, or infinite.
    """
    value = observation.get("yaw", math.nan)
    try:
        (yaw,) = np.asarray(value, dtype=float).ravel().tolist()
    except (TypeError, ValueError):
        yaw = math.inf
    if math.isinf(yaw):
        raise ValueError(
            f"yaw must be one number, the heading in rad, or NaN, not {described(value)}"
        )
    return float(yaw)


def _check_kind(observation: object) -> None:
    if not isinstance(observation, Mapping):
        kind = type(observation).__name__
        raise TypeError(
            f"an observation must be a dictionary with 'wheels' and 'ranges', not of type {kind}"
        )
