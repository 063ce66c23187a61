"""Matching of a chunk against the union of all chunks of other visits nearby.

A chunk contains only seven metres of driving with six beams. The union of all other visits' chunks nearby describes a
place much better. It recognises chunks that match no other chunk alone.
"""

import numpy as np

from limslam_agent.slam.graph.chunk_graph import Loop
from limslam_agent.slam.graph.local_maps import united
from limslam_agent.slam.graph.loop_search import Chunks
from limslam_agent.slam.graph.matching import Window, match, search_grid
from limslam_agent.slam.graph.wide_search import recognised
from limslam_env.geometry import FloatArray, se2

_LEEWAY = 0.02


def match_unions(chunks: Chunks, poses: FloatArray, loops: list[Loop]) -> list[Loop]:
    """Loops from unrecognised chunks to the nearest chunk of other visits, with the chunks at ``poses`` (c, 3)."""
    config = chunks.config.union
    known = recognised(loops, len(chunks), config.recognised)
    found = [_match_union(chunks, poses, int(number)) for number in np.nonzero(~known)[0]]
    return [loop for loop in found if loop is not None]


def _match_union(chunks: Chunks, poses: FloatArray, second: int) -> Loop | None:
    config, matching = chunks.config.union, chunks.config.matching
    distance = np.hypot(*(poses[:, :2] - poses[second, :2]).T)
    apart = np.abs(chunks.travel - chunks.travel[second]) > config.min_travel
    others = np.nonzero(apart & (distance < config.radius))[0]
    if not len(others):
        return None
    others = others[np.argsort(distance[others], kind="stable")]
    first = int(others[0])
    union = united([chunks.maps[each] for each in others], poses[others], len(chunks.maps[0].grid), chunks.config.maps)
    grid = search_grid(union, config.window, matching)
    window = Window(config.window, config.turn_window, config.turn_step)
    guess = se2.between(poses[first], poses[second])
    found = match(grid, chunks.maps[second].points, guess, window, matching, config.score - _LEEWAY)
    if found.score < config.score:
        return None
    return chunks.loop(first, second, found, "union", grid)
