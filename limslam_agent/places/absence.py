"""What is kept of a robot that is lost, or not yet sure of its place: the frame that it was lost from."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.places.localisation import KnownPlaces, PlaceSearch
from limslam_agent.slam.slam import LineSlam
from limslam_agent.status.monitor import Loss, covariance_of_lost
from limslam_agent.status.rays import Sight, moved, wall_points
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import between, compose, compose_jacobians, inverse

LEAST_KNOWN = 4.0
"""A robot that is lost from a map with a smaller length of walls, m, begins a new map.

Such a map is no loss, and the robot may never come back to its walls.
"""


@dataclass(frozen=True, eq=False)
class KnownFrame:
    """SLAM and occupancy grid of one frame, as they were before a step.

    Attributes
    ----------
    step
        Number of the step.
    slam, grid
        The estimate, which nothing changes any more.
    """

    step: int
    slam: LineSlam
    grid: OccupancyGrid

    @property
    def walls_m(self) -> float:
        """Length of all walls, m."""
        return float(np.hypot(*(self.slam.segments[:, 2:] - self.slam.segments[:, :2]).T).sum())

    @property
    def spread(self) -> float:
        """Standard deviation of a position of which nothing is known but that it is on the map, m."""
        view = self.grid.view
        return float(max(view.values.shape) * view.cell / math.sqrt(12.0))

    @property
    def places(self) -> KnownPlaces:
        """The map of the frame, to be searched."""
        return KnownPlaces(self.slam.segments, self.grid.view, self.slam.range_sensor)

    def explains(self, frame: FloatArray, covariance: FloatArray, rays: FloatArray) -> bool:
        """Whether the covariance of the estimate explains that rays (n, 7) have moved it by a frame (3,).

        ``covariance`` (3, 3) is that of the match.
        """
        if not self.slam.is_renewable:
            return False
        pose = compose(frame, self.slam.pose)
        return self.slam.map_state.closed(pose, covariance, wall_points(rays)) is not None

    def copied(self) -> tuple[LineSlam, OccupancyGrid]:
        """SLAM and grid to go on with."""
        return self.slam.copied(), self.grid.copied()


def known_before(copies: Sequence[KnownFrame], first: int, margin: int) -> KnownFrame | None:
    """The latest copy of an estimate that is older than the step ``first`` by a margin; None without a copy.

    If that copy has hardly a wall, because the drive has just begun, it is a later one from before the step.
    """
    old = [copy for copy in copies if copy.step <= first - margin] or copies[:1]
    if old and old[-1].walls_m >= LEAST_KNOWN:
        return old[-1]
    found = [copy for copy in copies if copy.step < first] or old
    return found[-1] if found else None


class Placed(NamedTuple):
    """A place that was found and has to be confirmed.

    Attributes
    ----------
    at
        Distance since the robot was lost at which it found its place, m.
    rays
        The rays (n, 7) in the map by which it did so.
    place
        The map in which the readings have to fit; None if it is the map in which the robot goes on.
    has_drifted
        Whether the robot was not carried away, but has drifted, and is near.
    has_slipped
        Whether it is not where its odometry says, and its covariance does not explain that.
    """

    at: float
    rays: FloatArray
    place: KnownPlaces | None
    has_drifted: bool = False
    has_slipped: bool = False


@dataclass(eq=False)
class Absence:
    """A robot that is lost, or that has found its place and is not yet sure of it.

    Attributes
    ----------
    loss
        Why the robot is lost, or unsure of its place, and what the readings have said of that.
    first, since
        First step in the local frame, and that of the first one of several local frames.
    known, search
        The frame that the robot was lost from, and the search of its map. None if the robot is in the map of an earlier
        run, or has begun its map anew.
    steps
        The steps before ``since`` as they were believed when the robot was lost.
    jump, driven
        Standard deviation of the position at the beginning, m, and distance since then, m.
    covariance, left
        Covariance (3, 3) of the pose when it was lost, and that pose (3,).
    placed
        The place that was found; None while the robot is lost.
    has_returned
        Whether a place was found at any time.
    """

    loss: Loss
    first: int
    since: int
    known: KnownFrame | None = None
    search: PlaceSearch | None = None
    steps: Sequence[Sight] = ()
    jump: float = 0.0
    covariance: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    left: FloatArray = field(default_factory=lambda: np.zeros(3))
    driven: float = 0.0
    placed: Placed | None = None
    has_returned: bool = False

    @property
    def was_moved(self) -> bool:
        """Whether something says that the robot has moved otherwise than its odometry reports."""
        return self.loss.is_carried or self.jump > 0.0

    def covariance_at(self, pose: FloatArray) -> FloatArray:
        """What has to be added to the covariance (3, 3) at a pose (3,) of the local frame.

        The pose at which the robot was lost stays as uncertain as it was in the earlier frame. An error of its heading
        moves the poses that are far from there.
        """
        since = covariance_of_lost(self.jump, self.driven, knows_heading=not self.loss.is_carried)
        by_left, _ = compose_jacobians(self.left, between(self.left, pose))
        return by_left @ self.covariance @ by_left.T + since


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

    def put(self, slam: LineSlam, grid: OccupancyGrid) -> tuple["Placement", KnownPlaces | None]:
        """Put the robot at its place in the known frame, and close a loop by it if it has drifted.

        Returns
        -------
        placement, closed
            The placement in the map as it is now, and this map, if a loop was closed. Otherwise the placement as it
            was, and None.
        """
        ends = wall_points(self.rays)
        bent = slam.close(self.pose, self.covariance, ends) if self.has_drifted and slam.is_renewable else None
        if bent is None:
            slam.relocate(self.pose, self.covariance, ends=ends)
            return self, None
        grid.bend(*bent)
        rays = moved(self.rays, compose(slam.pose, inverse(self.pose)))
        closed = KnownPlaces(slam.segments, grid.copied().view, slam.range_sensor)
        return self._replace(pose=slam.pose, rays=rays), closed
