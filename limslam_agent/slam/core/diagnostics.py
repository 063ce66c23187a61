"""What an estimator notes down for those who watch or score it."""

from dataclasses import dataclass

from limslam_env.geometry import FloatArray, IntArray
from limslam_env.interface import Side


@dataclass(frozen=True, eq=False)
class AssociationRecord:
    """What became of one observed line.

    Attributes
    ----------
    landmark
        The landmark that it was taken for, or that it became.
    is_new
        Whether it became a new landmark.
    readings
        (n, 2): step and beam of each point on it.
    robot
        Whose readings they are.
    """

    landmark: int
    is_new: bool
    readings: IntArray
    robot: int = 0


@dataclass(frozen=True, eq=False)
class Extraction:
    """The lines that were found in one scan.

    Attributes
    ----------
    robot, side, step
        Whose scan it was, of which side, and when.
    pose
        Where the robot believed to be (3,).
    points
        The scan (n, 2), m, in the robot's frame.
    lines, ends
        What was found in it (k, 2): r and theta, in the robot's frame, and the end points (k, 2, 2), m.
    """

    robot: int
    side: Side
    step: int
    pose: FloatArray
    points: FloatArray
    lines: FloatArray
    ends: FloatArray


@dataclass(frozen=True, eq=False)
class Waiting:
    """Points that wait to become lines.

    Attributes
    ----------
    robot, side
        Whose points they are, of which side.
    points
        (n, 2), m, in the world.
    enough
        At so many of them lines are looked for.
    """

    robot: int
    side: Side
    points: FloatArray
    enough: int


@dataclass(frozen=True)
class Closure:
    """Two landmarks that were taken for one wall.

    Attributes
    ----------
    older, younger
        The landmarks.
    step
        When it happened.
    distance_before, distance_after
        Squared Mahalanobis distance between the two, before and after the whole state was corrected.
    offset_before, offset_after
        How far apart they were, m: the middle of the younger from the older's line.
    """

    older: int
    younger: int
    step: int
    distance_before: float
    distance_after: float
    offset_before: float
    offset_after: float
