"""What is kept of a robot that is lost, or not yet sure of its place: its steps, and the frame from
before that.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, cast

import numpy as np

from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.places.localisation import KnownPlaces, PlaceSearch
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.slam import ConsistentEstimator
from limslam_agent.status.known_map import KnownMap
from limslam_agent.status.monitor import Loss, covariance_of_lost
from limslam_agent.status.rays import Sight, moved, step_rays, wall_points
from limslam_agent.status.sudden_changes import change_evidence
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import between, compose, compose_jacobians, inverse
from limslam_env.interface import Observation, RobotSpec

LEAST_KNOWN = 4.0
"""A robot that is lost from a map with a smaller length of walls, m, begins a new map.

Such a map is no loss, and the robot may never come back to its walls.
"""


def copied(observations: Sequence[Observation]) -> tuple[Observation, ...]:
    """Copies of the observations of a step, which their sender cannot change any more."""
    copies = ({name: np.array(value) for name, value in seen.items()} for seen in observations)
    return cast("tuple[Observation, ...]", tuple(copies))


@dataclass(eq=False)
class StepLog:
    """Consecutive steps of a robot. ``begin`` is the number of the first one that is kept."""

    begin: int = 0
    steps: list[Sight] = field(default_factory=list)

    @property
    def end(self) -> int:
        """Number of the next step."""
        return self.begin + len(self.steps)

    def __getitem__(self, number: int) -> Sight:
        return self.steps[number - self.begin]

    def since(self, number: int) -> list[Sight]:
        """The steps from a number on, as far as they are kept."""
        return self.steps[max(number - self.begin, 0) :]

    def before(self, number: int) -> list[Sight]:
        """The steps before a number, as far as they are kept."""
        return self.steps[: number - self.begin]

    def move(self, begin: int, poses: Sequence[FloatArray] | FloatArray) -> None:
        """Replace the poses of the steps from ``begin`` on by others (m, 3)."""
        for number, pose in enumerate(poses, begin - self.begin):
            self.steps[number] = self.steps[number]._replace(pose=pose)

    def forget_before(self, number: int) -> None:
        """Remove the steps before a number.

        The last two steps always stay: a local frame begins at the pose after the first one kept,
        with the step after.
        """
        gone = max(min(number, self.end - 2) - self.begin, 0)
        self.steps, self.begin = self.steps[gone:], self.begin + gone

    def driven_back(self, pose: FloatArray, number: int) -> FloatArray:
        """Poses (m, 3) after each step from the first one kept to the one before ``number``, by the
        odometry alone.

        The last of them is ``pose`` (3,).
        """
        poses = [pose]
        for step in reversed(self.steps[1 : number - self.begin]):
            poses.append(compose(poses[-1], inverse(step.motion)))
        return np.array(poses[::-1])


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
        return KnownPlaces(self.slam.segments, self.grid.view, self.slam.sensor)

    def explains(self, frame: FloatArray, covariance: FloatArray, rays: FloatArray) -> bool:
        """Whether the covariance of the estimate explains that rays (n, 7) have moved it by a frame
        (3,).

        ``covariance`` (3, 3) is that of the match.
        """
        pose = compose(frame, self.slam.pose)
        return self.slam.map_state.closed(pose, covariance, wall_points(rays)) is not None

    def copied(self) -> tuple[ConsistentEstimator, OccupancyGrid]:
        """SLAM and grid to go on with."""
        return self.slam.copied(), self.grid.copied()


def known_before(copies: Sequence[KnownFrame], first: int, margin: int) -> KnownFrame | None:
    """The latest copy of an estimate that is older than the step ``first`` by a margin; None
    without a copy.

    If that copy has hardly a wall, because the drive has just begun, it is a later one from before
    the step.
    """
    old = [copy for copy in copies if copy.step <= first - margin] or copies[:1]
    if old and old[-1].walls_m >= LEAST_KNOWN:
        return old[-1]
    found = [copy for copy in copies if copy.step < first] or old
    return found[-1] if found else None


class Placed(NamedTuple):
    """A place that was found and has to be confirmed."""

    at: float  # distance since the robot was lost at which it found its place, m
    rays: FloatArray  # the rays (n, 7) in the map by which it did so
    # The map in which the readings have to fit; None if it is the map in which the robot goes on
    place: KnownPlaces | None
    has_drifted: bool = (
        False  # whether the robot was not carried away, but has drifted, and is near
    )
    has_slipped: bool = (
        False  # whether it is not where its odometry says, and its covariance does not explain that
    )


@dataclass(eq=False)
class Absence:
    """A robot that is lost, or that has found its place and is not yet sure of it.

    Attributes
    ----------
    loss
        Why the robot was lost at first, or is unsure of its place, and whether the readings said in
        which step.
    first, since
        First step in the local frame, and that of the first one of several local frames.
    search
        The search of the map that the robot was lost from, or in which its place was found.
    known
        The frame that the robot was lost from. None if the robot is in the map of an earlier run,
        or has begun its map anew.
    steps
        The steps before ``since`` as they were believed when the robot was lost.
    is_carried
        Whether the readings have said that the robot was carried away, at first or later in a local
        frame.
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
    search: PlaceSearch
    known: KnownFrame | None = None
    steps: Sequence[Sight] = ()
    is_carried: bool = False
    jump: float = 0.0
    covariance: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    left: FloatArray = field(default_factory=lambda: np.zeros(3))
    driven: float = 0.0
    placed: Placed | None = None
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

    def put(
        self, slam: ConsistentEstimator, grid: OccupancyGrid
    ) -> tuple["Placement", KnownPlaces | None]:
        """Put the robot at its place in the known frame, and close a loop by it if it has drifted.

        Returns
        -------
        placement, closed
            The placement in the map as it is now, and this map, if a loop was closed. Otherwise the
            placement as it was, and None.
        """
        ends = wall_points(self.rays)
        bent = slam.close(self.pose, self.covariance, ends) if self.has_drifted else None
        if bent is None:
            slam.relocate(self.pose, self.covariance, ends=ends)
            return self, None
        grid.bend(*bent)
        rays = moved(self.rays, compose(slam.pose, inverse(self.pose)))
        closed = KnownPlaces(slam.segments, grid.copied().view, slam.sensor)
        return self._replace(pose=slam.pose, rays=rays), closed


