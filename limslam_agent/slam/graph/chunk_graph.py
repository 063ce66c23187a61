"""The pose graph of the chunks: hops between neighbours and loops, with robust kernels, solved by annealing.

Hops have a Cauchy kernel, so that wheel slip distorts the graph in one place only. Loops have dynamic covariance
scaling, so that a wrong loop loses its weight. Both kernels start wide and become narrow together. With narrow kernels
from the start, the graph would stay at the odometry poses, and right loops would be rejected.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limslam_agent.slam.graph.key_poses import KeyPoses, Trajectory, integrate
from limslam_agent.slam.graph.least_squares import relation_factor
from limslam_env.compilation import entry_of
from limslam_env.geometry import FloatArray, IntArray, se2

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)

PlaceArray = NDArray[np.int32]

# The covariance of a hop is the local graph's covariance times the first number, plus the squares of these standard
# deviations, m and rad.
_HOP_INFLATION, _HOP_POSITION, _HOP_TURN = 6.0, 0.03, math.radians(1.0)
HOP_KERNEL = 9.0
"""Scale of the Cauchy kernel of the hops, as a chi-square."""
LOOP_KERNEL = 3.0
"""The parameter of dynamic covariance scaling of the loops."""
# Successive factors of both kernels: from the chain of hops, and from a solution that is nearly right.
_ANNEALING, _REFINING = (1e4, 1e3, 300.0, 100.0, 30.0, 10.0, 3.0, 1.0), (10.0, 3.0, 1.0)
_ITERATIONS, _TOLERANCE = 8, 1e-3  # for each factor: at most, and the step (m, rad) below which they stop
KEPT_WEIGHT = 0.3
"""Loops with a lower weight are not used further."""


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


def hops_between(poses: FloatArray, covariances: FloatArray) -> Hops:
    """Hops along poses (c, 3), with inflated covariances (c - 1, 3, 3) of the local graph."""
    return Hops(se2.between(poses[:-1], poses[1:]), inflated(covariances))


def inflated(covariances: FloatArray) -> FloatArray:
    """Covariances (c, 3, 3) of motions by the local graph, as the graph of chunks uses them.

    The local graph trusts its associations. With its original covariances, right loops would be outweighed by the hops.
    """
    return _HOP_INFLATION * covariances + np.diag([_HOP_POSITION**2] * 2 + [_HOP_TURN**2])


def solve_annealed(start: FloatArray, hops: Hops, loops: Sequence[Loop]) -> ChunkSolution:
    """Solve with wide kernels first and narrow kernels last, from the chain of hops that begins at ``start`` (3,)."""
    poses = integrate(start, hops.motions)
    if not loops:
        return ChunkSolution(poses, np.zeros(0))
    return solve(poses, hops, loops, _ANNEALING, _ITERATIONS)


def refine(poses: FloatArray, hops: Hops, loops: Sequence[Loop]) -> ChunkSolution:
    """Solve from poses (c, 3) that are nearly right, with narrower first kernels."""
    return solve(poses, hops, loops, _REFINING, _ITERATIONS)


def solve(
    poses: FloatArray,
    hops: Hops,
    loops: Sequence[Loop],
    annealing: Sequence[float],
    iterations: int,
) -> ChunkSolution:
    """Solve from poses (c, 3), which may be fewer than the poses that the hops connect."""
    edges = _edges(hops, loops, len(poses))
    equations = _Elimination(edges[0], edges[1], len(poses))
    kinds = len(poses) - 1
    for factor in annealing:
        for _ in range(iterations):
            blocks, gradient, _ = _edge_blocks(poses, *edges, kinds, HOP_KERNEL * factor, LOOP_KERNEL * factor)
            step = equations.solve(blocks, gradient)
            poses = poses + step
            poses[:, 2] = se2.wrap_angle(poses[:, 2])
            if np.abs(step).max() < _TOLERANCE:
                break
    weights = _edge_blocks(poses, *edges, kinds, HOP_KERNEL, LOOP_KERNEL)[2]
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


def unbent(trajectory: Trajectory, local: Trajectory, middles: IntArray, hops: Hops, limit: float) -> Trajectory:
    """A trajectory that follows a local trajectory in each hop where the chi-square between both exceeds ``limit``.

    ``hops`` are the hops of the local trajectory between the key poses ``middles`` (c,). All later key poses move with
    a hop.
    """
    bent = hop_chi_squares(trajectory.poses[middles], hops) > limit
    if not bent.any():
        return trajectory
    steps = se2.between(trajectory.poses[:-1], trajectory.poses[1:])
    by_local = se2.between(local.poses[:-1], local.poses[1:])
    for begin, end in zip(middles[:-1][bent], middles[1:][bent], strict=True):
        steps[begin:end] = by_local[begin:end]
    return Trajectory(integrate(trajectory.poses[0], steps), trajectory.bias)


def hop_chi_squares(poses: FloatArray, hops: Hops) -> FloatArray:
    """How far the motions between poses (c, 3) are from the hops, as chi-squares (c - 1,)."""
    numbers = np.arange(len(poses) - 1)
    error, _ = relation_factor(poses, numbers, numbers + 1, hops.motions)
    return np.asarray(np.einsum("fi,fij,fj->f", error, np.linalg.inv(hops.covariances), error))


@dataclass(frozen=True, eq=False)
class Strain:
    """What a map costs because its path bends away from the local smoothing.

    Attributes
    ----------
    hops
        The hops (c - 1) of the local smoothing.
    kernel, weight
        Scale of the Cauchy kernel, as in the graph of chunks, and the cost of a mean of 1 after the kernel.
    """

    hops: Hops
    kernel: float
    weight: float

    def __call__(self, poses: FloatArray) -> float:
        """The cost of poses (c, 3) of the chunks."""
        return self.weight * self.total(poses) / max(1, len(poses) - 1)

    def total(self, poses: FloatArray) -> float:
        """The sum of the chi-squares of all hops along poses (c, 3), after the kernel."""
        if len(poses) < 2:
            return 0.0
        return self.kernel * float(np.log1p(hop_chi_squares(poses, self.hops) / self.kernel).sum())


def _edges(hops: Hops, loops: Sequence[Loop], count: int) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    chain = np.arange(count - 1)
    first = np.append(chain, [loop.first for loop in loops]).astype(np.int64)
    second = np.append(chain + 1, [loop.second for loop in loops]).astype(np.int64)
    measured = np.vstack((hops.motions[: count - 1], *[loop.relative for loop in loops]))
    information = np.concatenate(
        (np.linalg.inv(hops.covariances[: count - 1]), *[loop.information[None] for loop in loops])
    )
    return first, second, measured, information


class _Elimination:
    """The normal equations of a graph of ``count`` poses, solved by eliminating pose after pose.

    The first pose is fixed. The order of the elimination and the blocks that it fills are the same in all iterations.
    """

    def __init__(self, first: IntArray, second: IntArray, count: int) -> None:
        self._ends = first, second
        self._order, self._later, self._begins = _elimination_order(first, second, count)

    def solve(self, blocks: FloatArray, gradient: FloatArray) -> FloatArray:
        """The step (c, 3) for blocks (e, 6, 6) and gradients (e, 6) of the edges."""
        return _eliminate(*self._ends, blocks, gradient, self._order, self._later, self._begins)


@kernel
def _elimination_order(first: IntArray, second: IntArray, count: int) -> tuple[IntArray, IntArray, IntArray]:
    """Poses in the order of elimination by least degree, and the poses (k,) that each is then joined with.

    The neighbours of the n-th eliminated pose are the entries from ``begins[n]`` up to ``begins[n + 1]``. The fixed
    first pose has no equations.
    """
    joined = np.zeros((count, count), np.bool_)
    for e in range(len(first)):
        if first[e] and second[e] and first[e] != second[e]:
            joined[first[e], second[e]] = joined[second[e], first[e]] = True
    degree, left = joined.sum(axis=1), np.ones(count, np.bool_)
    left[0] = False
    order, later = np.empty(count - 1, np.int64), np.empty(count * count, np.int64)
    begins, written = np.zeros(count, np.int64), 0
    for n in range(count - 1):
        best = int(np.argmin(np.where(left, degree, count)))
        order[n], left[best] = best, False
        begin = written
        for i in range(1, count):
            if left[i] and joined[best, i]:
                later[written] = i
                written += 1
        for a in later[begin:written]:
            degree[a] -= 1
            for b in later[begin:written]:
                if a != b and not joined[a, b]:
                    joined[a, b] = True
                    degree[a] += 1
        begins[n + 1] = written
    return order, later[:written].copy(), begins


@kernel
def _inverse(matrix: FloatArray, out: FloatArray) -> None:
    """The inverse of a symmetric matrix (3, 3)."""
    a, b, c, d, e, f = matrix[0, 0], matrix[0, 1], matrix[0, 2], matrix[1, 1], matrix[1, 2], matrix[2, 2]
    out[0, 0], out[0, 1], out[0, 2] = d * f - e * e, c * e - b * f, b * e - c * d
    out[1, 1], out[1, 2], out[2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
    scale = 1.0 / (a * out[0, 0] + b * out[0, 1] + c * out[0, 2])
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    out *= scale


@kernel
def _subtract_product(out: FloatArray, left: FloatArray, right: FloatArray) -> None:
    """Subtract ``left @ right.T`` of matrices (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] -= left[i, 0] * right[j, 0] + left[i, 1] * right[j, 1] + left[i, 2] * right[j, 2]


