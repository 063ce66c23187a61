"""The search for loops: each chunk is matched against earlier chunks that may show the same place.

The search processes the chunks in order, as in online operation. The joint covariance of all chunks so far determines
which earlier chunks can be near, and how wide the window of a match must be. Each accepted loop reduces the covariance.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from limslam_agent.slam.graph.chunk_graph import REFINING, Hops, Loop, joint_covariance, solve
from limslam_agent.slam.graph.least_squares import relation_covariances, relation_factor
from limslam_agent.slam.graph.local_maps import LocalMap
from limslam_agent.slam.graph.matching import Match, SearchGrid, Window, match, match_covariance, search_grid
from limslam_env.geometry import FloatArray, IntArray, se2

_MIN_TRAVEL = 10.0  # m driven between the chunks of a loop
_GATE = 2.5  # m: chunks within this distance show the same place, however well their poses are known
_LEAST_WINDOW, _LEAST_TURN = 0.6, math.radians(8.0)  # the part that does not depend on the uncertainty, m and rad
TURN_STEP = math.radians(3.0)
"""Step of the turns of a match, rad."""
# How far from its believed pose a chunk is searched for: standard deviations that are added to the gate and to the
# window; the largest distance between two chunks, m; and the largest window, m and rad.
_SIGMAS, _MOST_DISTANCE, _MOST_SHIFT, _MOST_TURN = 2.5, 12.0, 4.0, math.radians(35.0)
_LEAST_SCORE, _BACKWARD_SCORE = 0.50, 0.40  # of a match, and of the match in the opposite direction
_BEST = 3  # loops from one chunk
_BACKWARD_SHIFT, _BACKWARD_TURN = 0.3, np.radians(4.0)


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
    """

    maps: list[LocalMap]
    middles: IntArray
    poses: FloatArray
    travel: FloatArray
    hops: Hops
    _grids: dict[int, SearchGrid] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        """The number of chunks."""
        return len(self.maps)

    def grid(self, number: int) -> SearchGrid:
        """The search grid of a chunk."""
        if number not in self._grids:
            self._grids[number] = search_grid(self.maps[number], _MOST_SHIFT)
        return self._grids[number]

    def match(self, first: int, second: int, guess: FloatArray, shift: float, turn: float, least: float) -> Match:
        """Match the points of the second chunk with the grid of the first chunk, in a window about a guess (3,)."""
        window = Window(shift, turn, TURN_STEP)
        return match(self.grid(first), self.maps[second].points, guess, window, least)

    def matches_backward(self, first: int, second: int, pose: FloatArray) -> bool:
        """Whether the chunks also match in the opposite direction, near the relative pose that was found."""
        found = self.match(second, first, se2.inverse(pose), _BACKWARD_SHIFT, _BACKWARD_TURN, _BACKWARD_SCORE)
        return found.score >= _BACKWARD_SCORE

    def loop(self, first: int, second: int, found: Match) -> Loop:
        """A loop with the covariance of its match."""
        backward = self.grid(second), self.maps[first].points
        mean, covariance = match_covariance(self.grid(first), self.maps[second].points, found.pose, TURN_STEP, backward)
        return Loop(first, second, mean, np.asarray(np.linalg.inv(covariance)), found.score)


def search_loops(chunks: Chunks) -> list[Loop]:
    """All loops that the search accepts, both right and wrong."""
    belief = Belief(chunks)
    for _ in range(len(chunks) - 1):
        belief.advance()
        belief.close(loops_of_newest(chunks, belief))
    return belief.loops


def loops_of_newest(chunks: Chunks, belief: "Belief") -> list[Loop]:
    """Loops from the newest chunk of the belief to some earlier chunks, the best matches first."""
    newest = belief.count - 1
    candidates: list[tuple[int, Match]] = []
    old = np.nonzero(chunks.travel[newest] - chunks.travel[: newest - 1] >= _MIN_TRAVEL)[0]
    if not len(old):
        return []
    guesses, position_std, turn_std = belief.seen_from(old)
    distance = np.hypot(guesses[:, 0], guesses[:, 1])
    for row in np.nonzero(distance <= np.minimum(_MOST_DISTANCE, _GATE + _SIGMAS * position_std))[0]:
        shift = min(_MOST_SHIFT, _LEAST_WINDOW + _SIGMAS * position_std[row])
        turn = min(_MOST_TURN, _LEAST_TURN + _SIGMAS * turn_std[row])
        found = chunks.match(int(old[row]), newest, guesses[row], shift, turn, _LEAST_SCORE)
        if found.score > _LEAST_SCORE:
            candidates.append((int(old[row]), found))
    candidates.sort(key=lambda each: -each[1].score)
    return [
        chunks.loop(first, newest, found)
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
        _, jacobian = relation_factor(self.poses, newest, old, np.zeros((len(old), 3)))
        covariance = relation_covariances(jacobian, self.covariance, newest, old)
        position = np.sqrt(np.maximum(np.maximum(covariance[:, 0, 0], covariance[:, 1, 1]), 0.0))
        return se2.between(self.poses[old], self.poses[-1]), position, np.sqrt(np.maximum(covariance[:, 2, 2], 0.0))

    def extend(self, chunks: Chunks) -> None:
        """Go on with more chunks, of which the first are the chunks so far. Their hops may have changed."""
        more = len(chunks) - len(self._poses)
        self._chunks, self._poses = chunks, np.pad(self._poses, ((0, more), (0, 0)))
        self._covariance = np.pad(self._covariance, (0, 3 * more))
        self._solve()

    def close(self, found: Sequence[Loop]) -> None:
        """Add loops of the newest chunk."""
        if found:
            self.loops += found
            self._solve()

    def _solve(self) -> None:
        """Solve the graph of the chunks so far."""
        hops = self._chunks.hops
        self._poses[: self.count] = solve(self.poses, hops, self.loops, REFINING).poses
        self.covariance[:] = joint_covariance(self.poses, hops, self.loops)
