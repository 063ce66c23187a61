"""The graph of chunks: hops between neighbours and loops, the search for loops, and the solution by
annealing.

Each chunk is matched against earlier chunks that may show the same place. The joint covariance of
all chunks so far determines which ones can be near, and how wide the window of a match must be.
Each accepted loop reduces it.

Hops have a Cauchy kernel, so that wheel slip distorts the graph in one place only. Loops have
dynamic covariance scaling, so that a wrong loop loses its weight. Both kernels start wide and
become narrow together. With narrow kernels from the start, the graph would stay at the odometry
poses, and right loops would be rejected.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from limslam_agent.config.graph import LocalMapConfig
from limslam_agent.slam.graph.factors import cauchy, cauchy_cost, relation
from limslam_agent.slam.graph.graph import Factors, Graph, Nodes
from limslam_agent.slam.map_graph.factors import loop_cost, loop_kernel
from limslam_agent.slam.map_graph.key_poses import KeyPoses, Trajectory, integrate
from limslam_agent.slam.map_graph.local_maps import LocalMap
from limslam_agent.slam.map_graph.loops import SUPPORT_HOPS, Loop, agree, relations_of, supported
from limslam_agent.slam.map_graph.matching import (
    Match,
    SearchGrid,
    Window,
    match,
    match_covariance,
    search_grid,
)
from limslam_agent.slam.map_graph.posterior import rigid_motions
from limslam_env.geometry import FloatArray, IntArray, se2

# The covariance of a hop is the local graph's covariance times the first number, plus the squares
# of these standard deviations, m and rad.
_HOP_INFLATION = 6.0
_HOP_POSITION = 0.03
_HOP_TURN = math.radians(1.0)
_HOP_KERNEL = 9.0  # scale of the Cauchy kernel of the hops, as a chi-square
# Successive factors of both kernels, from the chain of hops on; the last two from a solution that
# is nearly right.
_ANNEALING = 1e4, 1e3, 300.0, 100.0, 30.0, 10.0, 3.0, 1.0
# for each factor: at most, and the step (m, rad) below which they stop
_ITERATIONS = 8
_TOLERANCE = 1e-3
KEPT_WEIGHT = 0.3
"""Loops with a lower weight are not used further."""
# the part that does not depend on the uncertainty, m and rad
_LEAST_WINDOW = 0.6
_LEAST_TURN = math.radians(8.0)
# How far from its believed pose a chunk is searched for: standard deviations that are added to the
# gate and to the window; the largest distance between two chunks, m; and the largest window, m and
# rad.
_SIGMAS = 2.5
_MOST_DISTANCE = 12.0
_MOST_SHIFT = 6.0
_MOST_TURN = math.radians(90.0)
# Chi-square by which another solution must cost less, before the path jumps to it
_CLEAR_GAIN = 4.0
SCORES = 0.50, 0.40
"""Least scores of a match, and of the match in the opposite direction."""
_BEST = 3  # loops from one chunk
_BACKWARD_WINDOW = Window(0.3, math.radians(4.0))
# chunks in which the newest one is searched, and search grids that are kept, 0.2 MB each
_MOST_SEARCHED = 150


@dataclass(frozen=True, eq=False)
class Hops:
    """Motions (c - 1, 3) from each chunk to the next, and their covariances (c - 1, 3, 3)."""

    motions: FloatArray
    covariances: FloatArray


def inflated(covariances: FloatArray) -> FloatArray:
    """Covariances (c, 3, 3) of motions by the local graph, as the graph of chunks uses them.

    The local graph trusts its associations. With its original covariances, right loops would be
    outweighed by the hops.
    """
    return _HOP_INFLATION * covariances + np.diag([_HOP_POSITION**2] * 2 + [_HOP_TURN**2])


def solve_annealed(
    start: FloatArray, hops: Hops, loops: Sequence[Loop]
) -> tuple[FloatArray, FloatArray]:
    """Poses (c, 3) of the chunks, from the chain of hops that begins at ``start`` (3,), and the
    weights of the loops.

    The kernels are wide first and narrow last.
    """
    chain = integrate(start, hops.motions)
    poses, _, weights = _solved(chain, hops, loops, _ANNEALING if loops else ())
    return poses, weights


def _solved(
    poses: FloatArray, hops: Hops, loops: Sequence[Loop], annealing: Sequence[float]
) -> tuple[FloatArray, Graph, FloatArray]:
    """The poses after kernels that are wider by successive factors, the graph about them, and the
    weights of the loops.
    """
    graph = Graph(Nodes(poses=(len(poses), 3)))
    first = np.arange(len(poses) - 1)
    certainty = np.asarray(np.linalg.inv(hops.covariances))
    chain = np.column_stack((first, first + 1)), hops.motions, certainty
    closures = relations_of(loops)

    def linearise(factor: float) -> FloatArray:
        graph.clear()
        graph.add_robust(relation(poses, *chain), cauchy(_HOP_KERNEL * factor))
        return graph.add_robust(relation(poses, *closures), loop_kernel(factor))

    for factor in annealing:
        for _ in range(_ITERATIONS):
            linearise(factor)
            step = graph.solve().reshape(-1, 3)
            poses = poses + step
            poses[:, 2] = se2.wrap_angle(poses[:, 2])
            if np.abs(step).max() < _TOLERANCE:
                break
    weights = linearise(1.0)
    return poses, graph, weights


def _cost(poses: FloatArray, hops: Hops, loops: Sequence[Loop]) -> float:
    """What all errors of hops and loops cost by their kernels, as a chi-square."""
    first = np.arange(len(poses) - 1)
    certainty = np.asarray(np.linalg.inv(hops.covariances))
    bent = relation(poses, np.column_stack((first, first + 1)), hops.motions, certainty)
    closures = relation(poses, *relations_of(loops))
    return float(cauchy_cost(_HOP_KERNEL, bent.chi2).sum() + loop_cost(closures.chi2).sum())


def carry_over(
    keys: KeyPoses, trajectory: Trajectory, middles: IntArray, poses: FloatArray
) -> Trajectory:
    """Move all key poses with the chunks; between chunks, interpolate the corrections by the
    distance driven.
    """
    old = trajectory.poses
    travel = keys.key_travel
    last = len(middles) - 1
    before = np.clip(np.searchsorted(middles, np.arange(len(keys)), side="right") - 1, 0, last)
    after = np.minimum(before + 1, last)
    begin = travel[middles[before]]
    share = np.clip((travel - begin) / np.maximum(travel[middles[after]] - begin, 1e-9), 0.0, 1.0)
    moved, other = (
        se2.compose(poses[ends], se2.between(old[middles[ends]], old)) for ends in (before, after)
    )
    apart = other - moved
    apart[:, 2] = se2.wrap_angle(apart[:, 2])
    moved += share[:, None] * apart
    moved[:, 2] = se2.wrap_angle(moved[:, 2])
    return Trajectory(moved, trajectory.bias)


class ChunkGraph:
    """The chunks so far in the order of driving, their poses, and the loops that were found between
    them.

    Parameters
    ----------
    chunk, pose
        The first chunk and its pose (3,), which is fixed.
    config
        The settings of chunks.
    judged_later
        Whether all loops are judged once all are found. Until then, all of them count.

    Attributes
    ----------
    config
        The settings of chunks.
    maps
        The c chunks.
    poses
        Their poses (c, 3).
    hops
        Motions from each chunk to the next.
    loops
        All loops that were found, both right and wrong.
    counting
        Those of them with which the graph is solved. The others wait for one that agrees.
    """

    def __init__(
        self,
        chunk: LocalMap,
        pose: FloatArray,
        config: LocalMapConfig,
        *,
        judged_later: bool = False,
    ) -> None:
        self.maps = [chunk]
        self.poses = pose[None]
        self.hops = Hops(np.zeros((0, 3)), np.zeros((0, 3, 3)))
        self.loops = list[Loop]()
        self.counting = list[Loop]()
        self._waiting = list[Loop]()
        self._judged_later = judged_later
        self._graph: Graph | None = None  # that of the poses
        self.config = config
        self._grid = lru_cache(_MOST_SEARCHED)(self._search_grid)

    @property
    def position_std(self) -> float:
        """Standard deviation of the last chunk's position in the map, m: after the alignment of all
        chunks.
        """
        poses = np.arange(len(self.poses))
        basis = rigid_motions(self.poses[:, :2])
        aligned = np.zeros((1, 2, len(poses), 3))
        rows = -basis[-2:] @ basis.T
        rows[:, -2:] += np.eye(2)
        aligned[..., :2] = rows.reshape(1, 2, -1, 2)
        keys = tuple(("poses", poses[[number]]) for number in poses)
        factors = Factors(keys, np.zeros((1, 2)), aligned.reshape(1, 2, -1))
        return float(np.sqrt(max(np.trace(self.covariances(factors)[0]), 0.0)))

    @property
    def last_covariance(self) -> FloatArray:
        """Covariance (3, 3) of the last chunk's pose, relative to the first chunk."""
        keys = (("poses", np.array([len(self.poses) - 1])),)
        return np.asarray(self.covariances(Factors(keys, np.zeros((1, 3)), np.eye(3)[None]))[0])

    def covariances(self, factors: Factors) -> FloatArray:
        """Covariances (f, d, d) of what factors measure, relative to the first chunk.

        The joint covariance of all poses is never made: it grows with the square of a drive's
        length.
        """
        if len(self.poses) == 1:
            return np.zeros((*factors.errors.shape, factors.errors.shape[1]))
        if self._graph is None:
            _, self._graph, _ = _solved(self.poses, self.hops, self.counting, ())
        return self._graph.covariances(factors)

    def add(self, chunk: LocalMap, motions: FloatArray, covariance: FloatArray) -> None:
        """Add a chunk, search for its loops, and solve the graph if it has changed.

        ``motions`` (h, 3) are the last hops, as they are known now. The last one leads to the new
        chunk, and has the covariance (3, 3).
        """
        before = self.hops.motions[: len(self.maps) - len(motions)]
        self.hops = Hops(
            np.vstack((before, motions)), np.concatenate((self.hops.covariances, covariance[None]))
        )
        self.maps.append(chunk)
        self.poses = np.vstack((self.poses, se2.compose(self.poses[-1], motions[-1])))
        self._graph = None
        found = self._loops_of_newest()
        if found or len(motions) > 1:
            self.close(found)

    def close(self, found: Sequence[Loop]) -> None:
        """Add loops, and solve the graph with those that count.

        If a loop that has begun to count is refused near the poses so far, the graph is also solved
        from the chain of hops on. That solution is taken if it clearly costs less.
        """
        self.loops += found
        begun = self._begin_to_count(found)
        loops = self.counting
        self.poses, self._graph, weights = _solved(self.poses, self.hops, loops, _ANNEALING[-2:])
        if (weights[len(loops) - begun :] < KEPT_WEIGHT).any():
            chain = integrate(self.poses[0], self.hops.motions)
            poses, graph, _ = _solved(chain, self.hops, loops, _ANNEALING)
            gain = _cost(self.poses, self.hops, loops) - _cost(poses, self.hops, loops)
            if gain > _CLEAR_GAIN:
                self.poses = poses
                self._graph = graph

    def _begin_to_count(self, found: Sequence[Loop]) -> int:
        """How many of the loops that were found, or that have waited, count from now on: those that
        are not doubtful, and those with which the graph or another loop agrees.
        """
        if self._judged_later:
            self.counting += found
            return 0
        waiting = [*self._waiting, *found]
        travel = np.array([each.travel for each in self.maps])
        # A loop is supported by loops of a few chunks before and after.
        recent = [each for each in self.loops if each.second >= len(travel) - 2 * SUPPORT_HOPS - 1]
        good = supported(recent, self.poses, travel, self.config.hop)
        agreed = {loop for loop, is_good in zip(recent, good, strict=True) if is_good}
        ends, relative, _ = relations_of(waiting)
        near = agree(se2.between(*self.poses[ends.T]), relative)
        counts = [
            is_near or not loop.is_doubtful or loop in agreed
            for loop, is_near in zip(waiting, near, strict=True)
        ]
        self.counting += [loop for loop, each in zip(waiting, counts, strict=True) if each]
        self._waiting = [loop for loop, each in zip(waiting, counts, strict=True) if not each]
        return sum(counts)

    def _loops_of_newest(self) -> list[Loop]:
        """Loops from the newest chunk to some earlier chunks, the best matches first."""
        newest = len(self.maps) - 1
        travel = np.array([each.travel for each in self.maps])
        is_old = travel[newest] - travel[: newest - 1] >= self.config.another_visit
        old = np.flatnonzero(is_old)
        guesses = se2.between(self.poses[old], self.poses[newest])
        searched = _some_near(np.hypot(guesses[:, 0], guesses[:, 1]))
        if not len(searched):
            return []
        old = old[searched]
        guesses = guesses[searched]
        position_std, turn_std = self._stds_from(old)
        # Chunks within a hop show the same place, however well their poses are known.
        near = np.hypot(guesses[:, 0], guesses[:, 1]) <= self.config.hop + _SIGMAS * position_std
        points = self.maps[newest].points
        matches = list[tuple[Match, int, bool]]()
        for row in np.flatnonzero(near):
            window = search_window(position_std[row], turn_std[row])
            first = int(old[row])
            # A match that is worse than all that are kept is of no use.
            least = matches[-1][0].score if len(matches) == _BEST else SCORES[0]
            best = match(self._grid(first), points, guesses[row], window, max(least, SCORES[0]))
            # In a window that is cut, the place may well lie outside of it.
            found = best, first, window.shift >= _MOST_SHIFT
            matches = sorted([*matches, found], key=lambda each: -each[0].score)[:_BEST]
        loops = [self._loop(first, newest, best, is_cut) for best, first, is_cut in matches]
        return [loop for loop in loops if loop is not None]

    def _loop(self, first: int, second: int, best: Match, is_doubtful: bool) -> Loop | None:
        """A loop with the covariance of its match; None if the chunks do not match in both
        directions.
        """
        least, least_back = SCORES
        if best.score <= least:
            return None
        back = self._grid(second)
        others = self.maps[first].points
        again = match(back, others, se2.inverse(best.pose), _BACKWARD_WINDOW, least_back)
        if again.score < least_back:
            return None
        points = self.maps[second].points
        mean, covariance = match_covariance(self._grid(first), points, best.pose, (back, others))
        information = np.asarray(np.linalg.inv(covariance))
        return Loop(first, second, mean, information, best.score, is_doubtful)

    def _stds_from(self, old: IntArray) -> tuple[FloatArray, FloatArray]:
        """Standard deviations (k,), m and rad, of the newest chunk's pose in the frames of old
        chunks (k,).
        """
        ends = np.column_stack((np.full(len(old), len(self.poses) - 1), old))
        covariance = self.covariances(relation(self.poses, ends, np.zeros((len(old), 3))))
        position = np.sqrt(np.maximum(np.maximum(covariance[:, 0, 0], covariance[:, 1, 1]), 0.0))
        return position, np.sqrt(np.maximum(covariance[:, 2, 2], 0.0))

    def _search_grid(self, number: int) -> SearchGrid:
        chunk = self.maps[number]
        return search_grid(chunk.grid, chunk.cell, _MOST_SHIFT)


