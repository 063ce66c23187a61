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


def hough_votes(points: FloatArray, min_votes: int, r_step: float, theta_step: float) -> FloatArray:
    """Lines (r, theta) with enough votes, best first (R. Duda and P. Hart, "Use of the Hough transformation", 1972).

    Parameters
    ----------
    points
        (n, 2), m.
    min_votes, r_step, theta_step
        Threshold, and sizes of the bins, m and rad.

    Returns
    -------
    lines
        (k, 3): votes, r (m, may be negative), theta in [0, pi).
    """
    reach = float(np.linalg.norm(points, axis=1).max()) if len(points) else 0.0
    # OpenCV returns None if there is no line, which its type annotations do not say.
    found: Any = cv2.HoughLinesPointSet(
        points.astype(np.float32).reshape(-1, 1, 2),
        lines_max=MAX_CANDIDATES,
        threshold=min_votes - 1,  # OpenCV returns lines with more votes than this
        min_rho=-reach - r_step,
        max_rho=reach + r_step,
        rho_step=r_step,
        min_theta=0.0,
        max_theta=math.pi,
        theta_step=theta_step,
    )
    if found is None:
        return np.zeros((0, 3))
    lines = np.asarray(found, dtype=float).reshape(-1, 3)
    return lines[np.argsort(-lines[:, 0], kind="stable")]


def line_parts(
    points: FloatArray, max_gap: float, min_votes: int, r_step: float, theta_step: float, near_line: float,
    least: float, only_best: bool,
) -> tuple[IntArray, FloatArray, FloatArray]:  # fmt: skip
    """The lines in a buffer of points (n, 2), m, best first, cut at gaps.

    Each point belongs to at most one line. The points of a line are removed, and the remaining points of a weaker
    candidate must still pass the threshold. So one wall cannot appear twice, neither in neighbouring bins nor across
    theta = 0, where (r, theta) and (-r, theta + pi) are the same line.

    Parameters
    ----------
    max_gap, near_line, least
        Longest gap in a line, largest distance of a point from its line, and least length of a line, m.
    min_votes, r_step, theta_step
        As of :func:`hough_votes`.
    only_best
        Whether to stop after the first candidate that has lines.

    Returns
    -------
    owner, lines, ends
        The line of each point (n,), -1 for none, the lines (k, 2) as (r, theta), and their end points (k, 2, 2), m.
    """
    owner = np.full(len(points), -1)
    if len(points) < min_votes:
        return owner, np.zeros((0, 2)), np.zeros((0, 2, 2))
    from limslam_agent.kernels.lines import find_lines

    # Votes are counted relative to the points' centre, where r and theta are nearly independent.
    votes = hough_votes(points - points.mean(axis=0), min_votes, r_step, theta_step)
    candidates, most = np.ascontiguousarray(votes[:, 1:]), len(points) // min_votes + 1
    lines, ends = np.empty((most, 2)), np.empty((most, 2, 2))
    limits = float(r_step), float(near_line)
    number = find_lines(
        points, candidates, limits, min_votes, float(max_gap), float(least), only_best, owner, lines, ends
    )
    return owner, lines[:number], ends[:number]


def extract_lines(points: FloatArray, config: HoughConfig, std: float) -> list[ExtractedLine]:
    """All lines in a buffer of points (n, 2), m, whose ranges have noise ``std`` (m), best first."""
    owner, lines, _ = line_parts(
        points, config.max_gap, config.min_votes, bin_size(config, std), config.theta_step, max_distance(config, std),
        config.min_length, config.only_best,
    )  # fmt: skip
    parts = [np.flatnonzero(owner == line) for line in range(len(lines))]
    return [ExtractedLine(fit_line(points[part], std), part) for part in parts]
