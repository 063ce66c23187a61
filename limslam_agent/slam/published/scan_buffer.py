"""Pseudo-dense scans: points of a few beams, collected while driving and moved by odometry into the
present frame.
"""

from dataclasses import dataclass

import numpy as np

from limslam_agent.config.published import BufferConfig
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import inverse, transform_points
from limslam_env.interface import RobotSpec, Side


@dataclass(frozen=True, eq=False)
class Scan:
    """Points of one side, in the robot's present frame.

    Attributes
    ----------
    points
        End points of the beams (n, 2), m.
    origins
        Origins of those beams (n, 2), m.
    readings
        Step and beam of each point (n, 2).
    drift
        Variance of the heading's change by odometry since each point was measured (n,), rad^2.
    """

    points: FloatArray
    origins: FloatArray
    readings: IntArray
    drift: FloatArray

    def __len__(self) -> int:
        return len(self.points)

    def select(self, chosen: IntArray) -> "Scan":
        """The points with the given indices."""
        return Scan(
            self.points[chosen], self.origins[chosen], self.readings[chosen], self.drift[chosen]
        )


class ScanBuffer:
    """The points of one side of the robot: its two sides never see the same wall at once."""

    def __init__(self, robot: RobotSpec, side: Side, config: BufferConfig) -> None:
        self._config = config
        self._beams = np.array(
            [number for number, beam in enumerate(robot.beams) if beam.side == side], dtype=int
        )
        self._origins = robot.beam_origins[self._beams]
        self._directions = robot.beam_directions[self._beams]
        # End point and origin of each beam, step and beam, and drift.
        self._places = np.empty((0, 2, 2))
        self._readings = np.empty((0, 2), dtype=np.int64)
        self._drift = np.empty(0)
        self._since_hit = 0.0
        self._missed = False
        self._moved = self._turned = np.inf

    @property
    def scan(self) -> Scan:
        """The points in the buffer, a copy."""
        return Scan(
            self._places[:, 0].copy(),
            self._places[:, 1].copy(),
            self._readings.copy(),
            self._drift.copy(),
        )

    def move(self, increment: FloatArray, turn_variance: float = 0.0) -> None:
        """Move the points into the frame after a motion (3,) whose heading has a variance,
        rad^2.
        """
        places = self._places.reshape(-1, 2)
        places[:] = transform_points(inverse(increment), places)
        self._drift += turn_variance
        distance = float(np.hypot(increment[0], increment[1]))
        self._since_hit += distance
        self._moved += distance
        self._turned += abs(float(increment[2]))

    def add(self, ranges: FloatArray, measured: BoolArray, hit: BoolArray, step: int) -> list[Scan]:
        """Add this side's hits among all beams' readings (n_beams,), m, at a step; the scans to
        extract lines from.

        They are the points of a wall that has ended, and those of a full buffer. ``measured`` and
        ``hit`` (n_beams,) say which beams have measured in this step, and which of them saw a wall.
        """
        chosen = hit[self._beams]
        self._missed |= bool(measured[self._beams].any()) and not chosen.any()
        handed_on = []
        # A long distance between two hits is a gap only if a beam missed in between.
        if self._missed and self._since_hit > self._config.max_gap and len(self._drift):
            handed_on.append(self.take())
        if chosen.any():
            self._since_hit = 0.0
            self._missed = False
            self._append(ranges, chosen, step)
            if len(self._drift) >= self._config.size:
                handed_on.append(self.take())
        return handed_on

    def take(self) -> Scan:
        """Empty the buffer, and return its points."""
        scan = self.scan
        self._places, self._readings, self._drift = (
            self._places[:0],
            self._readings[:0],
            self._drift[:0],
        )
        return scan

    def _append(self, ranges: FloatArray, chosen: BoolArray, step: int) -> None:
        if self._moved < self._config.min_distance and self._turned < self._config.min_turn:
            return
        self._moved = self._turned = 0.0
        beams = self._beams[chosen]
        origins = self._origins[chosen]
        points = np.stack(
            (origins + ranges[beams, None] * self._directions[chosen], origins), axis=1
        )
        self._places = np.concatenate((self._places, points))
        self._readings = np.vstack(
            (self._readings, np.column_stack((np.full(len(beams), step), beams)))
        )
        self._drift = np.append(self._drift, np.zeros(len(beams)))
