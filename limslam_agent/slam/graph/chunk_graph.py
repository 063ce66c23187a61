"""The pose graph of the chunks: hops between neighbours and loops, with robust kernels, solved by annealing.

Hops have a Cauchy kernel, so that wheel slip distorts the graph in one place only. Loops have dynamic covariance
scaling, so that a wrong loop loses its weight. Both kernels start wide and become narrow together. With narrow kernels
from the start, the graph would stay at the odometry poses, and right loops would be rejected.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limslam_agent.slam.graph.key_poses import KeyPoses, Trajectory, integrate
from limslam_agent.slam.graph.least_squares import loop_weights, pose_columns, relation_factor
from limslam_agent.slam.least_squares.normal_equations import NormalEquations
from limslam_env.geometry import FloatArray, IntArray, se2

# The covariance of a hop is the local graph's covariance times the first number, plus the squares of these standard
# deviations, m and rad.
_HOP_INFLATION, _HOP_POSITION, _HOP_TURN = 6.0, 0.03, math.radians(1.0)
HOP_KERNEL = 9.0
"""Scale of the Cauchy kernel of the hops, as a chi-square."""
LOOP_KERNEL = 3.0
"""The parameter of dynamic covariance scaling of the loops."""
ANNEALING = 1e4, 1e3, 300.0, 100.0, 30.0, 10.0, 3.0, 1.0
"""Successive factors of both kernels, from the chain of hops on; the last two from a solution that is nearly right."""
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
    """

    first: int
    second: int
    relative: FloatArray
    information: FloatArray
    score: float


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


def inflated(covariances: FloatArray) -> FloatArray:
    """Covariances (c, 3, 3) of motions by the local graph, as the graph of chunks uses them.

    The local graph trusts its associations. With its original covariances, right loops would be outweighed by the hops.
    """
    return _HOP_INFLATION * covariances + np.diag([_HOP_POSITION**2] * 2 + [_HOP_TURN**2])


def solve_annealed(start: FloatArray, hops: Hops, loops: Sequence[Loop]) -> ChunkSolution:
    """Solve with wide kernels first and narrow kernels last, from the chain of hops that begins at ``start`` (3,)."""
    poses = integrate(start, hops.motions)
    return solve(poses, hops, loops, ANNEALING) if loops else ChunkSolution(poses, np.zeros(0))


def solve(poses: FloatArray, hops: Hops, loops: Sequence[Loop], annealing: Sequence[float]) -> ChunkSolution:
    """Solve from poses (c, 3), which may be fewer than the poses that the hops connect."""
    edges = _edges(hops, loops, len(poses))
    for factor in annealing:
        for _ in range(_ITERATIONS):
            step = _equations(poses, edges, factor)[0].solve().reshape(-1, 3)
            poses = poses + step
            poses[:, 2] = se2.wrap_angle(poses[:, 2])
            if np.abs(step).max() < _TOLERANCE:
                break
    return ChunkSolution(poses, _equations(poses, edges, 1.0)[1][len(poses) - 1 :])


def joint_covariance(poses: FloatArray, hops: Hops, loops: Sequence[Loop]) -> FloatArray:
    """Joint covariance (3 c, 3 c) of the poses (c, 3) of a solution. The first pose is fixed."""
    equations, _ = _equations(poses, _edges(hops, loops, len(poses)), 1.0)
    return equations.solved(equations.factorise(), np.eye(equations.size))


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


_Edges = tuple[IntArray, IntArray, FloatArray, FloatArray]
"""First and second poses (e,) of hops and loops, and their relative poses (e, 3) and information (e, 3, 3)."""


def _edges(hops: Hops, loops: Sequence[Loop], count: int) -> _Edges:
    chain = np.arange(count - 1)
    first = np.append(chain, [loop.first for loop in loops]).astype(np.int64)
    second = np.append(chain + 1, [loop.second for loop in loops]).astype(np.int64)
    measured = np.vstack((hops.motions[: count - 1], *[loop.relative for loop in loops]))
    information = np.concatenate(
        (np.linalg.inv(hops.covariances[: count - 1]), *[loop.information[None] for loop in loops])
    )
    return first, second, measured, information


def _equations(poses: FloatArray, edges: _Edges, factor: float) -> tuple[NormalEquations, FloatArray]:
    """The normal equations with kernels that are wider by a factor, and the weights (e,) of the edges."""
    first, second, measured, information = edges
    error, jacobian = relation_factor(poses, first, second, measured)
    chi2 = np.einsum("fi,fij,fj->f", error, information, error)
    weights = 1.0 / (1.0 + chi2 / (HOP_KERNEL * factor))
    loops = slice(len(poses) - 1, None)
    weights[loops] = loop_weights(error[loops], information[loops], LOOP_KERNEL * factor)
    equations = NormalEquations(3 * len(poses))
    columns = np.hstack((pose_columns(first), pose_columns(second)))
    equations.add(columns, jacobian, error, information * weights[:, None, None])
    return equations, weights
