"""The series of a job, read from its folder of results."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.suite.store import Row, series_path
from limslam_agent.safe_files import load_arrays
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import wrap_angle

_WIDTHS = {
    "time": None, "coverage": None, "true": 3, "estimated": 3, "odometry": 3, "sigma": 3, "segments": 4, "edges": 4
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Series:
    """The arrays of a job for plots. Poses are in the world frame, m and rad.

    Attributes
    ----------
    time, coverage
        Times (k,), s, and coverage (k,), 0 to 1.
    true, estimated, odometry
        Poses (k, n, 3) of n robots: the true ones, the estimate, and odometry alone.
    sigma
        Standard deviations of the estimate (k, n, 3).
    segments, edges
        Wall segments (m, 4) of the map, and true walls (w, 4), m.
    """

    time: FloatArray
    coverage: FloatArray
    true: FloatArray
    estimated: FloatArray
    odometry: FloatArray
    sigma: FloatArray
    segments: FloatArray
    edges: FloatArray

    def errors(self, poses: FloatArray) -> FloatArray:
        """Errors (k, n, 3) in x, y and heading of poses (k, n, 3), m and rad."""
        errors = poses - self.true
        errors[..., 2] = wrap_angle(errors[..., 2])
        return np.asarray(errors)

    @property
    def distance(self) -> FloatArray:
        """Distance (k,) driven by the first robot on its true path, m."""
        steps = np.linalg.norm(np.diff(self.true[:, 0, :2], axis=0), axis=1)
        return np.concatenate(([0.0], np.cumsum(steps)))


def read_series(folder: Path, row: Row) -> Series | None:
    """The series of a row; None if the row has no series.

    Raises
    ------
    ValueError
        If its file is missing or damaged, or does not lie in the folder; the message names it.
    """
    if row.series is None:
        return None
    path = series_path(folder, row.series)
    try:
        arrays = {name: np.asarray(each, dtype=float) for name, each in load_arrays(path, frozenset(_WIDTHS)).items()}
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: is damaged: {error}") from error
    if missing := [name for name in _WIDTHS if name not in arrays]:
        raise ValueError(f"{path}: lacks {', '.join(missing)}")
    for name, width in _WIDTHS.items():
        if width is not None and arrays[name].shape[-1:] != (width,):
            raise ValueError(f"{path}: {name} must have {width} columns, not shape {arrays[name].shape}")
    return Series(**arrays)
