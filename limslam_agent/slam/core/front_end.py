"""Front end of one robot: checks what it reports, and makes it a motion and readings of a step."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from limslam_agent.kernels.tables import HOLD, MOVED
from limslam_agent.readings import TURN_LENGTH, new_repeats
from limslam_agent.slam.core.encoder_ticks import first_jitter, known_jitter, tick_by
from limslam_agent.slam.core.motion import Motion, steered, unknown_of
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.core.turn_meter import TurnMeter
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.numbers import floats
from limslam_env.interface import NominalNoise, Observation, RobotSpec
from limslam_env.messages import described


class FrontEnd:
    """The latest motion and the latest readings of one robot.

    Parameters
    ----------
    robot
        Body and beams.
    noise
        Nominal noise of its odometry.

    Attributes
    ----------
    step
        Number of the latest observation, from 0.
    ticks
        The ticks (2,) of the wheels' encoders, m, as ``encoder_ticks.tick_by`` finds them.
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

    def __init__(self, robot: RobotSpec, noise: NominalNoise) -> None:
        self._robot = robot
        self._noise = noise
        self._turn_meter: TurnMeter | None = None
        self.step = -1
        self.ticks = np.zeros(2)
        self.reported: FloatArray = np.array(robot.max_ranges)
        self.ranges = self.reported
        self.measured: BoolArray = np.zeros(len(robot.beams), dtype=bool)
        self.dropped = self.measured
        self.hits = self.measured
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
        reported: object = observation
        if not isinstance(reported, Mapping):
            kind = type(reported).__name__
            raise TypeError(
                "an observation must be a dictionary with 'wheels' and 'ranges', not of type "
                f"{kind}"
            )
        yaw_of(observation)
        if "ranges" not in observation:
            return
        if floats(observation["ranges"]).shape != (len(self._robot.beams),):
            raise ValueError(
                f"ranges must be {len(self._robot.beams)} numbers, not "
                f"{described(observation['ranges'])}"
            )

    def accept(self, observation: Observation, motion: Motion, sensor: RangeSensor) -> Motion:
        """The motion of the next step, with the turn by a heading and the jitter by ticks; and
        store its readings.

        The observation has been checked, and reports the ``motion``. The readings are corrected for
        what is known of the sensor.
        """
        motion = self._jittering(self._steered(motion, observation), observation, sensor)
        self._store(observation, motion.increment)
        for beam in sensor.broken:  # a broken beam has seen nothing that counts
            self.reported[beam] = self._robot.max_ranges[beam]
            self.measured[beam] = False
            self.hits[beam] = False
        self.ranges = sensor.corrected(self.reported, self._robot)
        return motion

    def know_repeats(self, other: "FrontEnd") -> None:
        """Take those beams to repeat their readings of which the same robot has found it before."""
        self.repeats[:, HOLD] = other.repeats[:, HOLD]

    def drop(self, beams: BoolArray) -> None:
        """Drop those of the given beams (n_beams,) that hit something: they may have hit another
        robot.
        """
        self.dropped = beams & self.hits
        self.measured = self.measured & ~self.dropped
        self.hits = self.hits & ~self.dropped

    def _steered(self, motion: Motion, observation: Observation) -> Motion:
        """A motion by wheels with the turn by the robot's heading, once it has reported one."""
        if self._turn_meter is None and not math.isnan(yaw_of(observation)):
            self._turn_meter = TurnMeter(self._robot, self._noise)
        if self._turn_meter is None or not motion.is_by_wheels:
            return motion
        wheels = np.asarray(observation["wheels"], dtype=float)
        more = sum(unknown_of(observation))
        turn = self._turn_meter.step(yaw_of(observation), wheels, more)
        return steered(motion, wheels, turn, self._noise, more)

    def _jittering(self, motion: Motion, observation: Observation, sensor: RangeSensor) -> Motion:
        """A motion with the jitter by the ticks, which are found by its travel, too."""
        before = self.ticks
        axle = self._robot.axle
        covariance = motion.covariance
        # Parts of travel that waits for the ranges, or that is not known, are no whole ticks.
        if motion.is_by_wheels and "wheel_variances" not in observation and not sensor.delay:
            travels = map(float, observation["wheels"])
            self.ticks = np.array([*map(tick_by, before.tolist(), travels)])
        known, ticks = np.maximum((before, self.ticks), 0.0).tolist()
        if known != ticks:
            first = first_jitter(before, self.ticks, axle)
            if motion.turn is not None:
                first[2] = 0.0
                first[:, 2] = 0.0
            covariance = covariance + first
        jitter = known_jitter(*ticks, axle)
        if motion.turn is not None:
            jitter = np.diag([jitter.item(0), 0.0, motion.turn.jitter])
        return replace(motion, covariance=covariance, jitter=jitter)

    def _store(self, observation: Observation, motion: FloatArray) -> None:
        """Store the readings of a step in which the robot moved by (3,), m, m, rad, as reported."""
        robot = self._robot
        moved = math.hypot(motion[0], motion[1]) + TURN_LENGTH * abs(float(motion[2]))
        self.step += 1
        self.dropped = np.zeros(len(robot.beams), dtype=bool)
        self.hits = self.dropped.copy()
        if "ranges" not in observation:
            self.measured = self.hits.copy()
            self.repeats[:, MOVED] += moved
            return
        from limslam_agent.kernels.readings import sort_readings

        values = np.array(observation["ranges"], dtype=float)
        limits = np.array([robot.min_ranges, robot.max_ranges, robot.too_near, robot.too_far])
        self.reported = np.empty(len(values))
        self.measured = robot.measures(self.step)
        self.refused_readings += sort_readings(
            values, limits, moved, self.repeats, self.reported, self.measured, self.hits
        )


def yaw_of(observation: Observation) -> float:
    """The heading of an observation, rad; NaN where it has none.

    Raises
    ------
    ValueError
        If it is no single number, or infinite.
    """
    value = observation.get("yaw", math.nan)
    found = floats(value)
    if found.size != 1 or math.isinf(yaw := found.item()):
        raise ValueError(
            f"yaw must be one number, the heading in rad, or NaN, not {described(value)}"
        )
    return yaw
