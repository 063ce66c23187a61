"""What becomes known about earlier steps of a robot that was lost: their poses, or that their place is unknown."""

from collections.abc import Sequence
from dataclasses import dataclass

from limslam_agent.grid.occupancy import GridView
from limslam_agent.slam.core.line_map import Landmark
from limslam_env.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class Revision:
    """Poses of a robot as they became known when it had found its place.

    Attributes
    ----------
    begin
        Number of the first step.
    poses, covariances
        Poses (m, 3), m and rad, and covariances (m, 3, 3).
    """

    begin: int
    poses: FloatArray
    covariances: FloatArray


@dataclass(frozen=True, eq=False)
class Unplaced:
    """The map of a robot that was still lost at the end, in its local frame.

    Attributes
    ----------
    begin
        Number of the step since which the robot's place is unknown.
    segments, landmarks
        Walls (k, 4), m, and the lines that they lie on.
    grid
        Occupancy grid.
    """

    begin: int
    segments: FloatArray
    landmarks: list[Landmark]
    grid: GridView


def revised(poses: FloatArray, covariances: FloatArray, revisions: Sequence[Revision]) -> tuple[FloatArray, FloatArray]:
    """The poses (t, n, 3) of a run of one robot as they are known at the end, with covariances (t, n, 3, 3).

    While the robot was lost, its poses were in a local frame.
    """
    poses, covariances = poses.copy(), covariances.copy()
    for revision in revisions:
        rows = slice(revision.begin, revision.begin + len(revision.poses))
        poses[rows, 0], covariances[rows, 0] = revision.poses, revision.covariances
    return poses, covariances
