"""Line extraction from points: the Hough transform finds lines, and total least squares refines them."""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from limslam_agent.config.shared import HoughConfig
from limslam_agent.slam.core.line_fit import LineFit, fit_line
from limslam_env.geometry import FloatArray, IntArray

MAX_CANDIDATES = 200
"""Largest number of lines that the Hough transform returns."""


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


def hough_votes(points: FloatArray, config: HoughConfig, std: float) -> FloatArray:
    """Lines (r, theta) with enough votes, best first (R. Duda and P. Hart, "Use of the Hough transformation", 1972).

    Parameters
    ----------
    points
        (n, 2), m.
    config
        Bins and threshold.
    std
        Standard deviation of the points' distances from their wall, m.

    Returns
    -------
    lines
        (k, 3): votes, r (m, may be negative), theta in [0, pi).
    """
    reach = float(np.linalg.norm(points, axis=1).max()) if len(points) else 0.0
    step = bin_size(config, std)
    # OpenCV returns None if there is no line, which its type annotations do not say.
    found: Any = cv2.HoughLinesPointSet(
        points.astype(np.float32).reshape(-1, 1, 2),
        lines_max=MAX_CANDIDATES,
        threshold=config.min_votes - 1,  # OpenCV returns lines with more votes than this
        min_rho=-reach - step,
        max_rho=reach + step,
        rho_step=step,
        min_theta=0.0,
        max_theta=math.pi,
        theta_step=config.theta_step,
    )
    if found is None:
        return np.zeros((0, 3))
    lines = np.asarray(found, dtype=float).reshape(-1, 3)
    return lines[np.argsort(-lines[:, 0], kind="stable")]


def extract_lines(points: FloatArray, config: HoughConfig, std: float) -> list[ExtractedLine]:
    """All lines in a buffer of points (n, 2), m, whose ranges have noise ``std`` (m), best first.

    Each point belongs to at most one line. The points of a line are removed, and the remaining points of a weaker
    candidate must still pass the threshold. So one wall cannot appear twice, neither in neighbouring bins nor across
    theta = 0, where (r, theta) and (-r, theta + pi) are the same line.
    """
    if len(points) < config.min_votes:
        return []
    from limslam_agent.kernels.lines import find_lines

    # Votes are counted relative to the points' centre, where r and theta are nearly independent.
    candidates = np.ascontiguousarray(hough_votes(points - points.mean(axis=0), config, std)[:, 1:])
    limits = bin_size(config, std), max_distance(config, std)
    gap, least = float(config.max_gap), float(config.min_length)
    owner, listed = np.empty(len(points), dtype=np.int64), np.empty(len(points), dtype=np.int64)
    most = len(points) // config.min_votes + 1
    scratch = np.empty((most, 2)), np.empty((most, 2, 2))
    number = find_lines(
        points, candidates, limits, config.min_votes, gap, least, config.only_best, owner, listed, *scratch
    )
    ends = np.cumsum(np.bincount(owner + 1, minlength=number + 1)[1:]).tolist()
    parts = [listed[first:last] for first, last in zip([0, *ends[:-1]], ends, strict=True)] if number else []
    return [ExtractedLine(fit_line(points[part], std), part) for part in parts]