def search_window(position_std: float, turn_std: float) -> Window:
    """The window in which a chunk is searched whose pose has these standard deviations, m and
    rad.
    """
    return Window(
        min(_MOST_SHIFT, _LEAST_WINDOW + _SIGMAS * float(position_std)),
        min(_MOST_TURN, _LEAST_TURN + _SIGMAS * float(turn_std)),
    )


def _some_near(distance: FloatArray) -> IntArray:
    """Those of the chunks at distances (k,), m, that are searched: of many, some of each distance.

    Where a robot has been so often, the others show the same.
    """
    near = np.flatnonzero(distance <= _MOST_DISTANCE)
    chosen = np.linspace(0, len(near) - 1, min(len(near), _MOST_SEARCHED)).astype(np.int64)
    return np.sort(near[np.argsort(distance[near], kind="stable")[chosen]])


def search_loops(
    maps: Sequence[LocalMap], start: FloatArray, hops: Hops, config: LocalMapConfig
) -> list[Loop]:
    """All loops that the search accepts between chunks (c,), of which the first one has the pose
    ``start`` (3,).
    """
    graph = ChunkGraph(maps[0], start, config, judged_later=True)
    for chunk, motion, covariance in zip(maps[1:], hops.motions, hops.covariances, strict=True):
        graph.add(chunk, motion[None], covariance)
    return graph.loops
