"""The pose graph of the chunks: hops between neighbours and loops, with robust kernels, solved by annealing.

Hops have a Cauchy kernel, so that wheel slip distorts the graph in one place only. Loops have dynamic covariance
scaling, so that a wrong loop loses its weight. Both kernels start wide and become narrow together. With narrow kernels
from the start, the graph would stay at the odometry poses, and right loops would be rejected.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from limslam_agent.config.graph import ChunkGraphConfig
from limslam_agent.slam.graph.key_poses import KeyPoses, Trajectory, integrate
from limslam_agent.slam.graph.least_squares import relation_factor
from limslam_env.compilation import entry_of
from limslam_env.geometry import FloatArray, IntArray, se2

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)


@dataclass(frozen=True, eq=False)
class Loop:
    """A relative pose between two chunks.

    Attributes
    ----------
    first, second
        The chunk whose grid was searched, and the chunk whose points were matched.
    relative
        Pose (3,) of the second chunk in the frame of the first chunk.
    information
        Inverse (3, 3) of the covariance of the relative pose.
    score
        Score of the match.
    source
        The stage that found the loop.
    """

    first: int
    second: int
    relative: FloatArray
    information: FloatArray
    score: float
    source: str


@dataclass(frozen=True, eq=False)
class Hops:
    """Motions (c - 1, 3) from each chunk to the next, and their covariances (c - 1, 3, 3)."""

    motions: FloatArray
    covariances: FloatArray


@dataclass(frozen=True, eq=False)
class ChunkSolution:
    """Poses (c, 3) of the chunks, and the weights of the loops."""

    poses: FloatArray
    weights: FloatArray


def hops_between(poses: FloatArray, covariances: FloatArray, config: ChunkGraphConfig) -> Hops:
    """Hops along poses (c, 3), with inflated covariances (c - 1, 3, 3) of the local graph.

    The local graph trusts its associations. With its original covariances, right loops would be outweighed by the hops.
    """
    least = np.diag([config.hop_position**2, config.hop_position**2, config.hop_turn**2])
    return Hops(se2.between(poses[:-1], poses[1:]), config.hop_inflation * covariances + least)


def solve_annealed(start: FloatArray, hops: Hops, loops: Sequence[Loop], config: ChunkGraphConfig) -> ChunkSolution:
    """Solve with wide kernels first and narrow kernels last, from the chain of hops that begins at ``start`` (3,)."""
    poses = integrate(start, hops.motions)
    if not loops:
        return ChunkSolution(poses, np.zeros(0))
    return solve(poses, hops, loops, config, config.annealing, config.iterations)


def refine(poses: FloatArray, hops: Hops, loops: Sequence[Loop], config: ChunkGraphConfig) -> ChunkSolution:
    """Solve from poses (c, 3) that are nearly right, with narrower first kernels."""
    return solve(poses, hops, loops, config, config.refining, config.iterations)


def solve(
    poses: FloatArray,
    hops: Hops,
    loops: Sequence[Loop],
    config: ChunkGraphConfig,
    annealing: Sequence[float],
    iterations: int,
) -> ChunkSolution:
    """Solve from poses (c, 3), which may be fewer than the poses that the hops connect."""
    edges = _edges(hops, loops, len(poses))
    pattern = _Pattern(edges[0], edges[1], len(poses))
    kinds = len(poses) - 1
    for factor in annealing:
        for _ in range(iterations):
            blocks, gradient, _ = _edge_blocks(
                poses, *edges, kinds, config.hop_kernel * factor, config.loop_kernel * factor
            )
            step = pattern.solve(blocks, gradient)
            poses = poses + step
            poses[:, 2] = se2.wrap_angle(poses[:, 2])
            if np.abs(step).max() < config.tolerance:
                break
    weights = _edge_blocks(poses, *edges, kinds, config.hop_kernel, config.loop_kernel)[2]
    return ChunkSolution(poses, weights[kinds:])


def information_matrix(poses: FloatArray, hops: Hops, loops: Sequence[Loop], weights: FloatArray) -> FloatArray:
    """Information matrix (3 c, 3 c) of all poses, with weighted loops and a fixed first pose."""
    first, second, measured, information = _edges(hops, loops, len(poses))
    weight = np.append(np.ones(len(poses) - 1), weights)
    _, jacobian = relation_factor(poses, first, second, measured)
    blocks = jacobian.transpose(0, 2, 1) @ (information * weight[:, None, None]) @ jacobian
    columns = np.hstack((3 * first[:, None] + np.arange(3), 3 * second[:, None] + np.arange(3)))
    matrix = np.zeros((3 * len(poses), 3 * len(poses)))
    np.add.at(matrix, (columns[:, :, None], columns[:, None, :]), blocks)
    matrix[:3, :3] += 1e9 * np.eye(3)
    return matrix


def carry_over(keys: KeyPoses, trajectory: Trajectory, middles: IntArray, poses: FloatArray) -> Trajectory:
    """Move all key poses with the chunks; between chunks, interpolate the corrections by the distance driven."""
    old, travel = trajectory.poses, keys.key_travel
    numbers = np.arange(len(keys))
    before = np.clip(np.searchsorted(middles, numbers, side="right") - 1, 0, len(middles) - 1)
    after = np.minimum(before + 1, len(middles) - 1)
    span = np.maximum(travel[middles[after]] - travel[middles[before]], 1e-9)
    share = np.clip((travel - travel[middles[before]]) / span, 0.0, 1.0)
    moved = se2.compose(poses[before], se2.between(old[middles[before]], old))
    other = se2.compose(poses[after], se2.between(old[middles[after]], old))
    apart = other - moved
    apart[:, 2] = se2.wrap_angle(apart[:, 2])
    moved += share[:, None] * apart
    moved[:, 2] = se2.wrap_angle(moved[:, 2])
    return Trajectory(moved, trajectory.bias)


def _edges(hops: Hops, loops: Sequence[Loop], count: int) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    chain = np.arange(count - 1)
    first = np.append(chain, [loop.first for loop in loops]).astype(np.int64)
    second = np.append(chain + 1, [loop.second for loop in loops]).astype(np.int64)
    measured = np.vstack((hops.motions[: count - 1], *[loop.relative for loop in loops]))
    information = np.concatenate(
        (np.linalg.inv(hops.covariances[: count - 1]), *[loop.information[None] for loop in loops])
    )
    return first, second, measured, information


class _Pattern:
    """Positions of the edges' blocks in the sparse matrix, which are the same in all iterations."""

    def __init__(self, first: IntArray, second: IntArray, count: int) -> None:
        self._columns = np.hstack((3 * first[:, None] + np.arange(3), 3 * second[:, None] + np.arange(3)))
        self._size = 3 * count
        rows, columns = np.repeat(self._columns, 6, axis=1).ravel(), np.tile(self._columns, (1, 6)).ravel()
        free = (rows >= 3) & (columns >= 3)
        self._used = np.nonzero(free)[0]
        inner = self._size - 3
        places, self._place = np.unique((columns[free] - 3) * inner + rows[free] - 3, return_inverse=True)
        self._indices = (places % inner).astype(np.int32)
        self._pointers = np.searchsorted(places // inner, np.arange(inner + 1)).astype(np.int32)

    def solve(self, blocks: FloatArray, gradient: FloatArray) -> FloatArray:
        """The step (c, 3) for blocks (e, 6, 6) and gradients (e, 6)."""
        values = np.bincount(self._place, blocks.ravel()[self._used], len(self._indices))
        inner = self._size - 3
        matrix = csc_matrix((values, self._indices, self._pointers), shape=(inner, inner))
        right = np.bincount(self._columns.ravel(), gradient.ravel(), self._size)
        options = {"SymmetricMode": True}
        factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        step = np.zeros(self._size)
        step[3:] = -factors.solve(right[3:])
        return step.reshape(-1, 3)


@kernel
def _edge_blocks(
    poses: FloatArray,
    first: IntArray,
    second: IntArray,
    measured: FloatArray,
    information: FloatArray,
    hops: int,
    hop_kernel: float,
    loop_kernel: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weighted blocks (e, 6, 6), gradients (e, 6) and weights (e,) of the edges. The hops come first."""
    count = len(first)
    blocks, gradients, weights = np.empty((count, 6, 6)), np.empty((count, 6)), np.empty(count)
    by, error = np.zeros((3, 6)), np.empty(3)
    for e in range(count):
        a, b = poses[first[e]], poses[second[e]]
        cos, sin = np.cos(a[2]), np.sin(a[2])
        dx, dy = b[0] - a[0], b[1] - a[1]
        x, y = cos * dx + sin * dy, cos * dy - sin * dx
        turn = b[2] - a[2] - measured[e, 2]
        error[0], error[1] = x - measured[e, 0], y - measured[e, 1]
        error[2] = np.pi - (np.pi - turn) % (2.0 * np.pi)
        by[0, 0], by[0, 1], by[0, 2], by[0, 3], by[0, 4] = -cos, -sin, y, cos, sin
        by[1, 0], by[1, 1], by[1, 2], by[1, 3], by[1, 4] = sin, -cos, -x, -sin, cos
        by[2, 2], by[2, 5] = -1.0, 1.0
        weighted = information[e] @ error
        chi2 = error[0] * weighted[0] + error[1] * weighted[1] + error[2] * weighted[2]
        if e < hops:
            weight = 1.0 / (1.0 + chi2 / hop_kernel)
        else:
            weight = min(1.0, 2.0 * loop_kernel / (loop_kernel + chi2)) ** 2
        gradients[e] = weight * (by.T @ weighted)
        blocks[e] = weight * (by.T @ (information[e] @ by))
        weights[e] = weight
    return blocks, gradients, weights
