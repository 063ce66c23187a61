"""Line segments: arrays (n, 4) of ``x1, y1, x2, y2`` in metres."""

import numpy as np

from limslam_env.geometry.arrays import FloatArray


def lengths(segments: FloatArray) -> FloatArray:
    """Length (m) of each segment (n, 4)."""
    return np.hypot(segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1])


def distances(points: FloatArray, segments: FloatArray) -> FloatArray:
    """Distance (m) of every point (n, 2) from every segment (k, 4), as (n, k)."""
    start = segments[:, :2]
    span = segments[:, 2:] - start
    squared = np.maximum(np.einsum("kd,kd->k", span, span), 1e-300)
    offset = points[:, None, :] - start[None]
    fraction = np.clip(np.einsum("nkd,kd->nk", offset, span) / squared, 0.0, 1.0)
    return np.asarray(np.linalg.norm(offset - fraction[..., None] * span[None], axis=-1))


def polygon_edges(polygon: FloatArray) -> FloatArray:
    """The edges (k, 4) of a closed polygon (k, 2), from each corner to the next."""
    return np.hstack((polygon, np.roll(polygon, -1, axis=0)))


def inside_polygon(
    points: FloatArray, polygon: FloatArray
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which points (n, 2) lie inside a simple polygon (k, 2), by the crossing-number rule."""
    x = points[:, 0, None]
    y = points[:, 1, None]
    x1, y1, x2, y2 = polygon_edges(polygon).T
    straddles = (y1 > y) != (y2 > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = (x2 - x1) * (y - y1) / (y2 - y1) + x1
    return np.asarray(np.sum(straddles & (x < crossing), axis=1) % 2 == 1)


def sample(
    segments: FloatArray, spacing: float
) -> tuple[FloatArray, np.ndarray[tuple[int], np.dtype[np.intp]]]:
    """Points on each segment, evenly spaced and at most ``spacing`` (m) apart, ends included.

    Returns
    -------
    points
        (n, 2), metres.
    owner
        (n,), the index of the segment that each point lies on.
    """
    counts = np.maximum(np.ceil(lengths(segments) / spacing - 1e-9).astype(np.intp), 1) + 1
    owner = np.repeat(np.arange(len(segments)), counts)
    step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    fraction = (step / np.maximum(counts - 1, 1)[owner])[:, None]
    return segments[owner, :2] * (1.0 - fraction) + segments[owner, 2:] * fraction, owner
