"""The landmarks of the published method, without their lines: end points, and numbers of observations."""

from dataclasses import dataclass

import numpy as np

from limslam_agent.config.published import MapConfig
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import at, direction
from limslam_env.geometry.segment import lengths


@dataclass(frozen=True, eq=False)
class Landmark:
    """A landmark at one moment.

    Attributes
    ----------
    r, theta
        The line in the world, m and rad.
    covariance
        Of (r, theta), (2, 2).
    ends
        End points (2, 2), m.
    observations
        Number of observed lines that the landmark was estimated from.
    number
        Identifies the landmark; an older landmark has a smaller number.
    segments
        Which rows of the map's segments lie on this landmark. Empty for a provisional landmark.
    """

    r: float
    theta: float
    covariance: FloatArray
    ends: FloatArray
    observations: int
    number: int = 0
    segments: tuple[int, ...] = ()


class LineMap:
    """End points of the landmarks, by their index in the filter.

    End points are stored as points of the world, and projected on the line when they are requested, because every
    update changes the line.
    """

    def __init__(self) -> None:
        self._ends: list[FloatArray] = []
        self._observations: list[int] = []

    def observations(self, index: int) -> int:
        """Number of observed lines that a landmark was estimated from."""
        return self._observations[index]

    def confirmed(self, segments: FloatArray, config: MapConfig) -> IntArray:
        """Indices (k,) of the landmarks that are walls of the map, given all landmarks as segments (N, 4), m."""
        enough = np.array(self._observations, dtype=int) >= config.min_observations
        return np.nonzero(enough & (lengths(segments) >= config.min_length))[0]

    def add(self, ends: FloatArray) -> None:
        """Add a landmark with end points (2, 2), m."""
        self._ends.append(ends)
        self._observations.append(1)

    def grow(self, index: int, line: FloatArray, ends: FloatArray) -> None:
        """Extend landmark ``index``, which now lies on ``line``, to further end points (2, 2), m."""
        points = np.vstack((self._ends[index], ends))
        position = points @ direction(line)
        self._ends[index] = at(line, np.array([position.min(), position.max()]))
        self._observations[index] += 1

    def segments(self, lines: FloatArray) -> FloatArray:
        """The landmarks as segments (N, 4), m, with their end points projected on the lines (N, 2)."""
        if not self._ends:
            return np.zeros((0, 4))
        ends = np.array(self._ends)
        tangents = direction(lines)
        position = np.einsum("ned,nd->ne", ends, tangents)
        foot = lines[:, :1] * np.column_stack((np.cos(lines[:, 1]), np.sin(lines[:, 1])))
        return np.asarray(foot[:, None] + position[..., None] * tangents[:, None]).reshape(-1, 4)
