"""Diagnostics: what an estimator reports about its stages, for pictures and for scores."""

import math
from dataclasses import dataclass
from functools import cached_property

from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import to_frame
from limslam_env.geometry.se2 import inverse, transform_points
from limslam_env.interface import Side


@dataclass(frozen=True, eq=False)
class AssociationRecord:
    """Association of one observed line with a landmark.

    Attributes
    ----------
    landmark
        Number of the landmark.
    is_new
        Whether the observation created the landmark.
    readings
        Step and beam of each of the line's points (n, 2).
    robot
        Which robot made the observation.
    """

    landmark: int
    is_new: bool
    readings: IntArray
    robot: int = 0


@dataclass(frozen=True)
class CandidateTest:
    """A landmark that an observed line was compared with.

    Attributes
    ----------
    landmark
        Number of the landmark.
    excluded
        The test that threw the landmark out: ``"direction"``, ``"offset"``, ``"ends"``,
        ``"range"``, ``"hidden"`` (the beams cannot see it), ``"beams"`` (the readings cannot show
        it, for example because too few beams meet it at a sufficient angle) or ``"gate"``. Empty if
        none did.
    angle, offset, gap
        Difference of direction, rad, offset across the landmark, m, and gap along it, m. A negative
        gap is an overlap.
    distance
        Squared Mahalanobis distance. NaN if the landmark was thrown out before.
    """

    landmark: int
    excluded: str
    angle: float
    offset: float
    gap: float
    distance: float = math.nan


@dataclass(frozen=True, eq=False)
class Comparison:
    """An observed line, before it is used, and all landmarks that it was compared with.

    Attributes
    ----------
    robot, step
        The robot, and the step at which the line is used.
    ends
        End points (2, 2), m, in the world.
    readings
        Step and beam of each of the line's points (n, 2).
    tests
        The landmarks.
    """

    robot: int
    step: int
    ends: FloatArray
    readings: IntArray
    tests: tuple[CandidateTest, ...]


@dataclass(frozen=True, eq=False)
class Extraction:
    """The lines that were found in one scan.

    Attributes
    ----------
    robot, side, step
        The robot, side and step of the scan.
    pose
        Estimated pose of the robot (3,), m, m, rad.
    scan, found, found_ends
        The scan (n, 2), m, its lines (k, 2) as (r, theta), m and rad, and their end points (k, 2,
        2), m.
    is_in_world
        Whether scan and lines are in the world, and not in the robot's frame.
    """

    robot: int
    side: Side
    step: int
    pose: FloatArray
    scan: FloatArray
    found: FloatArray
    found_ends: FloatArray
    is_in_world: bool = False

    # Most extractions are never looked at, so that they are taken into the robot's frame only when
    # they are.
    @cached_property
    def points(self) -> FloatArray:
        """The scan (n, 2), m, in the robot's frame."""
        return transform_points(inverse(self.pose), self.scan) if self.is_in_world else self.scan

    @cached_property
    def lines(self) -> FloatArray:
        """The lines (k, 2) as (r, theta) in the robot's frame, m and rad."""
        return to_frame(self.found, self.pose) if self.is_in_world else self.found

    @cached_property
    def ends(self) -> FloatArray:
        """The end points (k, 2, 2) of the lines in the robot's frame, m."""
        ends = self.found_ends
        return (
            transform_points(inverse(self.pose), ends.reshape(-1, 2)).reshape(-1, 2, 2)
            if self.is_in_world
            else ends
        )


@dataclass(frozen=True, eq=False)
class PendingPoints:
    """Points that are pending: no line has been extracted from them yet.

    Attributes
    ----------
    robot, side
        The robot and side of the points.
    points
        (n, 2), m, in the world.
    enough
        Number of new points at which lines are extracted.
    new
        Number of points that are new since the last extraction. None if no point outlives an
        extraction.
    """

    robot: int
    side: Side
    points: FloatArray
    enough: int
    new: int | None = None


@dataclass(frozen=True)
class Closure:
    """A loop closure: two landmarks that were found to be one wall.

    Attributes
    ----------
    older, younger
        Numbers of the landmarks.
    step
        Step of the closure.
    distance_before, distance_after
        Squared Mahalanobis distance between the two, before and after the whole state was
        corrected.
    offset_before, offset_after
        Distance of the younger landmark's middle from the older one's line, before and after, m.
    """

    older: int
    younger: int
    step: int
    distance_before: float
    distance_after: float
    offset_before: float
    offset_after: float
