"""The search for loops: each chunk is matched against earlier chunks that may show the same place.

The search processes the chunks in order, as in online operation. The joint covariance of all chunks so far determines
which earlier chunks can be near, and how wide the window of a match must be. Each accepted loop reduces the covariance.
"""

import math
from collections.abc import Sequence

import numpy as np

from limslam_agent.slam.graph.chunk_graph import ANNEALING, Hops, Loop, joint_covariance, solve
from limslam_agent.slam.graph.key_poses import ANOTHER_VISIT
from limslam_agent.slam.graph.least_squares import relation_covariances, relation_factor
from limslam_agent.slam.graph.local_maps import LocalMap
from limslam_agent.slam.graph.matching import Match, SearchGrid, Window, match, match_covariance, search_grid
from limslam_agent.slam.graph.posterior import aligned_covariance
from limslam_env.geometry import FloatArray, IntArray, se2

_GATE = 2.5  # m: chunks within this distance show the same place, however well their poses are known
_LEAST_WINDOW, _LEAST_TURN = 0.6, math.radians(8.0)  # the part that does not depend on the uncertainty, m and rad
TURN_STEP = math.radians(3.0)
"""Step of the turns of a match, rad."""
# How far from its believed pose a chunk is searched for: standard deviations that are added to the gate and to the
# window; the largest distance between two chunks, m; and the largest window, m and rad.
_SIGMAS, _MOST_DISTANCE, _MOST_SHIFT, _MOST_TURN = 2.5, 12.0, 4.0, math.radians(35.0)
SCORES, SCORES_WHILE_DRIVING = (0.50, 0.40), (0.60, 0.50)
"""Least scores of a match, and of the match in the opposite direction. While the robot drives, no later visit has
contradicted a loop yet, so a match must be better.
"""
_BEST = 3  # loops from one chunk
_BACKWARD_WINDOW = Window(0.3, math.radians(4.0), TURN_STEP)


