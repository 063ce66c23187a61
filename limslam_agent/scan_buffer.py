"""Pseudo-dense scans: points of a few beams, collected on the way and carried along by odometry."""

from dataclasses import dataclass

import numpy as np

from limslam_agent.config import BufferConfig
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.se2 import inverse, transform_points
from limslam_env.interface import RobotSpec, Side


@dataclass(frozen=True, eq=False)
class Scan:
    """Points of one side, in the robot's present frame.

    Attributes
    ----------
    points
        Where the beams ended (n, 2), m.
    origins
        Where each of those beams began (n, 2), m.
    readings
        (n, 2): the step and the beam that each point comes from.
    """

    points: FloatArray
    origins: FloatArray
    readings: IntArray

    def __len__(self) -> int:
        return len(self.points)

    def select(self, chosen: IntArray) -> "Scan":
        """The points with the given indices."""
        return Scan(self.points[chosen], self.origins[chosen], self.readings[chosen])


_EMPTY = Scan(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2), dtype=np.int64))


class ScanBuffer:
    """The points of one side of the robot.

    Parameters
    ----------
    robot
        Its beams of this side fill the buffer.
    side
        ``"left"`` or ``"right"``: the two never see the same wall at once.
    config
        Size and gap.
    """

    def __init__(self, robot: RobotSpec, side: Side, config: BufferConfig) -> None:
        self._config = config
        self._beams = np.array([number for number, beam in enumerate(robot.beams) if beam.side == side], dtype=int)
        self._origins = robot.beam_origins[self._beams]
        self._directions = robot.beam_directions[self._beams]
        self._scan = _EMPTY
        self._since_hit = 0.0
        self._moved = self._turned = np.inf

    @property
    def scan(self) -> Scan:
        """What is in the buffer now."""
        return self._scan

    def carry(self, increment: FloatArray) -> Scan | None:
        """Move the points into the frame after a motion (3,). Gives them up if the wall has ended."""
        back = inverse(increment)
        scan = self._scan
        self._scan = Scan(transform_points(back, scan.points), transform_points(back, scan.origins), scan.readings)
        distance = float(np.hypot(increment[0], increment[1]))
        self._since_hit += distance
        self._moved += distance
        self._turned += abs(float(increment[2]))
        return self._take() if len(self._scan) and self._since_hit > self._config.max_gap else None

    def add(self, ranges: FloatArray, hit: np.ndarray[tuple[int], np.dtype[np.bool_]], step: int) -> Scan | None:
        """Add this side's hits among all beams' readings (n_beams,), m. Gives the points up when full."""
        chosen = hit[self._beams]
        if not chosen.any():
            return None
        self._since_hit = 0.0
        if self._moved < self._config.min_distance and self._turned < self._config.min_turn:
            return None
        self._moved = self._turned = 0.0
        beams, origins = self._beams[chosen], self._origins[chosen]
        points = origins + ranges[beams, None] * self._directions[chosen]
        readings = np.column_stack((np.full(len(beams), step), beams))
        scan = self._scan
        self._scan = Scan(
            np.vstack((scan.points, points)), np.vstack((scan.origins, origins)), np.vstack((scan.readings, readings))
        )
        return self._take() if len(self._scan) >= self._config.size else None

    def _take(self) -> Scan:
        scan, self._scan = self._scan, _EMPTY
        return scan
