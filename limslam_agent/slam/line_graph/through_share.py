"""A consistency check without ground truth: the share of beams that pass through walls of the map.

Consider a beam that should end at a wall, well inside the ends of the wall. If its reading is much longer than
expected, the beam contradicts the map. In a correct map nearly no beam does so. The share of such beams over the last
metres rises soon after an estimate has become wrong.
"""

from dataclasses import dataclass

import numpy as np

from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.interface import RobotSpec

INSET = 0.10
"""A wall counts only if the beam crosses it at least this far inside its ends, m."""
SLACK = 0.10
"""A beam has passed through a wall if its reading exceeds the expected range by this, m, plus three standard
deviations."""
WINDOW, FEWEST = 5.0, 30
"""Length of the window, m of driving, and the fewest beams in the window that give a share."""

_SIGMAS = 3.0
_LEAST_COSINE = 0.35
_PARALLEL = 0.2


@dataclass(frozen=True, eq=False)
class Looks:
    """The comparison of the beams of one step with the walls of the map.

    Attributes
    ----------
    expected
        Number of beams that should have ended at a wall.
    through
        Number of these beams that passed through the wall.
    """

    expected: int
    through: int


def compare_with_walls(
    robot: RobotSpec,
    pose: FloatArray,
    covariance: FloatArray,
    ranges: FloatArray,
    measured: BoolArray,
    segments: FloatArray,
    range_std: float,
) -> Looks:
    """Compare the readings of one step with the walls of the map.

    Parameters
    ----------
    pose, covariance
        Estimated pose (3,), m and rad, and its covariance (3, 3).
    ranges, measured
        Readings (n_beams,), m, and a mask of the new readings.
    segments
        Walls (k, 4), m.
    range_std
        Standard deviation of a range, m.
    """
    beams = np.flatnonzero(measured & (ranges > robot.too_near))
    if not len(beams) or not len(segments):
        return Looks(0, 0)
    distances, cosines = _first_walls(robot, pose, beams, segments)
    is_expected = np.isfinite(distances) & (cosines > _LEAST_COSINE)
    reach = np.minimum(ranges[beams], robot.max_ranges[beams])
    distances, cosines, reach = distances[is_expected], cosines[is_expected], reach[is_expected]
    is_near = distances < robot.max_ranges[beams][is_expected]
    variance = range_std**2 + covariance[0, 0] + covariance[1, 1] + covariance[2, 2] * distances**2
    went = reach > distances + _SIGMAS * np.sqrt(variance) / cosines + SLACK
    return Looks(int(np.count_nonzero(is_near)), int(np.count_nonzero(went & is_near)))


def through_share(looks: list[Looks], driven: FloatArray, window: float = WINDOW) -> float:
    """Share of the beams that passed through walls over the last metres; 0 where there are too few beams.

    Parameters
    ----------
    looks
        The comparison of each step.
    driven
        Distance driven by the robot up to each step (n,), m.
    """
    first = int(np.searchsorted(driven, driven[-1] - window))
    expected = sum(each.expected for each in looks[first:])
    return sum(each.through for each in looks[first:]) / expected if expected >= FEWEST else 0.0


def _first_walls(
    robot: RobotSpec, pose: FloatArray, beams: IntArray, segments: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """For each beam (k,), the distance to the first wall that it crosses inside the wall's ends, m, and the cosine.

    The distance is infinite if there is no such wall.
    """
    origins = transform_points(pose, robot.beam_origins[beams])
    headings = pose[2] + robot.beam_angles[beams]
    towards = np.column_stack((np.cos(headings), np.sin(headings)))
    spans = segments[:, 2:] - segments[:, :2]
    sizes = np.hypot(spans[:, 0], spans[:, 1])
    tangents = spans / sizes[:, None]
    normals = np.column_stack((-tangents[:, 1], tangents[:, 0]))
    cosines = towards @ normals.T
    with np.errstate(divide="ignore", invalid="ignore"):
        distances = (np.sum(segments[:, :2] * normals, axis=1) - origins @ normals.T) / cosines
    distances = np.where(np.abs(cosines) > _PARALLEL, distances, np.inf)
    finite = np.where(np.isfinite(distances), distances, 0.0)
    hits = origins[:, None] + finite[..., None] * towards[:, None]
    along = np.sum((hits - segments[:, :2]) * tangents, axis=-1)
    is_inside = (distances > 0.0) & (along > INSET) & (along < sizes - INSET)
    distances = np.where(is_inside, distances, np.inf)
    first = distances.argmin(axis=1)
    rows = np.arange(len(beams))
    return distances[rows, first], np.abs(cosines[rows, first])
