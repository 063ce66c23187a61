"""The search for loops along the way: each chunk is matched against earlier chunks that may show the same place.

The search processes the chunks in order, as in online operation. The joint covariance of all chunks so far determines
which earlier chunks can be near, and how wide the window of a match must be. Each accepted loop reduces the covariance.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.agreement import supported
from limslam_agent.slam.graph.chunk_graph import ChunkSolution, Hops, Loop, information_matrix, solve
from limslam_agent.slam.graph.least_squares import relation_covariances, relation_factor
from limslam_agent.slam.graph.local_maps import LocalMap
from limslam_agent.slam.graph.matching import (
    Match,
    SearchGrid,
    Window,
    match,
    match_covariance,
    search_grid,
)
from limslam_env.geometry import FloatArray, IntArray, se2

_MIN_TRAVEL = 10.0  # m driven between the chunks of a loop
# Chunks are matched if their distance, m, is below a gate plus some standard deviations, and below another gate.
_GATE, _GATE_SIGMAS, _MAX_DISTANCE = 2.5, 2.5, 12.0
_WINDOW, _TURN_WINDOW = 4.0, math.radians(35.0)  # of a match at most, m and rad
_LEAST_WINDOW, _LEAST_TURN = 0.6, math.radians(8.0)  # the part that does not depend on the uncertainty, m and rad
TURN_STEP = math.radians(3.0)
"""Step of the turns of a match, rad."""
LEAST_SCORE = 0.60
"""Least score of a match."""
_BACKWARD_SCORE = 0.50  # of the match in the opposite direction
_BEST = 3  # loops from one chunk
_BACKWARD_SHIFT, _BACKWARD_TURN = 0.3, np.radians(4.0)
_EARLY_ANNEALING, _EARLY_ITERATIONS = (5.0, 1.0), 3
# The covariance is computed anew if the weight of a loop has changed by more than this.
_WEIGHT_CHANGE = 0.3
# What loops say about the hops: loops whose position is known this well, m, and at least so many; the share of them
# whose chi-square by the scaled covariances is at most that, and the least scale.
_KNOWN_STD, _FEWEST, _EXPLAINED, _LARGEST_SQUARE, _LEAST_SCALE = 1.0, 6, 0.9, 3.0, 0.003


@dataclass(frozen=True, eq=False)
class Chunks:
    """The chunks of a log, for one trajectory.

    Attributes
    ----------
    maps
        The c chunks in the order of driving.
    middles, poses, travel
        Middle key poses (c,); their poses (c, 3) in the trajectory; distance driven (c,), m.
    hops
        Motions between successive chunks.
    config
        The settings.
    """

    maps: list[LocalMap]
    middles: IntArray
    poses: FloatArray
    travel: FloatArray
    hops: Hops
    config: GraphConfig
    _grids: dict[int, SearchGrid] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        """The number of chunks."""
        return len(self.maps)

    def grid(self, number: int) -> SearchGrid:
        """The search grid of a chunk, with the window size of loops along the way."""
        if number not in self._grids:
            self._grids[number] = search_grid(self.maps[number], _WINDOW)
        return self._grids[number]

    def match(self, first: int, second: int, guess: FloatArray, shift: float, turn: float, least: float) -> Match:
        """Match the points of the second chunk with the grid of the first chunk, in a window about a guess (3,)."""
        window = Window(shift, turn, TURN_STEP)
        return match(self.grid(first), self.maps[second].points, guess, window, least)

    def matches_backward(self, first: int, second: int, pose: FloatArray) -> bool:
        """Whether the chunks also match in the opposite direction, near the relative pose that was found."""
        found = self.match(second, first, se2.inverse(pose), _BACKWARD_SHIFT, _BACKWARD_TURN, _BACKWARD_SCORE)
        return found.score >= _BACKWARD_SCORE

    def loop(self, first: int, second: int, found: Match, source: str, grid: SearchGrid | None = None) -> Loop:
        """A loop with the covariance of its match, from the first chunk's grid or another grid in its frame."""
        backward = self.grid(second), self.maps[first].points
        mean, covariance = match_covariance(
            grid or self.grid(first), self.maps[second].points, found.pose, TURN_STEP, backward
        )
        return Loop(first, second, mean, np.asarray(np.linalg.inv(covariance)), found.score, source)


