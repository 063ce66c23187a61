"""How well the walls of a map stand at right angles, and whether laps coincide, for buildings that are known to be so.

``python -m benchmarks right-angles FOLDER...`` prints a line for each folder of a run or a replay. No truth is needed.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limslam_agent.output.finished_run import MAP, read_walls
from limslam_env.geometry import FloatArray

WITHIN = 2.0
"""Walls within this angle of a group belong to it, deg."""

_STEP = 0.1  # deg
_PARALLEL = 10.0  # deg
_APART = 0.3, 1.0  # m


@dataclass(frozen=True)
class RightAngles:
    """Directions of walls, weighted by their lengths.

    Attributes
    ----------
    walls, length
        Number of walls and their length together, m.
    in_groups
        Share of the length within 2 degrees of one of two groups of directions.
    between
        Angle between the two groups, deg: 90 in a building with right angles.
    doubled
        Share of the length that has a parallel wall 0.3 to 1 m beside it: a lap that does not coincide with another, or
        a recess of the building.
    """

    walls: int
    length: float
    in_groups: float
    between: float
    doubled: float

    @property
    def words(self) -> str:
        """One line for the screen."""
        return (
            f"{self.walls} walls of {self.length:.0f} m, {self.in_groups:.0%} within {WITHIN:g} deg of two directions "
            f"{self.between:.1f} deg apart, {self.doubled:.0%} with a parallel wall 0.3 to 1 m beside"
        )


def right_angles_of(folder: Path) -> RightAngles:
    """Measure the walls of the map of a run or a replay.

    Raises
    ------
    ValueError
        If the folder has no map, or one that is damaged or without walls.
    """
    walls = read_walls(folder / MAP)
    try:
        return right_angles(walls)
    except ValueError as error:
        raise ValueError(f"{folder / MAP}: {error}") from error


def right_angles(segments: FloatArray) -> RightAngles:
    """Measure walls (k, 4), m.

    The groups are the direction with the most wall within 2 degrees, and the direction with the most of the rest.

    Raises
    ------
    ValueError
        If there are no walls.
    """
    along = segments[:, 2:] - segments[:, :2]
    lengths = np.hypot(along[:, 0], along[:, 1])
    if not lengths.sum() > 0.0:
        raise ValueError("the map has no walls")
    degrees = np.degrees(np.arctan2(along[:, 1], along[:, 0])) % 180.0
    first = _densest(degrees, lengths)
    rest = _turn(degrees, first) > _PARALLEL
    second = _densest(degrees[rest], lengths[rest]) if rest.any() else first
    near = np.minimum(_turn(degrees, first), _turn(degrees, second)) <= WITHIN
    return RightAngles(
        walls=len(segments),
        length=float(lengths.sum()),
        in_groups=float(lengths[near].sum() / lengths.sum()),
        between=float(_turn(np.array([first]), second)[0]),
        doubled=float(sum(_doubled(each, segments) for each in segments) / lengths.sum()),
    )


def _turn(degrees: FloatArray, other: float) -> FloatArray:
    """Angles between lines, 0 to 90 deg."""
    return np.asarray(np.abs((degrees - other + 90.0) % 180.0 - 90.0))


def _densest(degrees: FloatArray, lengths: FloatArray) -> float:
    """The mean direction of the walls around the direction that has the most wall within 2 degrees."""
    grid = np.arange(0.0, 180.0, _STEP)
    within = np.array([lengths[_turn(degrees, each) <= WITHIN].sum() for each in grid])
    # The best directions are an interval around the group.
    first = int(np.argmax(within))
    others = np.flatnonzero(within[first:] < within[first])
    best = grid[first] + 0.5 * _STEP * ((others[0] if len(others) else len(grid) - first) - 1)
    near = _turn(degrees, best) <= WITHIN
    apart = (degrees[near] - best + 90.0) % 180.0 - 90.0
    return float((best + np.average(apart, weights=lengths[near])) % 180.0)


def _doubled(segment: FloatArray, others: FloatArray) -> float:
    """Length of a wall (4,), m, that has a parallel wall beside it, within the distances above."""
    length = float(np.hypot(*(segment[2:] - segment[:2])))
    if not length:
        return 0.0
    along = (segment[2:] - segment[:2]) / length
    normal = np.array([-along[1], along[0]])
    covered = np.zeros(max(1, round(length / 0.05)), dtype=np.bool_)
    places = (np.arange(len(covered)) + 0.5) * length / len(covered)
    for other in others:
        ends = other.reshape(2, 2) - segment[:2]
        across, ahead = (ends[1] - ends[0]) @ normal, (ends[1] - ends[0]) @ along
        parallel = abs(across) <= np.tan(np.radians(_PARALLEL)) * abs(ahead)
        if parallel and _APART[0] <= abs(float((ends @ normal).mean())) <= _APART[1]:
            low, high = np.sort(ends @ along)
            covered |= (places >= low) & (places <= high)
    return float(covered.mean() * length)


if __name__ == "__main__":
    sys.exit("the command is now: python -m benchmarks right-angles")
