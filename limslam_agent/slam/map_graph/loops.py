"""Loops: relative poses of chunks that show the same place, and which of them support each other.

Scores of right and wrong matches overlap, so that no threshold separates them. Agreement between
two loops does separate them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limslam_agent.slam.graph.factors import Relations
from limslam_env.geometry import BoolArray, FloatArray, se2

# Two poses agree within these tolerances, m and rad.
_DISTANCE = 0.6
_TURN = math.radians(9.0)
_SLACK = 0.3  # m, by which a hop is longer or shorter, since chunks begin with key poses
_AS_WELL = 9.0  # largest variance of a loop that supports another, in variances of that one

SUPPORT_HOPS = 3
"""Chunks, at most, between the ends of loops that support each other."""
NO_SUPPORT = "no other loop nearby agrees"
OUTVOTED = "its weight in the graph of chunks is too low"
KEPT = "kept"


@dataclass(frozen=True, eq=False)
class Loop:
    """A relative pose between two chunks."""

    # first, second: the chunk whose grid was searched, and the chunk whose points were matched
    first: int
    second: int
    relative: FloatArray  # pose (3,) of the second chunk in the frame of the first chunk
    information: FloatArray  # inverse (3, 3) of the covariance of the relative pose
    score: float  # score of the match
    # whether the chunk may lie outside of the window that was searched for it
    is_doubtful: bool = False
    reason: str = ""  # ``KEPT``, or why the loop is no part of the result


def relations_of(loops: Sequence[Loop]) -> Relations:
    """Loops as relations between chunks."""
    ends = np.array([(loop.first, loop.second) for loop in loops], dtype=np.int64).reshape(-1, 2)
    relative = np.array([loop.relative for loop in loops]).reshape(-1, 3)
    return ends, relative, np.array([loop.information for loop in loops]).reshape(-1, 3, 3)


def agree(predicted: FloatArray, found: FloatArray, apart: FloatArray | float = 0.0) -> BoolArray:
    """Which of the poses (..., 3) are where they are predicted.

    The prediction may bridge a distance of ``apart`` (...) m in a map, each part of which may be
    bent.
    """
    off = se2.between(predicted, found)
    near = np.hypot(off[..., 0], off[..., 1]) < _DISTANCE + _TURN * apart
    return np.asarray(near & (np.abs(off[..., 2]) < _TURN))


def supported(
    loops: Sequence[Loop], poses: FloatArray, travel: FloatArray, hop: float
) -> BoolArray:
    """Which loops (k,) are supported by another nearby loop that agrees, is known about as well,
    and belongs to another chunk.

    ``poses`` (c, 3) and ``travel`` (c,) are the poses of the chunks and the distance driven up to
    each chunk, m, which is about a ``hop`` longer for each.
    """
    if not loops:
        return np.zeros(0, dtype=np.bool_)
    first, second = np.array([(loop.first, loop.second) for loop in loops]).T
    relative = np.array([loop.relative for loop in loops])
    # Each loop (row) predicts each other one (column).
    before = se2.between(poses[first][None], poses[first][:, None])
    after = se2.between(poses[second][:, None], poses[second][None])
    predicted = se2.compose(se2.compose(before, relative[:, None]), after)
    gaps = [np.abs(travel[ends][:, None] - travel[ends][None]) for ends in (first, second)]
    most = SUPPORT_HOPS * hop + _SLACK
    near = (gaps[0] <= most) & (gaps[1] >= hop - _SLACK) & (gaps[1] <= most)
    # A loop that is free along a corridor agrees with any place along it.
    covariances = np.linalg.inv([loop.information for loop in loops])
    variances = np.trace(covariances[:, :2, :2], axis1=1, axis2=2)
    near &= variances[:, None] <= _AS_WELL * variances
    return np.asarray((near & agree(predicted, relative[None])).any(axis=0))