def carried_at(
    log: StepLog, placed: FloatArray, robot: RobotSpec, sensor: RangeSensor, place: KnownMap
) -> int:
    """The first step after a robot was carried away: earlier readings fit the poses that were
    believed, later ones fit the poses by which it was placed again.

    Both are weighed by the evidence of the readings in the map, which is 0 on ground that the map
    does not have. There, no reading contradicts anything, and a step would be taken for one of the
    new place if only contradictions counted. The evidence of the change of the readings at the
    break counts, too.

    Parameters
    ----------
    log
        The steps. The robot was carried away after the first of them, and before the step after the
        last placed one.
    placed
        Poses (m, 3) of the first m steps of the log if the robot had been carried away before them.
    robot, sensor
        Body and beams as specified, and how ranges are measured.
    place
        The map of the time before.
    """
    steps = log.steps[: len(placed)]
    mounted = sensor.mounted(robot)
    # The steps before the break are explained by the poses that were believed, and the others by
    # the placed ones.
    gained = [
        here.evidence - there.evidence
        for step, pose in zip(steps, placed, strict=True)
        for here, there in [
            place.weigh(
                np.array([step.pose, pose]),
                step_rays(sensor.corrected(step.ranges, robot), mounted),
            )
        ]
    ]
    totals = np.cumsum(gained)
    changing = log.steps[: len(placed) + 1]
    changes = change_evidence(
        np.array([step.ranges for step in changing]),
        np.array([step.motion for step in changing]),
        robot,
        sensor,
    ).sum(axis=1)
    totals[1 : 1 + len(changes)] += changes
    # Of equally good steps, the last one is the nearest to the first doubt.
    return log.begin + len(totals) - int(totals[::-1].argmax())