class ChunkGraph:
    """The chunks so far in the order of driving, their poses, and the loops that were found between them.

    Parameters
    ----------
    chunk, pose
        The first chunk and its pose (3,), which is fixed.
    scores
        Least scores of a match, and of the match in the opposite direction.

    Attributes
    ----------
    maps
        The c chunks.
    poses
        Their poses (c, 3).
    covariance
        Joint covariance (3 c, 3 c) of their poses, relative to the first chunk.
    hops
        Motions from each chunk to the next.
    loops
        All loops that the search has accepted, both right and wrong.
    """

    def __init__(self, chunk: LocalMap, pose: FloatArray, scores: tuple[float, float] = SCORES) -> None:
        self._scores = scores
        self.maps, self.poses, self.covariance = [chunk], pose[None], np.zeros((3, 3))
        self.hops, self.loops = Hops(np.zeros((0, 3)), np.zeros((0, 3, 3))), list[Loop]()
        self._grids = dict[int, SearchGrid]()

    @property
    def position_std(self) -> float:
        """Standard deviation of the last chunk's position in the map, m: after the alignment of all chunks."""
        columns = (3 * np.arange(len(self.poses))[:, None] + np.arange(2)).ravel()
        left = aligned_covariance(self.covariance[np.ix_(columns, columns)], self.poses[:, :2])
        return float(np.sqrt(max(np.trace(left[-2:, -2:]), 0.0)))

    def add(self, chunk: LocalMap, motions: FloatArray, covariance: FloatArray) -> None:
        """Add a chunk, search for its loops, and solve the graph if it has changed.

        Parameters
        ----------
        chunk
            The next chunk.
        motions
            Motions (h, 3) of the last hops, as they are known now. The last motion leads to the new chunk.
        covariance
            Covariance (3, 3) of the last motion.
        """
        before = self.hops.motions[: len(self.maps) - len(motions)]
        self.hops = Hops(np.vstack((before, motions)), np.concatenate((self.hops.covariances, covariance[None])))
        self.maps.append(chunk)
        by_pose, by_motion = se2.compose_jacobians(self.poses[-1], motions[-1])
        across = by_pose @ self.covariance[-3:]
        own = across[:, -3:] @ by_pose.T + by_motion @ covariance @ by_motion.T
        self.covariance = np.block([[self.covariance, across.T], [across, own]])
        self.poses = np.vstack((self.poses, se2.compose(self.poses[-1], motions[-1])))
        self.close(self._loops_of_newest())
        if len(motions) > 1:
            self._solve()

    def close(self, found: Sequence[Loop]) -> None:
        """Add loops."""
        if found:
            self.loops += found
            self._solve()

    def _loops_of_newest(self) -> list[Loop]:
        """Loops from the newest chunk to some earlier chunks, the best matches first."""
        candidates: list[tuple[int, Match]] = []
        newest, travel = len(self.maps) - 1, np.array([each.travel for each in self.maps])
        old = np.nonzero(travel[newest] - travel[: newest - 1] >= ANOTHER_VISIT)[0]
        if not len(old):
            return []
        guesses, position_std, turn_std = self._seen_from(old)
        distance = np.hypot(guesses[:, 0], guesses[:, 1])
        least, _ = self._scores
        for row in np.nonzero(distance <= np.minimum(_MOST_DISTANCE, _GATE + _SIGMAS * position_std))[0]:
            shift = min(_MOST_SHIFT, _LEAST_WINDOW + _SIGMAS * position_std[row])
            turn = min(_MOST_TURN, _LEAST_TURN + _SIGMAS * turn_std[row])
            window = Window(shift, turn, TURN_STEP)
            found = match(self._grid(int(old[row])), self.maps[newest].points, guesses[row], window, least)
            if found.score > least:
                candidates.append((int(old[row]), found))
        candidates.sort(key=lambda each: -each[1].score)
        loops = [self._loop(first, newest, found) for first, found in candidates[:_BEST]]
        return [loop for loop in loops if loop is not None]

    def _loop(self, first: int, second: int, found: Match) -> Loop | None:
        """A loop with the covariance of its match; None if the chunks do not match in the opposite direction."""
        back, others = self._grid(second), self.maps[first].points
        _, least = self._scores
        again = match(back, others, se2.inverse(found.pose), _BACKWARD_WINDOW, least)
        if again.score < least:
            return None
        grid, points = self._grid(first), self.maps[second].points
        mean, covariance = match_covariance(grid, points, found.pose, TURN_STEP, (back, others))
        return Loop(first, second, mean, np.asarray(np.linalg.inv(covariance)), found.score)

    def _seen_from(self, old: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The newest chunk's pose in the frames of old chunks (k, 3), and its standard deviations (k,), m and rad."""
        newest = np.full(len(old), len(self.poses) - 1)
        _, jacobian = relation_factor(self.poses, newest, old, np.zeros((len(old), 3)))
        covariance = relation_covariances(jacobian, self.covariance, newest, old)
        position = np.sqrt(np.maximum(np.maximum(covariance[:, 0, 0], covariance[:, 1, 1]), 0.0))
        return se2.between(self.poses[old], self.poses[-1]), position, np.sqrt(np.maximum(covariance[:, 2, 2], 0.0))

    def _grid(self, number: int) -> SearchGrid:
        if number not in self._grids:
            self._grids[number] = search_grid(self.maps[number], _MOST_SHIFT)
        return self._grids[number]

    def _solve(self) -> None:
        self.poses = solve(self.poses, self.hops, self.loops, ANNEALING[-2:]).poses
        self.covariance = joint_covariance(self.poses, self.hops, self.loops)


def search_loops(maps: Sequence[LocalMap], start: FloatArray, hops: Hops) -> list[Loop]:
    """All loops that the search accepts between chunks (c,), of which the first one has the pose ``start`` (3,)."""
    graph = ChunkGraph(maps[0], start)
    for chunk, motion, covariance in zip(maps[1:], hops.motions, hops.covariances, strict=True):
        graph.add(chunk, motion[None], covariance)
    return graph.loops
