"""Landmarks as the estimators hand them on, and the end points of lines in a filter."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from limslam_agent.config.published import MapConfig
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import at, direction, normal
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


class LineBelief(Protocol):
    """A filter with lines (N, 2) as (r, theta)."""

    @property
    def lines(self) -> FloatArray:
        """The lines (N, 2)."""

    def line_covariance(self, index: int) -> FloatArray:
        """Covariance of one line (2, 2)."""


class EndPoints:
    """End points of the lines in a filter, which are no part of its state.

    They are points of the world, which :meth:`redraw` projects on the lines: every update changes
    these. A landmark with too few observations, or too short, is provisional: no map shows it.
    """

    def __init__(self, belief: LineBelief, config: MapConfig) -> None:
        self._belief = belief
        self._config = config
        self._ends = np.empty((0, 2, 2))
        self._observations = np.empty(0, dtype=np.int64)
        self.redraw()

    def add(self, ends: FloatArray) -> None:
        """Add the line that the filter has added, with end points (2, 2), m."""
        self._ends = np.concatenate((self._ends, ends[None]))
        self._observations = np.append(self._observations, 1)
        self.redraw()

    def grow(self, index: int, ends: FloatArray) -> None:
        """Extend a line to further end points (2, 2), m."""
        line = self._belief.lines[index]
        along = np.vstack((self._ends[index], ends)) @ direction(line)
        self._ends[index] = at(line, np.array([along.min(), along.max()]))
        self._observations[index] += 1
        self.redraw()

    def redraw(self) -> None:
        """Project the end points on their lines."""
        lines = self._belief.lines
        tangents = direction(lines)
        along = np.einsum("ned,nd->ne", self._ends, tangents)
        feet = lines[:, :1] * normal(lines)
        self.every = np.reshape(feet[:, None] + along[..., None] * tangents[:, None], (-1, 4))
        is_shown = self._observations >= self._config.min_observations
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
        rows = zip(self._belief.lines.tolist(), self.every, self._observations, strict=True)
        return [
            Landmark(
                r,
                theta,
                self._belief.line_covariance(index),
                ends.reshape(2, 2).copy(),
                int(count),
                index,
            )
            for index, ((r, theta), ends, count) in enumerate(rows)
        ]
