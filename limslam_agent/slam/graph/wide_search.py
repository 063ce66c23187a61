"""The search for places that were not recognised along the way, with a very uncertain pose of the robot.

A match in so wide a window may be wrong, since many corridors look alike. The width of the window is therefore the
uncertainty of the chunk graph plus several standard deviations. A match is accepted only if several neighbouring chunks
match where it predicts them. These matches and the first match form a group.

A chunk contains only seven metres of driving with six beams. The union of all other visits' chunks nearby describes a
place much better. It recognises chunks that match no other chunk alone.
"""

import math

import numpy as np

from limslam_agent.slam.graph.chunk_graph import ChunkSolution, Loop, information_matrix
from limslam_agent.slam.graph.least_squares import relation_covariances, relation_factor
from limslam_agent.slam.graph.local_maps import united
from limslam_agent.slam.graph.loop_search import LEAST_SCORE, Chunks
from limslam_agent.slam.graph.matching import Match, Window, match, search_grid
from limslam_env.geometry import BoolArray, FloatArray, IntArray, se2

_MIN_TRAVEL, _MAX_DISTANCE = 15.0, 18.0  # m driven between two chunks, and m between them
_WINDOW, _TURN_WINDOW, _TURN_STEP = 10.0, math.radians(100.0), math.radians(4.0)  # of a match, m and rad
# The part of the window that does not depend on the uncertainty, m and rad, and the standard deviations added to it.
_LEAST_WINDOW, _LEAST_TURN, _SIGMAS = 1.5, math.radians(20.0), 4.0
_BEYOND = 3.0  # m beyond the window, where two chunks can show the same place
_SCORE = 0.60
# So many neighbouring chunks must match where predicted, within this window, m and rad.
_NEIGHBOURS, _NEIGHBOUR_WINDOW, _NEIGHBOUR_TURN = 3, 0.7, math.radians(10.0)
_RECOGNISED = 2  # chunks beside the end of a loop, which need no wide search
_NEAR, _FAR = 2.5, 5.0  # m of driving to the neighbours that must match as well
_LEEWAY = 0.01
# Chunks overlap. Grids and chunks at this spacing, m of driving, cover the whole log.
_GRIDS_APART, _CHUNKS_APART = 4.0, 2.4
# A union: m between its chunks and the chunk that is matched, and m driven between; the window of the match; and chunks
# beside the end of a loop, which are not matched.
_UNION_RADIUS, _UNION_TRAVEL, _UNION_LEEWAY = 8.0, 12.0, 0.02
_UNION_WINDOW, _BESIDE = Window(2.5, math.radians(20.0), math.radians(3.0)), 1


def recognised(loops: list[Loop], count: int, reach: int) -> BoolArray:
    """Mask (count,) of the chunks that lie within ``reach`` chunks of the end of a loop."""
    marked = np.zeros(count, dtype=np.bool_)
    for loop in loops:
        for end in (loop.first, loop.second):
            marked[max(0, end - reach) : end + reach + 1] = True
    return marked


def parts_of(loops: list[Loop], count: int) -> IntArray:
    """Numbers (count,) of the parts of a log of chunks: no loop spans the hop between two parts.

    An error of that hop shifts and turns all that follows, and the loops of neither part show it.
    """
    held = np.zeros(count - 1, dtype=np.bool_)
    for loop in loops:
        held[min(loop.first, loop.second) : max(loop.first, loop.second)] = True
    return np.append(0, np.cumsum(~held))


def search_widely(chunks: Chunks, solution: ChunkSolution, loops: list[Loop]) -> list[list[Loop]]:
    """Groups of loops for chunks that are not near any loop of ``loops``, and between parts that no loop joins.

    The search begins at the solution with these loops.
    """
    poses = solution.poses
    known, parts = recognised(loops, len(chunks), _RECOGNISED), parts_of(loops, len(chunks))
    if known.all() and not parts.any():
        return []
    joint = np.asarray(np.linalg.inv(information_matrix(poses, chunks.hops, loops, solution.weights)))
    groups = []
    steps = _step(chunks, _GRIDS_APART), _step(chunks, _CHUNKS_APART)
    for first in range(0, len(chunks), steps[0]):
        groups += _groups(chunks, poses, joint, first, _candidates(chunks, poses, (known, parts), first, steps))
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
    groups = []
    shifts, turns = _windows(poses, joint, first, seconds)
    near = np.hypot(*(poses[seconds, :2] - poses[first, :2]).T) <= _BEYOND + shifts
    if not near.any():
        return []
    grid = search_grid(chunks.maps[first], _WINDOW)
    for row in np.nonzero(near)[0]:
        second = int(seconds[row])
        guess, points = se2.between(poses[first], poses[second]), chunks.maps[second].points
        window = Window(shifts[row], turns[row], _TURN_STEP)
        found = match(grid, points, guess, window, _SCORE - _LEEWAY)
        if found.score >= _SCORE:
            groups.append(_group(chunks, poses, first, second, found))
    return [group for group in groups if group]


