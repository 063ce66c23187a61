"""Matching of a chunk against the union of all chunks of other visits nearby.

A chunk contains only seven metres of driving with six beams. The union of all other visits' chunks nearby describes a
place much better. It recognises chunks that match no other chunk alone.
"""

import math

import numpy as np

from limslam_agent.slam.graph.chunk_graph import Loop
from limslam_agent.slam.graph.local_maps import united
from limslam_agent.slam.graph.loop_search import Chunks
from limslam_agent.slam.graph.matching import Window, match, search_grid
from limslam_agent.slam.graph.wide_search import recognised
from limslam_env.geometry import FloatArray, se2

_RADIUS, _MIN_TRAVEL = 8.0, 12.0  # m between the chunks of a union and a chunk, and m driven between
_WINDOW = Window(2.5, math.radians(20.0), math.radians(3.0))
_SCORE = 0.60
_RECOGNISED = 1  # chunks beside the end of a loop, which are not matched
_LEEWAY = 0.02


def match_unions(chunks: Chunks, poses: FloatArray, loops: list[Loop]) -> list[Loop]:
    """Loops from unrecognised chunks to the nearest chunk of other visits, with the chunks at ``poses`` (c, 3)."""
    known = recognised(loops, len(chunks), _RECOGNISED)
    found = [_match_union(chunks, poses, int(number)) for number in np.nonzero(~known)[0]]
    return [loop for loop in found if loop is not None]


def _match_union(chunks: Chunks, poses: FloatArray, second: int) -> Loop | None:
    distance = np.hypot(*(poses[:, :2] - poses[second, :2]).T)
    apart = np.abs(chunks.travel - chunks.travel[second]) > _MIN_TRAVEL
    others = np.nonzero(apart & (distance < _RADIUS))[0]
    if not len(others):
        return None
    others = others[np.argsort(distance[others], kind="stable")]
    first = int(others[0])
    union = united([chunks.maps[each] for each in others], poses[others], len(chunks.maps[0].grid), chunks.config.maps)
    grid = search_grid(union, _WINDOW.shift)
    guess = se2.between(poses[first], poses[second])
    found = match(grid, chunks.maps[second].points, guess, _WINDOW, _SCORE - _LEEWAY)
    if found.score < _SCORE:
        return None
    return chunks.loop(first, second, found, "union", grid)
