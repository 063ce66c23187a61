"""The landmarks of the published method, without their lines: end points, and numbers of
observations.
"""

from dataclasses import replace

import numpy as np

from limslam_agent.config.published import MapConfig
from limslam_agent.slam.core.ekf import LineEKF
from limslam_agent.slam.core.line_map import Landmark
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import at, direction
from limslam_env.geometry.segment import lengths


class LineMap:
    """End points of the landmarks, by their index in the filter, which holds the lines.

    End points are stored as points of the world, and projected on the line when they are requested,
    because every update changes the line. Whoever changes lines calls :meth:`redraw`, since every
    step asks for the map.
    """

    def __init__(self, belief: LineEKF, config: MapConfig) -> None:
        self._belief = belief
        self._config = config
        self._ends: list[FloatArray] = []
        self._observations: list[int] = []
        self.redraw()

    def add(self, ends: FloatArray) -> None:
        """Add the landmark that the filter has added, with end points (2, 2), m."""
        self._ends.append(ends)
        self._observations.append(1)
        self.redraw()

    def grow(self, index: int, ends: FloatArray) -> None:
        """Extend a landmark to further end points (2, 2), m."""
        line = self._belief.lines[index]
        position = np.vstack((self._ends[index], ends)) @ direction(line)
        self._ends[index] = at(line, np.array([position.min(), position.max()]))
        self._observations[index] += 1
        self.redraw()

    def redraw(self) -> None:
        """Project the landmarks on their lines, and find those that are walls of the map."""
        lines = self._belief.lines
        ends = np.array(self._ends).reshape(-1, 2, 2)
        tangents = direction(lines)
        position = np.einsum("ned,nd->ne", ends, tangents)
        foot = lines[:, :1] * np.column_stack((np.cos(lines[:, 1]), np.sin(lines[:, 1])))
        self.every = np.asarray(foot[:, None] + position[..., None] * tangents[:, None]).reshape(
            -1, 4
        )
        is_shown = np.array(self._observations, dtype=int) >= self._config.min_observations
        self._shown = np.flatnonzero(is_shown & (lengths(self.every) >= self._config.min_length))

    @property
    def segments(self) -> FloatArray:
        """The walls of the map (N, 4), m. A copy."""
        return np.asarray(self.every[self._shown])

    @property
    def landmarks(self) -> list[Landmark]:
        """The landmarks that are walls of the map."""
        marks = self.all_landmarks
        return [
            replace(marks[index], segments=(row,)) for row, index in enumerate(self._shown.tolist())
        ]

    @property
    def all_landmarks(self) -> list[Landmark]:
        """All landmarks, provisional ones included, by number."""
        return [
            Landmark(
                r,
                theta,
                self._belief.line_covariance(index),
                ends.reshape(2, 2).copy(),
                count,
                index,
            )
            for index, ((r, theta), ends, count) in enumerate(
                zip(self._belief.lines.tolist(), self.every, self._observations, strict=True)
            )
        ]
