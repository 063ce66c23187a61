"""What is kept of a robot that is lost: the frame that it was lost from, what happened since, and where it goes on."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.places.localisation import KnownPlaces, Localisation
from limslam_agent.places.rays import moved, wall_points
from limslam_agent.slam.slam import LineSlam
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose, inverse

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
    def places(self) -> KnownPlaces:
        """The map of the frame, to be searched."""
        return KnownPlaces(self.slam.segments, self.grid.view, self.slam.range_sensor)

    def explains(self, frame: FloatArray, covariance: FloatArray, rays: FloatArray) -> bool:
        """Whether the covariance of the estimate explains that rays (n, 6) have moved it by a frame (3,).

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


@dataclass(eq=False)
class Absence:
    """A robot that is lost, or that has found its place and is not yet sure of it.

    Attributes
    ----------
    known
        The frame that it was lost from. None if its place was found in the map of an earlier run.
    first, since
        First step in the local frame, and that of the first one of several local frames.
    believed
        Pose (3,) before step ``since`` in the known frame, as it was believed when the robot was lost.
    reason
        Why the robot is lost, in words.
    jump
        Standard deviation of the position at the beginning, m.
    covariance, left
        Covariance (3, 3) of the pose when it was lost, and that pose (3,).
    driven, moved, sought
        Distance since the robot was lost, m, the same with turns, and the latter at the latest search.
    gone
        Poses (3,) in the local frame of its first steps, as far as the steps themselves are no longer kept.
    is_dated, is_carried
        Whether the readings have said in which step the robot was carried away, and that it was.
    has_fitted
        Whether the readings since then have clearly fitted at any time: the robot may have drifted instead.
    place
        The map of the known frame; None if the place was found in the map of an earlier run.
    decisions
        All searches since the robot was lost the last time.
    placed, rays
        Distance at which the robot found its place, m, and the rays (n, 6) in the known frame by which it did so; None
        while it is lost.
    returned, is_far
        Step at which the robot found its place, and whether that is far from where it believed to be.
    has_drifted
        Whether it found its place so near that it has only drifted: its odometry holds for all its motions.
    is_astray
        Whether the pose where the local frame begins means nothing: it is that of a place that was found and was wrong.
    renewed
        The map of the known frame after a renewal, or a loop, that has found the robot's place; None otherwise.
    """

    known: KnownFrame | None
    first: int
    reason: str
    jump: float
    place: KnownPlaces | None
    covariance: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    left: FloatArray = field(default_factory=lambda: np.zeros(3))
    driven: float = 0.0
    moved: float = 0.0
    sought: float = 0.0
    gone: list[FloatArray] = field(default_factory=list)
    is_dated: bool = False
    is_carried: bool = False
    has_fitted: bool = False
    decisions: list[Localisation] = field(default_factory=list)
    placed: float | None = None
    rays: FloatArray | None = None
    returned: int = 0
    is_far: bool = False
    has_drifted: bool = False
    since: int = -1
    believed: FloatArray = field(default_factory=lambda: np.zeros(3))
    is_astray: bool = False
    renewed: KnownPlaces | None = None

    def __post_init__(self) -> None:
        self.since = self.first if self.since < 0 else self.since

    @property
    def is_placed(self) -> bool:
        """Whether the robot has found its place."""
        return self.placed is not None

    @property
    def is_unlikely(self) -> bool:
        """Whether the place is far, although no loop explains it and nothing says that the robot was carried away."""
        return self.is_far and self.renewed is None and not self.is_carried

    @property
    def was_moved(self) -> bool:
        """Whether something says that the robot has moved otherwise than its odometry reports."""
        return self.is_carried or self.jump > 0.0


class Placement(NamedTuple):
    """How a robot goes on in the frame that it was lost from.

    Attributes
    ----------
    step
        First step after the robot was carried away, of the steps that are kept.
    pose, covariance
        Its pose (3,) before that step, in the known frame, and the covariance (3, 3).
    rays
        The rays (n, 6) in the known frame by which it was placed.
    gone
        Pose (3,) and covariance (3, 3) in the known frame at each step before ``step`` since the robot was carried
        away, if it was lost for so long that the first of these steps are no longer kept; empty otherwise.
    frame, before
        Pose (3,) of the local frame in the known frame, and the local frame before ``step``, if there are ``gone``
        steps; None otherwise.
    has_drifted
        Whether the robot was not carried away, but has drifted.
    """

    step: int
    pose: FloatArray
    covariance: FloatArray
    rays: FloatArray
    gone: list[tuple[FloatArray, FloatArray]]
    frame: FloatArray
    before: KnownFrame | None
    has_drifted: bool = False

    def put(self, slam: LineSlam, grid: OccupancyGrid) -> tuple["Placement", KnownPlaces | None]:
        """Put the robot at its place in the known frame, with the local map of the steps that are no longer kept.

        Returns
        -------
        placement, closed
            The placement in the map as it is now, and this map, if the robot has drifted and has closed a loop by it.
            Otherwise the placement as it was, and None.
        """
        ends = wall_points(self.rays)
        if self.before is None or not slam.is_renewable:
            bent = slam.close(self.pose, self.covariance, ends) if self.has_drifted and slam.is_renewable else None
            if bent is not None:
                grid.bend(*bent)
                rays = moved(self.rays, compose(slam.pose, inverse(self.pose)))
                closed = KnownPlaces(slam.segments, grid.copied().view, slam.range_sensor)
                return self._replace(pose=slam.pose, rays=rays), closed
            if self.has_drifted:
                slam.shift(self.pose, self.covariance)
            else:
                slam.relocate(self.pose, self.covariance, ends=ends)
            return self, None
        slam.join(self.before.slam, self.frame, self.covariance, ends)
        grid.absorb(self.before.grid.view, self.frame)
        return self, None

    @property
    def carried_at(self) -> int:
        """First step after the robot was carried away."""
        return self.step - len(self.gone)