@kernel
def _assembled(
    first: IntArray,
    second: IntArray,
    blocks: FloatArray,
    gradients: FloatArray,
    place: PlaceArray,
    rank: IntArray,
    filled: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sums over the edges: own blocks (c, 3, 3), blocks (k, 3, 3) between poses, right side (c, 3)."""
    count = len(rank)
    own, across, right = np.zeros((count, 3, 3)), np.zeros((filled, 3, 3)), np.zeros((count, 3))
    for e in range(len(first)):
        a, b = first[e], second[e]
        own[a] += blocks[e, :3, :3]
        own[b] += blocks[e, 3:, 3:]
        right[a] += gradients[e, :3]
        right[b] += gradients[e, 3:]
        if not a or not b or a == b:
            continue
        if rank[a] < rank[b]:
            across[place[b, a]] += blocks[e, 3:, :3]
        else:
            across[place[a, b]] += blocks[e, :3, 3:]
    return own, across, right


@kernel
def _eliminate(
    first: IntArray,
    second: IntArray,
    blocks: FloatArray,
    gradients: FloatArray,
    order: IntArray,
    later: IntArray,
    begins: IntArray,
) -> FloatArray:
    """Solve for the step (c, 3). Block (i, k) of the matrix is kept for each pose i that is eliminated after pose k."""
    count = len(order) + 1
    place, rank = np.empty((count, count), np.int32), np.zeros(count, np.int64)
    for n in range(count - 1):
        rank[order[n]] = n
        for at in range(begins[n], begins[n + 1]):
            place[later[at], order[n]] = at
    own, across, right = _assembled(first, second, blocks, gradients, place, rank, len(later))
    inverse, gain = np.empty((count, 3, 3)), np.empty((3, 3))
    for n in range(count - 1):
        k = order[n]
        _inverse(own[k], inverse[k])
        for at in range(begins[n], begins[n + 1]):
            i = later[at]
            gain[:] = 0.0
            # The inverse is symmetric. The gain is minus the product of the block and the inverse.
            _subtract_product(gain, across[at], inverse[k])
            for row in range(3):
                right[i, row] += gain[row, 0] * right[k, 0] + gain[row, 1] * right[k, 1] + gain[row, 2] * right[k, 2]
            gain *= -1.0
            for other in range(begins[n], begins[n + 1]):
                j = later[other]
                if j == i:
                    _subtract_product(own[i], gain, across[at])
                elif rank[j] < rank[i]:
                    _subtract_product(across[place[i, j]], gain, across[other])
    return _substitute(inverse, across, right, order, later, begins)


@kernel
def _substitute(
    inverse: FloatArray, across: FloatArray, right: FloatArray, order: IntArray, later: IntArray, begins: IntArray
) -> FloatArray:
    """The step (c, 3) by back substitution, from the last eliminated pose to the first."""
    step, rest = np.zeros_like(right), np.empty(3)
    for n in range(len(order) - 1, -1, -1):
        k = order[n]
        rest[:] = right[k]
        for at in range(begins[n], begins[n + 1]):
            for row in range(3):
                for column in range(3):
                    rest[row] += across[at, column, row] * step[later[at], column]
        for row in range(3):
            for column in range(3):
                step[k, row] -= inverse[k, row, column] * rest[column]
    return step


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
    by, product, error, weighted = np.zeros((3, 6)), np.empty((3, 6)), np.empty(3), np.empty(3)
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
        chi2 = 0.0
        for i in range(3):
            weighted[i] = 0.0
            for j in range(3):
                weighted[i] += information[e, i, j] * error[j]
            chi2 += error[i] * weighted[i]
        if e < hops:
            weight = 1.0 / (1.0 + chi2 / hop_kernel)
        else:
            weight = min(1.0, 2.0 * loop_kernel / (loop_kernel + chi2)) ** 2
        for u in range(6):
            gradients[e, u] = 0.0
            for i in range(3):
                gradients[e, u] += weight * by[i, u] * weighted[i]
                product[i, u] = 0.0
                for j in range(3):
                    product[i, u] += weight * information[e, i, j] * by[j, u]
        for u in range(6):
            for v in range(6):
                blocks[e, u, v] = by[0, u] * product[0, v] + by[1, u] * product[1, v] + by[2, u] * product[2, v]
        weights[e] = weight
    return blocks, gradients, weights
