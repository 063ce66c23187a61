"""Line extraction from a buffer of points: the Hough transform finds lines, and total least squares refines them."""

from dataclasses import dataclass

import numpy as np

from limslam_agent.config.shared import HoughConfig
from limslam_agent.slam.core.line_fit import LineFit, fit_line
from limslam_env.geometry import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class ExtractedLine:
    """A line segment that was found in a buffer of points.

    Attributes
    ----------
    fit
        The line with covariance and ends.
    members
        Indices (n,) of its points in the buffer.
    """

    fit: LineFit
    members: IntArray


def bin_size(config: HoughConfig, std: float) -> float:
    """Size of a bin of r, m, for points with noise ``std``, m."""
    return max(config.r_step, 3.0 * std)


def max_distance(config: HoughConfig, std: float) -> float:
    """Largest distance of a point from its line, m, for points with noise ``std``, m."""
    return max(config.max_offset, 2.5 * std)


def extract_lines(points: FloatArray, config: HoughConfig, std: float) -> list[ExtractedLine]:
    """All lines in a buffer of points (n, 2), m, whose ranges have noise ``std`` (m), best first."""
    from limslam_agent.kernels import lines

    owner, found, _ = lines.extract_lines(
        points, float(config.max_gap), config.min_votes, float(bin_size(config, std)), float(config.theta_step),
        float(max_distance(config, std)), float(config.min_length), config.only_best,
    )  # fmt: skip
    parts = [np.flatnonzero(owner == line) for line in range(len(found))]
    return [ExtractedLine(fit_line(points[part], std), part) for part in parts]
