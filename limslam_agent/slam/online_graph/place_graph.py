"""The graph of chunks while it grows: loops are searched for each new chunk, and all loops are then weighed anew.

A chunk is first matched with the chunks that are near by the present solution. Where the path has bent unnoticed, such
as by slip of the wheels, the robot is not near any place that it knows, and no match succeeds. The chunk is therefore
also searched for in wide windows, from the second chunk without a loop on.
"""

from collections.abc import Sequence

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.agreement import PRUNE_GAIN, MapScore, accept_groups
from limslam_agent.slam.graph.chunk_graph import ChunkSolution, Hops, Loop, inflated, solve_annealed
from limslam_agent.slam.graph.key_poses import integrate
from limslam_agent.slam.graph.local_maps import LocalMap
from limslam_agent.slam.graph.loop_search import Belief, Chunks, loops_of_newest
from limslam_agent.slam.graph.matching import SearchGrid
from limslam_agent.slam.graph.posterior import aligned_covariance
from limslam_agent.slam.graph.wide_search import search_for_newest
from limslam_env.geometry import FloatArray, se2

_UNRECOGNISED = 2
"""The wide search begins at this number of successive chunks without a loop."""

_SAME_PLACE = 3.0, np.radians(30.0)
"""Groups of loops of one chunk contradict each other if they place it farther apart than this, m and rad."""

_LIKELY = 11.3
"""Chi-square of three degrees of freedom that is exceeded once in a hundred times."""

_GAIN = 0.02
"""A group of the wide search must raise the score by this. On logs, right groups raised it by 0.05 and more."""


class PlaceGraph:
    """The chunks so far, their loops, and their poses.

    Parameters
    ----------
    config
        The settings.
    chunk, pose, covariance
        The first chunk, its pose (3,), and the covariance (3, 3) of this pose.
    """

    def __init__(self, config: GraphConfig, chunk: LocalMap, pose: FloatArray, covariance: FloatArray) -> None:
        self._config, self._start, self._of_start = config, pose, covariance
        self._maps, self._grids = [chunk], dict[int, SearchGrid]()
        self._motions, self._covariances = np.zeros((0, 3)), np.zeros((0, 3, 3))
        self._near, self._wide = list[Loop](), list[list[Loop]]()
        self._unrecognised = 0
        self._belief = Belief(self._chunks)

    def __len__(self) -> int:
        """The number of chunks."""
        return len(self._maps)

    @property
    def poses(self) -> FloatArray:
        """Poses (c, 3) of the chunks."""
        return self._belief.poses.copy()

    @property
    def covariance(self) -> FloatArray:
        """Covariance (3, 3) of the last chunk's pose."""
        x, y, _ = self._belief.poses[-1] - self._start
        turned = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
        return np.asarray(self._belief.covariance[-3:, -3:] + turned @ self._of_start @ turned.T)

    @property
    def position_std(self) -> float:
        """Standard deviation of the last chunk's position in the map, m: after the alignment of all chunks."""
        poses = self._belief.poses
        columns = (3 * np.arange(len(poses))[:, None] + np.arange(2)).ravel()
        left = aligned_covariance(self._belief.covariance[np.ix_(columns, columns)], poses[:, :2])
        return float(np.sqrt(max(np.trace(left[-2:, -2:]), 0.0)))

    @property
    def loops(self) -> list[Loop]:
        """All loops that the graph contains."""
        return list(self._belief.loops)

    def add(self, chunk: LocalMap, motions: FloatArray, covariance: FloatArray) -> None:
        """Add a chunk, search for its loops, and solve the graph.

        Parameters
        ----------
        chunk
            The next chunk.
        motions
            Motions (h, 3) of the last hops, as they are known now. The last motion leads to the new chunk.
        covariance
            Covariance (3, 3) of the last motion by the local graph.
        """
        self._maps.append(chunk)
        self._motions = np.vstack((self._motions, motions[-1:]))
        self._motions[-len(motions) :] = motions
        self._covariances = np.concatenate((self._covariances, inflated(covariance[None])))
        chunks, belief = self._chunks, self._belief
        belief.extend(chunks)
        belief.poses[:] = self._solved(chunks, belief.count, self._loops).poses
        belief.advance()
        near = loops_of_newest(chunks, belief)
        self._near += near
        self._unrecognised = 0 if near else self._unrecognised + 1
        wide = self._search_widely(chunks) if self._unrecognised >= _UNRECOGNISED else []
        if near or wide:
            self._close(chunks, wide)

    @property
    def _chunks(self) -> Chunks:
        hops = Hops(self._motions, self._covariances)
        poses = integrate(self._start, self._motions)
        middles, travel = (np.array([getattr(each, name) for each in self._maps]) for name in ("middle", "travel"))
        return Chunks(self._maps, middles, poses, travel, hops, self._config, self._grids)

    @property
    def _loops(self) -> list[Loop]:
        """The loops along the way, and those of the groups of the wide search."""
        return self._near + [loop for group in self._wide for loop in group]

    def _solved(self, chunks: Chunks, count: int, loops: Sequence[Loop]) -> ChunkSolution:
        """The solution of the first chunks with these loops."""
        hops = Hops(chunks.hops.motions[: count - 1], chunks.hops.covariances[: count - 1])
        return solve_annealed(self._start, hops, loops)

    def _search_widely(self, chunks: Chunks) -> list[list[Loop]]:
        """Groups of loops for the newest chunk that are likely by what is believed and do not contradict each other.

        One corridor looks like another, and wrong groups raise the score of the map as much as right ones.
        """
        belief = self._belief
        groups = search_for_newest(chunks, belief.poses, belief.covariance)
        places = [se2.compose(belief.poses[group[0].first], group[0].relative) for group in groups]
        if not places:
            return []
        apart = se2.between(places[0], np.array(places))
        is_clear = np.hypot(*apart[:, :2].T).max() < _SAME_PLACE[0] and np.abs(apart[:, 2]).max() < _SAME_PLACE[1]
        return [group for group in groups if belief.chi_square(group[0]) < _LIKELY] if is_clear else []

    def _close(self, chunks: Chunks, groups: Sequence[Sequence[Loop]]) -> None:
        """Weigh all loops anew, with those new groups of the wide search that raise the score of the map."""
        score = MapScore.of(chunks.maps) if groups or self._wide else None
        if groups and score is not None:
            loops = self._loops
            found = accept_groups(chunks.poses, chunks.hops, loops, groups, score, _GAIN, near=False)
            more = found.loops[len(loops) :]
            if more:
                self._wide.append(more)
                self._unrecognised = 0
        solution = self._solved(chunks, len(chunks), self._loops)
        if self._wide and score is not None:
            solution = self._without_doubtful(chunks, solution, score)
        self._belief.adopt(self._loops, solution)

    def _without_doubtful(self, chunks: Chunks, solution: ChunkSolution, score: MapScore) -> ChunkSolution:
        """The solution after those groups of the wide search have been removed without which the score is higher."""
        value = score(solution.poses)
        for group in list(self._wide):
            loops = [loop for loop in self._loops if not any(loop is each for each in group)]
            trial = self._solved(chunks, len(chunks), loops)
            without = score(trial.poses)
            if without > value + PRUNE_GAIN:
                self._wide.remove(group)
                value, solution = without, trial
        return solution
