"""Lines in a buffer of points: the Hough transform finds them, total least squares sharpens them."""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from limslam_agent.config.shared import HoughConfig
from limslam_agent.slam.core.line_fit import LineFit, fit_line
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import along, distance

_MAX_CANDIDATES = 200


@dataclass(frozen=True, eq=False)
class ExtractedLine:
    """One wall, or part of it, in a buffer.

    Attributes
    ----------
    fit
        The line with covariance and ends.
    members
        Indices (n,) of its points in the buffer.
    """

    fit: LineFit
    members: IntArray


def hough_votes(points: FloatArray, config: HoughConfig, std: float) -> FloatArray:
    """Every line (r, theta) with enough votes, best first.

    Parameters
    ----------
    points
        (n, 2), m.
    config
        Bins and threshold.
    std
        Of the points off their wall, m.

    Returns
    -------
    lines
        (k, 3): votes, r (m, may be negative), theta in [0, pi).
    """
    reach = float(np.linalg.norm(points, axis=1).max()) if len(points) else 0.0
    step = max(config.r_step, 3.0 * std)
    # OpenCV's types leave out that nothing found is None.
    found: Any = cv2.HoughLinesPointSet(
        points.astype(np.float32).reshape(-1, 1, 2),
        lines_max=_MAX_CANDIDATES,
        threshold=config.min_votes - 1,  # OpenCV wants more votes than this
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

    Each point belongs to one line: a line takes its points away, and what is left of a weaker
    candidate must still pass the threshold. So one wall cannot appear twice, neither as
    neighbouring bins nor across theta = 0, where (r, theta) and (-r, theta + pi) meet.
    """
    if len(points) < config.min_votes:
        return []
    centre = points.mean(axis=0)
    free = np.ones(len(points), dtype=bool)
    lines: list[ExtractedLine] = []
    # Votes are counted about the middle of the points, where r and theta hardly interact.
    for _, r, theta in hough_votes(points - centre, config, std):
        shifted = r + centre[0] * math.cos(theta) + centre[1] * math.sin(theta)
        pieces = _pieces(points, free, np.array([shifted, theta]), config, std)
        lines += pieces
        for piece in pieces:
            free[piece.members] = False
        if pieces and config.only_best:
            break
        if np.count_nonzero(free) < config.min_votes:
            break
    return lines


def _pieces(
    points: FloatArray,
    free: np.ndarray[tuple[int], np.dtype[np.bool_]],
    line: FloatArray,
    config: HoughConfig,
    std: float,
) -> list[ExtractedLine]:
    """Refine a candidate on its inliers, and cut it where a hole is."""
    bin_size = max(config.r_step, 3.0 * std)
    tolerances = (bin_size, max(config.max_offset, 2.5 * std))
    for tolerance in tolerances:
        members = np.nonzero(free & (np.abs(distance(line, points)) <= tolerance))[0]
        if len(members) < config.min_votes:
            return []
        line = fit_line(points[members], std).line
    members = np.nonzero(free & (np.abs(distance(line, points)) <= tolerances[-1]))[0]
    position = along(line, points[members])
    order = np.argsort(position, kind="stable")
    cuts = np.nonzero(np.diff(position[order]) > config.max_gap)[0] + 1
    pieces = []
    for part in np.split(members[order], cuts):
        if len(part) >= config.min_votes:
            fit = fit_line(points[part], std)
            if fit.length >= config.min_length:
                pieces.append(ExtractedLine(fit, part))
    return pieces
