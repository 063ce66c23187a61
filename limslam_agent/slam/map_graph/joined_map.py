"""The place of the newest local map in the map of all earlier visits.

A single earlier chunk may have seen little of what a local map shows: the other visit came another
way. All chunks around have seen the most of it. So the local map is matched with all of them as
one. That also tells right from wrong: of 97 such matches in the log ``csail``, 49 scored 0.5 or
more, of which 46 were less than 0.2 m off, and three 0.3 to 0.6 m, along a corridor. Those that
were more than 0.7 m off scored less than 0.37.
"""

import numpy as np

from limslam_agent.slam.graph.factors import relation
from limslam_agent.slam.map_graph.chunk_graph import (
    SCORES,
    ChunkGraph,
    search_window,
)
from limslam_agent.slam.map_graph.local_maps import LocalMap, joined_grid
from limslam_agent.slam.map_graph.loops import Loop
from limslam_agent.slam.map_graph.matching import match, match_covariance, search_grid
from limslam_env.geometry import FloatArray, se2

# chunks that are joined at most, and how far the local map and each of them may be from the nearest
# one, m
_MOST_JOINED = 12
_WITHIN = 10.0
# m: in a window wider than the first number, a match is refused that is known no better along some
# direction than the second: one corridor fits along any other
_WIDE = 5.0
_VAGUE = 10.0


def loop_to_joined(
    places: ChunkGraph, drawn: LocalMap, motion: FloatArray, own: FloatArray
) -> tuple[Loop, FloatArray] | None:
    """A loop from the chunk that is nearest to a local map, and the pose (3,) of the local map by
    the loop and by what was believed. None if it fits nowhere.

    Parameters
    ----------
    places
        The chunks so far.
    drawn
        The local map.
    motion, own
        Motion (3,) from the last chunk to the local map, and its covariance (3, 3).
    """
    newest = len(places.maps) - 1
    travel = np.array([each.travel for each in places.maps])
    old = np.flatnonzero(drawn.travel - travel >= places.config.another_visit)
    believed = se2.compose(places.poses[newest], motion)
    old = old[np.argsort(_distances(believed, places.poses[old]), kind="stable")]
    if not len(old) or _distances(believed, places.poses[old[:1]])[0] > _WITHIN:
        return None
    first = int(old[0])
    around = old[_distances(places.poses[first], places.poses[old]) <= _WITHIN][:_MOST_JOINED]
    poses = se2.between(places.poses[first], places.poses[around])
    joined = joined_grid([places.maps[each] for each in around], poses)
    before = relation(places.poses, np.array([[first, newest]]), np.zeros((1, 3)))
    guess = se2.compose(before.errors[0], motion)
    covariance = se2.moved_covariance(before.errors[0], places.covariances(before)[0], motion, own)
    position, turn = np.sqrt(np.maximum(np.diag(covariance)[1:], 0.0))
    window = search_window(position, turn)
    grid = search_grid(joined, drawn.cell, window.shift)
    best = match(grid, drawn.points, guess, window, SCORES[0])
    if best.score <= SCORES[0]:
        return None
    back = search_grid(drawn.grid, drawn.cell, 0.0), places.maps[first].points
    mean, spread = match_covariance(grid, drawn.points, best.pose, back)
    if window.shift > _WIDE and np.trace(spread[:2, :2]) > _VAGUE**2:
        return None
    loop = Loop(first, newest, mean, np.asarray(np.linalg.inv(spread)), best.score)
    off = guess - mean
    off[2] = se2.wrap_angle(off[2])
    both = mean + spread @ np.linalg.solve(covariance + spread, off)
    return loop, se2.compose(places.poses[first], both)


def _distances(pose: FloatArray, poses: FloatArray) -> FloatArray:
    """Distances (k,) of poses (k, 3) from a pose (3,), m."""
    return np.asarray(np.hypot(*(poses - pose)[:, :2].T))
