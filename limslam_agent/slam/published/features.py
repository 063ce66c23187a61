"""Section 2.2, feature extraction: pseudo-dense scans, and the lines in them."""

from typing import NamedTuple

import numpy as np

from limslam_agent.config.published import BufferConfig, PublishedConfig
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_agent.slam.core.line_fit import extract_lines
from limslam_agent.slam.core.motion import Motion
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.se2 import inverse, transform_points
from limslam_env.interface import RobotSpec, Side


class Scan(NamedTuple):
    """Points of one side, in the robot's present frame."""

    points: FloatArray = np.empty((0, 2))  # where the beams end (n, 2), m
    origins: FloatArray = np.empty((0, 2))  # where they begin (n, 2), m
    readings: IntArray = np.empty((0, 2), dtype=np.int64)  # step and beam of each point (n, 2)
    drift: FloatArray = np.empty(0)  # variance of the heading by odometry since then (n,), rad^2


class ObservedLine(NamedTuple):
    """A line that a robot has observed, in its present frame."""

    line: FloatArray  # (r, theta), m and rad
    covariance: FloatArray  # of (r, theta), (2, 2)
    ends: FloatArray  # end points (2, 2), m
    scan: Scan  # its points


class ScanBuffer:
    """The points of one side: the two sides never get points from the same wall."""

    def __init__(self, robot: RobotSpec, side: Side, config: BufferConfig) -> None:
        self._robot = robot
        self._config = config
        self._beams = np.flatnonzero([beam.side == side for beam in robot.beams])
        self.scan = Scan()
        self._since_hit = 0.0
        self._has_missed = False
        self._moved = self._turned = np.inf

    def move(self, motion: Motion) -> None:
        """Move the points by odometry into the robot's frame after a motion."""
        points, origins, readings, drift = self.scan
        places = (transform_points(inverse(motion.increment), each) for each in (points, origins))
        self.scan = Scan._make([*places, readings, drift + motion.covariance[2, 2]])
        distance = float(np.hypot(*motion.increment[:2]))
        self._since_hit += distance
        self._moved += distance
        self._turned += abs(float(motion.increment[2]))

    def add(self, front: FrontEnd) -> list[Scan]:
        """Add what this side sees; the scans that are full, or of a wall that has ended (3.1)."""
        hits = self._beams[front.hits[self._beams]]
        self._has_missed |= bool(front.measured[self._beams].any()) and not len(hits)
        scans = []
        if self._has_missed and self._since_hit > self._config.max_gap and len(self.scan.points):
            scans.append(self.take())
        if len(hits):
            self._since_hit = 0.0
            self._has_missed = False
            if self._moved >= self._config.min_distance or self._turned >= self._config.min_turn:
                self._moved = self._turned = 0.0
                origins = self._robot.beam_origins[hits]
                points = origins + front.ranges[hits, None] * self._robot.beam_directions[hits]
                readings = np.column_stack((np.full(len(hits), front.step), hits))
                seen = Scan(points, origins, readings, np.zeros(len(hits)))
                self.scan = Scan._make(map(np.concatenate, zip(self.scan, seen, strict=True)))
        if len(self.scan.points) >= self._config.size:
            scans.append(self.take())
        return scans

    def take(self) -> Scan:
        """Empty the buffer, and return its points."""
        scan = self.scan
        self.scan = Scan()
        return scan


def observed_lines(scan: Scan, config: PublishedConfig, std: float) -> list[ObservedLine]:
    """All lines for which there are enough votes, of ranges of a standard deviation, m."""
    found = []
    for fit, members in extract_lines(scan.points, config.hough, std):
        own = Scan._make(column[members] for column in scan)
        covariance = fit.covariance + np.diag([0.0, config.filter.drift_share * own.drift.mean()])
        found.append(ObservedLine(fit.line, covariance, fit.ends, own))
    return found