def _may_show_the_same(chunks: Chunks, poses: FloatArray, first: int) -> tuple[BoolArray, BoolArray]:
    """Which chunks (c,) are far enough from a chunk in driving, and near enough in space, to show the same place."""
    near = np.hypot(*(poses[:, :2] - poses[first, :2]).T) <= _MAX_DISTANCE
    return np.abs(chunks.travel - chunks.travel[first]) >= _MIN_TRAVEL, near


def _candidates(
    chunks: Chunks, poses: FloatArray, seen: tuple[BoolArray, IntArray], first: int, steps: tuple[int, int]
) -> IntArray:
    """Chunks that may show the place of ``first``: unrecognised chunks, or recognised chunks of another part.

    Pairs of unrecognised chunks, and pairs of recognised ones, are counted once.
    """
    known, parts = seen
    apart, near = _may_show_the_same(chunks, poses, first)
    wanted = ~known | (known[first] & (parts != parts[first]))
    # A chunk that is not searched itself as a grid must be compared with earlier and with later chunks.
    numbers = np.arange(len(chunks))
    once = (known[first] & ~known) | (numbers > first) | (numbers % steps[0] != 0)
    return np.nonzero(near & apart & wanted & once & (numbers % steps[1] == 0))[0]


def _windows(poses: FloatArray, joint: FloatArray, first: int, seconds: IntArray) -> tuple[FloatArray, FloatArray]:
    """Search windows for chunks (k,) in the grid of the first chunk: shifts (k,), m, and turns (k,), rad.

    ``joint`` (3 c, 3 c) is the covariance of all chunks.
    """
    firsts = np.full(len(seconds), first)
    _, jacobian = relation_factor(poses, firsts, seconds, np.zeros((len(seconds), 3)))
    covariance = relation_covariances(jacobian, joint, firsts, seconds)
    variances = np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0)
    position, heading = np.sqrt(variances[:, :2].max(axis=1)), np.sqrt(variances[:, 2])
    shift = np.minimum(_WINDOW, _LEAST_WINDOW + _SIGMAS * position)
    return shift, np.minimum(_TURN_WINDOW, _LEAST_TURN + _SIGMAS * heading)


def _step(chunks: Chunks, apart: float) -> int:
    """Number of chunks that corresponds to this distance, m of driving."""
    hop = max(float(np.median(np.diff(chunks.travel))), 1e-6)
    return max(1, int(np.ceil(apart / hop - 0.05)))


def _group(chunks: Chunks, poses: FloatArray, first: int, second: int, found: Match) -> list[Loop]:
    """The match and its neighbours' matches as loops; empty if too few neighbours match."""
    if not chunks.matches_backward(first, second, found.pose):
        return []
    matches = [(first, second, found)]
    for i, j in _neighbours(chunks, first, second):
        guess = se2.compose(se2.between(poses[i], poses[first]), found.pose)
        guess = se2.compose(guess, se2.between(poses[second], poses[j]))
        other = chunks.match(i, j, guess, _NEIGHBOUR_WINDOW, _NEIGHBOUR_TURN, LEAST_SCORE)
        if other.score > LEAST_SCORE:
            matches.append((i, j, other))
        if len(matches) > _NEIGHBOURS:
            return [chunks.loop(*each, "wide search") for each in matches]
    return []


def _neighbours(chunks: Chunks, first: int, second: int) -> list[tuple[int, int]]:
    """Pairs of chunks some metres of driving away. The second chunk always differs from ``second``."""
    near, far = _step(chunks, _NEAR), _step(chunks, _FAR)
    pairs = [(first + a, second + b) for a in (-far, -near, 0, near, far) for b in (-far, far, -near, near)]
    return [(i, j) for i, j in pairs if 0 <= i < len(chunks) and 0 <= j < len(chunks) and i != j]


def match_unions(chunks: Chunks, poses: FloatArray, loops: list[Loop]) -> list[Loop]:
    """Loops from unrecognised chunks to the nearest chunk of other visits, with the chunks at ``poses`` (c, 3)."""
    known = recognised(loops, len(chunks), _BESIDE)
    found = [_match_union(chunks, poses, int(number)) for number in np.nonzero(~known)[0]]
    return [loop for loop in found if loop is not None]


def _match_union(chunks: Chunks, poses: FloatArray, second: int) -> Loop | None:
    distance = np.hypot(*(poses[:, :2] - poses[second, :2]).T)
    apart = np.abs(chunks.travel - chunks.travel[second]) > _UNION_TRAVEL
    others = np.nonzero(apart & (distance < _UNION_RADIUS))[0]
    if not len(others):
        return None
    others = others[np.argsort(distance[others], kind="stable")]
    first = int(others[0])
    union = united([chunks.maps[each] for each in others], poses[others], len(chunks.maps[0].grid), chunks.config.maps)
    grid = search_grid(union, _UNION_WINDOW.shift)
    guess = se2.between(poses[first], poses[second])
    found = match(grid, chunks.maps[second].points, guess, _UNION_WINDOW, _SCORE - _UNION_LEEWAY)
    if found.score < _SCORE:
        return None
    return chunks.loop(first, second, found, "union", grid)