def loops_along_the_way(chunks: Chunks) -> list[Loop]:
    """All loops that the search accepts, both right and wrong."""
    belief = Belief(chunks)
    for _ in range(len(chunks) - 1):
        belief.advance()
        found = loops_of_newest(chunks, belief)
        if found:
            belief.close(found)
    return belief.loops


def scale_of_hops(chunks: Chunks, loops: list[Loop]) -> float:
    """The factor, at most 1, that makes the covariances of the hops as large as the errors that loops show.

    The chi-square of a loop is its squared distance from the chain of hops, in units of the chain's covariance. The
    factor is chosen so that nine in ten loops have a chi-square of at most three. If the covariances are right, nine in
    ten have at most 6.25, and the factor would be 2.1: it is limited to 1. Where walls are clean and smooth, chi-square
    is a hundred times smaller.

    The loops were found inside of gates around the believed path. So large chi-squares are missing among them, which
    makes the factor smaller. That nine in ten loops must be below three, and not below 6.25, makes it twice as large.

    Parameters
    ----------
    chunks
        The chunks, with covariances of the hops that have not been scaled.
    loops
        Loops along the way. Only those that other loops support, and whose position is known, are used.
    """
    good = supported(loops, chunks.poses, chunks.travel)
    loops = [loop for loop, agreed in zip(loops, good, strict=True) if agreed]
    known = [loop for loop in loops if np.linalg.eigvalsh(loop.information[:2, :2])[0] > _KNOWN_STD**-2]
    if len(known) < _FEWEST:
        return 1.0
    joint = np.asarray(np.linalg.inv(information_matrix(chunks.poses, chunks.hops, [], np.zeros(0))), dtype=float)
    first, second = np.array([(loop.first, loop.second) for loop in known]).T
    error, jacobian = relation_factor(chunks.poses, first, second, np.array([loop.relative for loop in known]))
    chain = relation_covariances(jacobian, joint, first, second)
    squares = np.einsum("fi,fij,fj->f", error, np.linalg.inv(chain), error)
    return float(np.clip(np.quantile(squares, _EXPLAINED) / _LARGEST_SQUARE, _LEAST_SCALE, 1.0))


def loops_of_newest(chunks: Chunks, belief: "Belief") -> list[Loop]:
    """Loops from the newest chunk of the belief to some earlier chunks, the best matches first."""
    newest = belief.count - 1
    candidates: list[tuple[int, Match]] = []
    old = np.nonzero(chunks.travel[newest] - chunks.travel[: newest - 1] >= _MIN_TRAVEL)[0]
    if not len(old):
        return []
    guesses, position_std, turn_std = belief.seen_from(old)
    distance = np.hypot(guesses[:, 0], guesses[:, 1])
    reach = np.minimum(_MAX_DISTANCE, _GATE + _GATE_SIGMAS * position_std)
    for row in np.nonzero(distance <= reach)[0]:
        shift = min(_WINDOW, _LEAST_WINDOW + _GATE_SIGMAS * position_std[row])
        turn = min(_TURN_WINDOW, _LEAST_TURN + _GATE_SIGMAS * turn_std[row])
        found = chunks.match(int(old[row]), newest, guesses[row], shift, turn, LEAST_SCORE)
        if found.score > LEAST_SCORE:
            candidates.append((int(old[row]), found))
    candidates.sort(key=lambda each: -each[1].score)
    return [
        chunks.loop(first, newest, found, "along the way")
        for first, found in candidates[:_BEST]
        if chunks.matches_backward(first, newest, found.pose)
    ]


