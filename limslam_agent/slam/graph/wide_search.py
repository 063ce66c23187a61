"""The search for places that were not recognised along the way, with a very uncertain pose of the robot.

A match in so wide a window may be wrong, since many corridors look alike. The width of the window is therefore the
uncertainty of the chunk graph plus several standard deviations. A match is accepted only if several neighbouring chunks
match where it predicts them. These matches and the first match form a group.
"""

import numpy as np

from limslam_agent.slam.graph.chunk_graph import ChunkSolution, Loop, information_matrix
from limslam_agent.slam.graph.least_squares import relation_factor
from limslam_agent.slam.graph.loop_search import Chunks
from limslam_agent.slam.graph.matching import Match, Window, match, search_grid
from limslam_env.geometry import BoolArray, FloatArray, IntArray, se2

_NEAR, _FAR = 2.5, 5.0  # m of driving to the neighbours that must match as well
_LEEWAY = 0.01
# Chunks overlap. Grids and chunks at this spacing, m of driving, cover the whole log.
_GRIDS_APART, _CHUNKS_APART = 4.0, 2.4


def recognised(loops: list[Loop], count: int, reach: int) -> BoolArray:
    """Mask (count,) of the chunks that lie within ``reach`` chunks of the end of a loop."""
    marked = np.zeros(count, dtype=np.bool_)
    for loop in loops:
        for end in (loop.first, loop.second):
            marked[max(0, end - reach) : end + reach + 1] = True
    return marked


def search_widely(chunks: Chunks, solution: ChunkSolution, loops: list[Loop]) -> list[list[Loop]]:
    """Groups of loops for chunks that are not near any loop of ``loops``, from the solution with these loops."""
    config, poses = chunks.config.wide, solution.poses
    known = recognised(loops, len(chunks), config.recognised)
    if known.all():
        return []
    joint = np.asarray(np.linalg.inv(information_matrix(poses, chunks.hops, loops, solution.weights)))
    groups = []
    steps = _step(chunks, _GRIDS_APART), _step(chunks, _CHUNKS_APART)
    for first in range(0, len(chunks), steps[0]):
        groups += _groups(chunks, poses, joint, first, _candidates(chunks, poses, known, first, steps))
    return groups


def search_for_newest(chunks: Chunks, poses: FloatArray, joint: FloatArray) -> list[list[Loop]]:
    """Groups of loops for the last chunk alone, from poses (c, 3) and their joint covariance (3 c, 3 c)."""
    newest, groups = np.array([len(chunks) - 1]), []
    apart, near = _may_show_the_same(chunks, poses, len(chunks) - 1)
    for first in range(0, len(chunks), _step(chunks, _GRIDS_APART)):
        if apart[first] and near[first]:
            groups += _groups(chunks, poses, joint, first, newest)
    return groups


def _groups(chunks: Chunks, poses: FloatArray, joint: FloatArray, first: int, seconds: IntArray) -> list[list[Loop]]:
    """Groups of loops between chunks (k,) and the first chunk."""
    config, groups = chunks.config.wide, []
    shifts, turns = _windows(chunks, poses, joint, first, seconds)
    near = np.hypot(*(poses[seconds, :2] - poses[first, :2]).T) <= config.near + shifts
    if not near.any():
        return []
    grid = search_grid(chunks.maps[first], config.window, chunks.config.matching)
    for row in np.nonzero(near)[0]:
        second = int(seconds[row])
        guess, points = se2.between(poses[first], poses[second]), chunks.maps[second].points
        window = Window(shifts[row], turns[row], config.turn_step)
        found = match(grid, points, guess, window, chunks.config.matching, config.score - _LEEWAY)
        if found.score >= config.score:
            groups.append(_group(chunks, poses, first, second, found))
    return [group for group in groups if group]


def _may_show_the_same(chunks: Chunks, poses: FloatArray, first: int) -> tuple[BoolArray, BoolArray]:
    """Which chunks (c,) are far enough from a chunk in driving, and near enough in space, to show the same place."""
    near = np.hypot(*(poses[:, :2] - poses[first, :2]).T) <= chunks.config.wide.max_distance
    return np.abs(chunks.travel - chunks.travel[first]) >= chunks.config.wide.min_travel, near


def _candidates(chunks: Chunks, poses: FloatArray, known: BoolArray, first: int, steps: tuple[int, int]) -> IntArray:
    """Unrecognised chunks that may show the place of ``first``; pairs of unrecognised chunks are counted once."""
    apart, near = _may_show_the_same(chunks, poses, first)
    # A chunk that is not searched itself as a grid must be compared with earlier and with later chunks.
    numbers = np.arange(len(chunks))
    once = known[first] | (numbers > first) | (numbers % steps[0] != 0)
    return np.nonzero(near & apart & ~known & once & (numbers % steps[1] == 0))[0]


def _windows(
    chunks: Chunks, poses: FloatArray, joint: FloatArray, first: int, seconds: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Search windows for chunks (k,) in the grid of the first chunk: shifts (k,), m, and turns (k,), rad.

    ``joint`` (3 c, 3 c) is the covariance of all chunks.
    """
    config = chunks.config.wide
    firsts = np.full(len(seconds), first)
    _, jacobian = relation_factor(poses, firsts, seconds, np.zeros((len(seconds), 3)))
    columns = np.hstack((3 * firsts[:, None] + np.arange(3), 3 * seconds[:, None] + np.arange(3)))
    covariance = jacobian @ joint[columns[:, :, None], columns[:, None, :]] @ jacobian.transpose(0, 2, 1)
    variances = np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0)
    position, heading = np.sqrt(variances[:, :2].max(axis=1)), np.sqrt(variances[:, 2])
    shift = np.minimum(config.window, config.least_window + config.sigmas * position)
    return shift, np.minimum(config.turn_window, config.least_turn + config.sigmas * heading)


def _step(chunks: Chunks, apart: float) -> int:
    """Number of chunks that corresponds to this distance, m of driving."""
    hop = max(float(np.median(np.diff(chunks.travel))), 1e-6)
    return max(1, int(np.ceil(apart / hop - 0.05)))


def _group(chunks: Chunks, poses: FloatArray, first: int, second: int, found: Match) -> list[Loop]:
    """The match and its neighbours' matches as loops; empty if too few neighbours match."""
    config = chunks.config
    if not chunks.matches_backward(first, second, found.pose):
        return []
    matches = [(first, second, found)]
    for i, j in _neighbours(chunks, first, second):
        guess = se2.compose(se2.between(poses[i], poses[first]), found.pose)
        guess = se2.compose(guess, se2.between(poses[second], poses[j]))
        window = config.wide.neighbour_window, config.wide.neighbour_turn
        other = chunks.match(i, j, guess, *window, config.loops.score)
        if other.score > config.loops.score:
            matches.append((i, j, other))
        if len(matches) > config.wide.neighbours:
            return [chunks.loop(*each, "wide search") for each in matches]
    return []


def _neighbours(chunks: Chunks, first: int, second: int) -> list[tuple[int, int]]:
    """Pairs of chunks some metres of driving away. The second chunk always differs from ``second``."""
    near, far = _step(chunks, _NEAR), _step(chunks, _FAR)
    pairs = [(first + a, second + b) for a in (-far, -near, 0, near, far) for b in (-far, far, -near, near)]
    return [(i, j) for i, j in pairs if 0 <= i < len(chunks) and 0 <= j < len(chunks) and i != j]
