"""The graph of chunks while it grows: loops are searched for each new chunk, and all loops are then weighed anew."""

import numpy as np

from limslam_agent.slam.graph.chunk_graph import Hops, Loop, inflated
from limslam_agent.slam.graph.local_maps import LocalMap
from limslam_agent.slam.graph.loop_search import Belief, Chunks, loops_of_newest
from limslam_agent.slam.graph.matching import SearchGrid
from limslam_agent.slam.graph.posterior import aligned_covariance
from limslam_env.geometry import FloatArray


class PlaceGraph:
    """The chunks so far, their loops, and their poses.

    Parameters
    ----------
    chunk, pose, covariance
        The first chunk, its pose (3,), and the covariance (3, 3) of this pose.
    """

    def __init__(self, chunk: LocalMap, pose: FloatArray, covariance: FloatArray) -> None:
        self._start, self._of_start = pose, covariance
        self._maps, self._grids = [chunk], dict[int, SearchGrid]()
        self._motions, self._covariances = np.zeros((0, 3)), np.zeros((0, 3, 3))
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
        belief.advance()
        belief.close(loops_of_newest(chunks, belief))

    @property
    def _chunks(self) -> Chunks:
        hops = Hops(self._motions, self._covariances)
        middles, travel = (np.array([getattr(each, name) for each in self._maps]) for name in ("middle", "travel"))
        return Chunks(self._maps, middles, self._start[None], travel, hops, _grids=self._grids)
