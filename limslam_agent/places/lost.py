"""What is known of where a robot is: here, lost, or placed again without being sure of it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.places.localisation import KnownPlaces, PlaceSearch
from limslam_agent.record import Scan
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.slam import ConsistentEstimator
from limslam_agent.status.monitor import Loss, covariance_of_lost
from limslam_agent.status.rays import step_rays
from limslam_agent.status.sudden_changes import change_evidence
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import between, compose, compose_jacobians, inverse
from limslam_env.interface import RobotSpec

# Number of steps between two copies of the estimate, and number of copies that are kept
_SPACING = 50
_MOST = 6

LEAST_KNOWN = 4.0
"""A robot that is lost from a map with a smaller length of walls, m, begins a new map.

Such a map is no loss, and the robot may never come back to its walls.
"""


@dataclass(frozen=True, eq=False)
class KnownFrame:
    """SLAM and occupancy grid of one frame, as they were before a step. Nothing changes them any
    more.
    """

    step: int
    slam: ConsistentEstimator
    grid: OccupancyGrid

    @property
    def walls_m(self) -> float:
        """Length of all walls, m."""
        return float(np.hypot(*(self.slam.segments[:, 2:] - self.slam.segments[:, :2]).T).sum())

    @property
    def spread(self) -> float:
        """Standard deviation of a position of which nothing is known but that it is on the map,
        m.
        """
        view = self.grid.view
        return float(max(view.values.shape) * view.cell / math.sqrt(12.0))

    @property
    def places(self) -> KnownPlaces:
        """The map of the frame, to be searched."""
        return KnownPlaces.of(self.slam, self.grid.view)


class Checkpoints:
    """The latest copies of an estimate."""

    def __init__(self) -> None:
        self._copies: list[KnownFrame] = []

    @property
    def oldest(self) -> int:
        """Number of the step of the oldest copy."""
        return self._copies[0].step

    def is_due(self, step: int) -> bool:
        """Whether a copy is to be made before a step."""
        return not self._copies or step % _SPACING == 0

    def add(self, copy: KnownFrame, longest: int, *, keeps_old: bool) -> None:
        """Keep another copy, and those before that are at most ``longest`` steps old. Half of them
        are the oldest ones, if these are to be kept.
        """
        young = [each for each in self._copies if each.step > copy.step - longest]
        kept = young[: _MOST // 2] if keeps_old else []
        later = [*young[len(kept) :], copy]
        self._copies = [*kept, *later[len(kept) - _MOST :]]

    def before(self, first: int, margin: int = 1) -> KnownFrame | None:
        """The latest copy that is older than a step by a margin; None without a copy.

        If that copy has hardly a wall, because the drive has just begun, it is a later one from
        before the step.
        """
        old = [copy for copy in self._copies if copy.step <= first - margin] or self._copies[:1]
        if old and old[-1].walls_m >= LEAST_KNOWN:
            return old[-1]
        found = [copy for copy in self._copies if copy.step < first] or old
        return found[-1] if found else None


@dataclass(frozen=True, eq=False)
class Here:
    """The robot knows its place."""


@dataclass(frozen=True, eq=False)
class Lost:
    """The robot is lost, and in a local frame.

    Attributes
    ----------
    loss
        Why it was lost at first, and whether the readings said in which step.
    known
        The frame that it was lost from.
    since, scans
        First step after it was lost at first, and the steps before that as they were believed then.
    jump
        Standard deviation of the position at the beginning, m.
    covariance, left
        Covariance (3, 3) of the pose when it was lost, and that pose (3,).
    search
        The search of the map that it was lost from.
    first
        First step in the local frame, which may be one of several.
    is_carried
        Whether the readings have said that it was carried away, at first or later in a local frame.
    driven
        Distance since it was lost at first, m.
    has_returned
        Whether a place was found at any time.
    """

    loss: Loss
    known: KnownFrame
    since: int
    scans: Sequence[Scan]
    jump: float
    covariance: FloatArray
    left: FloatArray
    search: PlaceSearch
    first: int
    is_carried: bool
    driven: float = 0.0
    has_returned: bool = False

    @property
    def was_moved(self) -> bool:
        """Whether something says that the robot has moved otherwise than its odometry reports."""
        return self.is_carried or self.jump > 0.0

    def covariance_at(self, pose: FloatArray) -> FloatArray:
        """What has to be added to the covariance (3, 3) at a pose (3,) of the local frame.

        The pose at which the robot was lost stays as uncertain as it was in the earlier frame. An
        error of its heading moves the poses that are far from there.
        """
        since = covariance_of_lost(self.jump, self.driven, knows_heading=not self.is_carried)
        by_left, _ = compose_jacobians(self.left, between(self.left, pose))
        return by_left @ self.covariance @ by_left.T + since


@dataclass(frozen=True, eq=False)
class Placed:
    """The robot's place was found, or it has begun a new map, and it is not sure of that yet.

    Attributes
    ----------
    reason
        Why it is unsure, in words.
    search
        How its place was found.
    lost
        What it is if that place is wrong; None if it has no other frame to go back to.
    first, rays
        The rays (n, 7) in the map by which it was placed, and the step from which on more of them
        count.
    place
        The map in which the readings have to fit; None if it is the map in which the robot goes on.
    has_drifted
        Whether it was not carried away, but has drifted, and is near.
    driven, at
        Distances since it was lost at first, m, also when its place was found, or contradicted for
        the last time.
    """

    reason: str
    search: PlaceSearch
    lost: Lost | None
    first: int
    rays: FloatArray = field(default_factory=lambda: np.empty((0, 7)))
    place: KnownPlaces | None = None
    has_drifted: bool = False
    driven: float = 0.0
    at: float = 0.0


class Placement(NamedTuple):
    """How a robot goes on in the frame that it was lost from, or in the map of an earlier run.

    Attributes
    ----------
    step
        First step after the robot was carried away.
    pose, covariance
        Its pose (3,) before that step, in the known frame, and the covariance (3, 3).
    rays
        The rays (n, 7) in the known frame by which it was placed.
    has_drifted
        Whether the robot was not carried away, but has drifted.
    """

    step: int
    pose: FloatArray
    covariance: FloatArray
    rays: FloatArray
    has_drifted: bool = False


def placed_until_carried(
    lost: Lost,
    scans: Sequence[Scan],
    begin: int,
    frame: FloatArray,
    robot: RobotSpec,
    sensor: RangeSensor,
) -> FloatArray:
    """The poses (m, 3) of a lost robot in the known frame after the steps before it was carried
    away.

    Earlier readings fit the poses that were believed, later ones fit the poses by which it was
    placed again. Both are weighed by the evidence of the readings in the map, which is 0 on ground
    that the map does not have. There, no reading contradicts anything, and a step would be taken
    for one of the new place if only contradictions counted. The evidence of the change of the
    readings at the break counts, too.

    Parameters
    ----------
    scans, begin
        The steps, and the number of the first of them. The robot was carried away after that one.
    frame
        Pose (3,) of the local frame in the known one.
    robot, sensor
        Body and beams as specified, and how ranges are measured.
    """
    last = max(lost.first - 1 - begin, 0)
    poses = [compose(frame, scans[last].pose)]
    for scan in reversed(scans[1 : last + 1]):
        poses.append(compose(poses[-1], inverse(scan.motion)))
    # A robot that was lost in its local frame, too, was carried away before it was lost for the
    # first time.
    placed = np.array(poses[::-1])[: max(lost.since - begin, 1)]
    if lost.loss.is_dated:
        return placed
    mounted = sensor.mounted(robot)
    gained = []
    for scan, pose in zip(scans, placed, strict=False):
        rays = step_rays(sensor.corrected(scan.ranges, robot), mounted)
        here, there = lost.search.place.weigh(np.array([scan.pose, pose]), rays)
        gained.append(here.evidence - there.evidence)
    totals = np.cumsum(gained)
    changes = change_evidence(scans[: len(placed) + 1], robot, sensor).sum(axis=1)
    totals[1 : 1 + len(changes)] += changes
    # Of equally good steps, the last one is the nearest to the first doubt.
    return placed[: len(totals) - int(totals[::-1].argmax())]