class Belief:
    """The poses of the chunks so far and their joint covariance."""

    def __init__(self, chunks: Chunks) -> None:
        self._chunks = chunks
        self._poses = np.zeros((len(chunks), 3))
        self._poses[0] = chunks.poses[0]
        self._covariance = np.zeros((3 * len(chunks), 3 * len(chunks)))
        self._weights = np.zeros(0)
        self.count = 1
        self.loops: list[Loop] = []

    @property
    def covariance(self) -> FloatArray:
        """The joint covariance (3 k, 3 k) of the chunks so far, relative to the first chunk."""
        size = 3 * self.count
        return self._covariance[:size, :size]

    @property
    def poses(self) -> FloatArray:
        """Poses (k, 3) of the chunks so far."""
        return self._poses[: self.count]

    @property
    def weights(self) -> FloatArray:
        """Weights of the loops."""
        return self._weights

    def extend(self, chunks: Chunks) -> None:
        """Go on with more chunks, of which the first are the chunks so far."""
        more = len(chunks) - len(self._poses)
        self._chunks, self._poses = chunks, np.pad(self._poses, ((0, more), (0, 0)))
        self._covariance = np.pad(self._covariance, (0, 3 * more))

    def adopt(self, loops: Sequence[Loop], solution: ChunkSolution) -> None:
        """Go on with other loops and their solution."""
        self.loops, self._weights = list(loops), solution.weights
        self._poses[: self.count] = solution.poses
        self._recompute()

    def advance(self) -> None:
        """Add the next chunk by the motion of the hop."""
        last, hops = self.count - 1, self._chunks.hops
        motion = hops.motions[last]
        self._poses[last + 1] = se2.compose(self._poses[last], motion)
        by_pose, by_motion = se2.compose_jacobians(self._poses[last], motion)
        end = 3 * self.count
        moved = by_pose @ self._covariance[end - 3 : end, :end]
        self._covariance[end : end + 3, :end], self._covariance[:end, end : end + 3] = moved, moved.T
        noise = by_motion @ hops.covariances[last] @ by_motion.T
        self._covariance[end : end + 3, end : end + 3] = moved[:, -3:] @ by_pose.T + noise
        self.count += 1

    def seen_from(self, old: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The newest chunk's pose in the frames of old chunks (k, 3), and its standard deviations (k,), m and rad."""
        newest = np.full(len(old), self.count - 1)
        poses = self._poses[: self.count]
        _, jacobian = relation_factor(poses, newest, old, np.zeros((len(old), 3)))
        columns = np.hstack((3 * newest[:, None] + np.arange(3), 3 * old[:, None] + np.arange(3)))
        joint = self._covariance[columns[:, :, None], columns[:, None, :]]
        covariance = np.einsum("kij,kjl,kml->kim", jacobian, joint, jacobian)
        position = np.sqrt(np.maximum(np.maximum(covariance[:, 0, 0], covariance[:, 1, 1]), 0.0))
        return se2.between(poses[old], poses[-1]), position, np.sqrt(np.maximum(covariance[:, 2, 2], 0.0))

    def chi_square(self, loop: Loop) -> float:
        """How far a loop is from what is believed, in chi-square of three degrees of freedom."""
        ends = np.array([[loop.first], [loop.second]])
        error, jacobian = relation_factor(self.poses, ends[0], ends[1], loop.relative[None])
        columns = (3 * ends + np.arange(3)).ravel()
        believed = jacobian[0] @ self._covariance[columns[:, None], columns] @ jacobian[0].T
        return float(error[0] @ np.linalg.solve(believed + np.linalg.inv(loop.information), error[0]))

    def close(self, found: Sequence[Loop]) -> None:
        """Add loops of the newest chunk."""
        chunks = self._chunks
        self.loops += found
        poses = self._poses[: self.count]
        solution = solve(poses, chunks.hops, self.loops, _EARLY_ANNEALING, _EARLY_ITERATIONS)
        known = len(self._weights)
        changed = np.abs(solution.weights[:known] - self._weights)
        self._poses[: self.count], self._weights = solution.poses, solution.weights.copy()
        if known and changed.max() > _WEIGHT_CHANGE:
            self._recompute()
        else:
            for loop, weight in zip(found, solution.weights[known:], strict=True):
                self._update(loop, float(weight))

    def _recompute(self) -> None:
        information = information_matrix(self._poses[: self.count], self._chunks.hops, self.loops, self._weights)
        size = 3 * self.count
        self._covariance[:size, :size] = np.linalg.inv(information)

    def _update(self, loop: Loop, weight: float) -> None:
        """Update the joint covariance of all chunks with a loop, as the Kalman filter does."""
        ends = np.array([[loop.first], [loop.second]])
        _, jacobian = relation_factor(self._poses, ends[0], ends[1], loop.relative[None])
        columns = (3 * ends + np.arange(3)).ravel()
        covariance = self.covariance
        across = covariance[:, columns] @ jacobian[0].T
        innovation = jacobian[0] @ across[columns] + np.linalg.inv(max(weight, 1e-6) * loop.information)
        covariance -= across @ np.linalg.solve(innovation, across.T)
        # Rounding errors that are not symmetric would grow with each update.
        covariance[:] = 0.5 * (covariance + covariance.T)
