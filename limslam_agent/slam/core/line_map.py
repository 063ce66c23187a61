"""What the map knows of its landmarks besides the filter's state: end points and how often they were seen."""

from dataclasses import dataclass

import numpy as np

from limslam_agent.config.published import MapConfig
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import at, direction
from limslam_env.geometry.segment import lengths


@dataclass(frozen=True, eq=False)
class Landmark:
    """A wall of the map, as a snapshot.

    Attributes
    ----------
    r, theta
        The line in the world, m and rad.
    covariance
        Of (r, theta), (2, 2).
    ends
        End points (2, 2), m.
    observations
        How many observed lines it was made of.
    number
        Which landmark of the filter it is: the older, the smaller.
    """

    r: float
    theta: float
    covariance: FloatArray
    ends: FloatArray
    observations: int
    number: int = 0


class LineMap:
    """End points of the landmarks, by their index in the filter.

    End points are kept as points of the world and put on the line when asked for: the line
    moves with every update, and they move with it.
    """

    def __init__(self) -> None:
        self._ends: list[FloatArray] = []
        self._observations: list[int] = []

    def __len__(self) -> int:
        return len(self._ends)

    def observations(self, index: int) -> int:
        """How many observed lines a landmark was made of."""
        return self._observations[index]

    def confirmed(self, segments: FloatArray, config: MapConfig) -> IntArray:
        """Landmarks (k,) that are walls of the map by now, given all of them as segments (N, 4), m."""
        enough = np.array(self._observations, dtype=int) >= config.min_observations
        return np.nonzero(enough & (lengths(segments) >= config.min_length))[0]

    def add(self, ends: FloatArray) -> None:
        """A new landmark with end points (2, 2), m."""
        self._ends.append(ends)
        self._observations.append(1)

    def grow(self, index: int, line: FloatArray, ends: FloatArray) -> None:
        """Let landmark ``index``, now on ``line``, reach over further end points (2, 2)."""
        points = np.vstack((self._ends[index], ends))
        position = points @ direction(line)
        self._ends[index] = at(line, np.array([position.min(), position.max()]))
        self._observations[index] += 1

    def segments(self, lines: FloatArray) -> FloatArray:
        """The landmarks with their end points on the lines (N, 2), as (N, 4), m."""
        if not self._ends:
            return np.zeros((0, 4))
        ends = np.array(self._ends)
        tangents = direction(lines)
        position = np.einsum("ned,nd->ne", ends, tangents)
        foot = lines[:, :1] * np.column_stack((np.cos(lines[:, 1]), np.sin(lines[:, 1])))
        return np.asarray(foot[:, None] + position[..., None] * tangents[:, None]).reshape(-1, 4)
