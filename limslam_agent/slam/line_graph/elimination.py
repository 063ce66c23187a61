"""Elimination of the poses of all chains, block by block.

A chain of poses is cut into blocks. The poses inside a block are eliminated one after another. They are coupled to the
lines that were read inside the block, to the calibration, and to the two poses at the ends of the block. What remains
are the last pose of each block, the calibration, and the lines. In a chain without blocks, each eliminated pose would
be coupled to all lines that were read before it. The time would then grow with the length of the run times the square
of the number of lines (A. George, "Nested dissection of a regular finite element mesh", 1973).
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from limslam_agent.slam.line_graph import chain_kernels as kernels
from limslam_env.geometry import BoolArray, FloatArray, IntArray

POSE = 3

_BLOCK = 400  # poses of a block, about


class DegenerateError(ValueError):
    """The equations of a step cannot be solved: the lines and readings do not determine the poses."""


class Couplings(NamedTuple):
    """The readings of one chain, sorted by step: step, line, row of derivatives, and weight of each (k, ...)."""

    steps: IntArray
    lines: IntArray
    rows: FloatArray
    weights: FloatArray

    def between(self, first: int, last: int) -> "Couplings":
        """The readings of the steps after ``first`` up to ``last``, with steps counted from ``first``."""
        own = self.select(slice(*np.searchsorted(self.steps, (first + 1, last + 1)).tolist()))
        return own._replace(steps=own.steps - first)

    def select(self, which: BoolArray | slice) -> "Couplings":
        """Some of the readings, by a mask (k,) or a slice."""
        return Couplings(self.steps[which], self.lines[which], self.rows[which], self.weights[which])


class Chain(NamedTuple):
    """The normal equations of one chain of t poses.

    Attributes
    ----------
    diagonal, below
        Blocks of each pose (t, 3, 3), and of each pose with the previous pose (t - 1, 3, 3).
    border
        Coupling of each pose to the calibration (t, 3, c).
    right
        Right side (t, 3).
    couplings
        The readings, which couple the poses to lines.
    """

    diagonal: FloatArray
    below: FloatArray
    border: FloatArray
    right: FloatArray
    couplings: Couplings


@dataclass(frozen=True, eq=False)
class Block:
    """The factors of the poses inside a block.

    Attributes
    ----------
    robot, first, last
        The chain, and the steps of the two poses at the ends of the block. The last pose remains, as does the first
        pose, unless it is the known start.
    kept
        Rows of the last pose among the remaining variables.
    columns
        The remaining variables (m,) that the poses are coupled to, besides the last pose.
    lower, gains, coupled, solved
        The results of :func:`.chain_kernels.eliminate`.
    """

    robot: int
    first: int
    last: int
    kept: slice
    columns: IntArray
    lower: FloatArray
    gains: FloatArray
    coupled: FloatArray
    solved: FloatArray

    def add_to(self, dense: FloatArray, right: FloatArray) -> None:
        """Add what the elimination leaves to the equations of the remaining variables."""
        kept, columns = self.kept, self.columns
        window = self.coupled[:-1].reshape(POSE * (len(self.coupled) - 1), len(columns))
        dense[kept, kept] += self.lower[-1]
        dense[kept, columns] += self.coupled[-1]
        dense[columns, kept] += self.coupled[-1].T
        dense[np.ix_(columns, columns)] -= window.T @ window
        right[kept] += self.solved[-1]
        right[columns] -= window.T @ self.solved[:-1].ravel()

    def substitute(self, remaining: FloatArray, moves: FloatArray) -> None:
        """Fill in the changes ``moves`` (t, 3) of the chain's poses in this block from the remaining variables."""
        moves[self.last] = remaining[self.kept]
        own = moves[self.first : self.last + 1]
        kernels.substitute(self.lower, self.gains, self.coupled, self.solved, remaining[self.columns], own)

    def marginals(self, covariance: FloatArray, covariances: FloatArray) -> None:
        """Fill in the covariances (t, 3, 3) of the chain's poses in this block.

        ``covariance`` is the joint covariance of the remaining variables.
        """
        covariances[self.last] = covariance[self.kept, self.kept]
        shared = covariance[np.ix_(self.columns, self.columns)]
        with_shared = np.ascontiguousarray(covariance[self.kept][:, self.columns])
        own = covariances[self.first : self.last + 1]
        kernels.pose_marginals(self.lower, self.gains, self.coupled, shared, with_shared, own)


@dataclass(frozen=True, eq=False)
class Factored:
    """Factorised equations: the factors of all blocks, and those of the remaining variables.

    The remaining variables are the last pose of each block, the calibrations of all robots, and the lines.

    Attributes
    ----------
    blocks
        All blocks, by robot and then by step.
    scale, cholesky
        The factors of the remaining variables' equations. ``scale`` is the inverse square root of their diagonal.
    first_shared, first_line
        Index of the first remaining variable that is no pose, and of the first line.
    """

    blocks: tuple[Block, ...]
    scale: FloatArray
    cholesky: tuple[FloatArray, bool]
    first_shared: int
    first_line: int

    @cached_property
    def covariance(self) -> FloatArray:
        """Joint covariance of the remaining variables."""
        return np.asarray(self.scale[:, None] * cho_solve(self.cholesky, np.eye(len(self.scale))) * self.scale)

    @property
    def last_pose(self) -> IntArray:
        """Indices (3,) of the last pose of the last chain among the remaining variables."""
        kept = self.blocks[-1].kept
        return np.arange(kept.start, kept.stop)

    @property
    def lines(self) -> FloatArray:
        """Joint covariance (2 m, 2 m) of all lines."""
        return self.covariance[self.first_line :, self.first_line :]

    def solve(self, right: FloatArray) -> FloatArray:
        """The remaining variables for a right side."""
        return np.asarray(self.scale * cho_solve(self.cholesky, self.scale * right))


def eliminated(chains: list[Chain], shared: FloatArray, shared_right: FloatArray) -> tuple[Factored, FloatArray]:
    """Eliminate all poses but the last one of each block, and factorise the rest; the factors and the right side.

    Parameters
    ----------
    chains
        The equations of each robot's poses.
    shared, shared_right
        The equations of calibration and lines.

    Raises
    ------
    DegenerateError
        If the equations cannot be solved.
    """
    ends = block_ends(len(chains[0].diagonal))
    spans = list(pairwise(ends))
    poses = POSE * len(spans) * len(chains)
    first_line = poses + chains[0].border.shape[2]
    dense, right = np.zeros((poses + len(shared), poses + len(shared))), np.zeros(poses + len(shared))
    dense[poses:, poses:], right[poses:] = shared, shared_right
    blocks = []
    for robot, chain in enumerate(chains):
        for number, span in enumerate(spans):
            kept = slice(POSE * (len(spans) * robot + number), POSE * (len(spans) * robot + number + 1))
            blocks.append(_block(robot, chain, span, kept, poses))
            blocks[-1].add_to(dense, right)
    return Factored(tuple(blocks), *_factors(dense), poses, first_line), right


def block_ends(steps: int) -> list[int]:
    """The steps at which the blocks of a chain begin and end, from 0 to the last step."""
    count = max(1, round((steps - 1) / _BLOCK))
    return [round(each) for each in np.linspace(0, steps - 1, count + 1).tolist()]


def _block(robot: int, chain: Chain, ends: tuple[int, int], kept: slice, poses: int) -> Block:
    """Eliminate the poses inside a block. Calibration and lines follow ``poses`` remaining variables of poses."""
    first, last = ends
    own, calibrated = slice(first, last + 1), chain.border.shape[2]
    before = POSE if first else 0
    border = np.zeros((last - first + 1, POSE, before + calibrated))
    border[:, :, before:] = chain.border[own]
    if before:
        # The first pose is not eliminated. The next pose is coupled to it as to the calibration.
        border[1, :, :before] = chain.below[first]
    readings = chain.couplings.between(first, last)
    readings = readings.select(readings.weights != 0.0)
    labels, lines = _numbered(readings.lines)
    columns = np.concatenate((
        np.arange(kept.start - before, kept.start),
        np.arange(poses, poses + calibrated),
        (poses + calibrated + 2 * lines[:, None] + np.arange(2)).ravel(),
    ))  # fmt: skip
    lower, gains, coupled = (np.zeros((len(border), POSE, width)) for width in (POSE, POSE, len(columns)))
    solved = np.zeros((len(border), POSE))
    kernels.eliminate(
        chain.diagonal[own], chain.below[first:last], border, chain.right[own],
        readings.steps, labels, readings.rows, readings.weights, lower, gains, coupled, solved,
    )  # fmt: skip
    return Block(robot, first, last, kept, columns, lower, gains, coupled, solved)


def _numbered(lines: IntArray) -> tuple[IntArray, IntArray]:
    """Number each reading's line in the order of first readings: the numbers (k,), and the lines in this order (m,).

    The elimination is fastest in this order.
    """
    known, firsts, inverse = np.unique(lines, return_index=True, return_inverse=True)
    order = np.argsort(firsts)
    ranks = np.empty_like(order)
    ranks[order] = np.arange(len(order))
    return ranks[inverse], known[order]


def _factors(dense: FloatArray) -> tuple[FloatArray, tuple[FloatArray, bool]]:
    """Scale and Cholesky factor of a matrix whose diagonal is first scaled to ones."""
    diagonal = np.diag(dense)
    if not (np.isfinite(dense).all() and (diagonal > 0.0).all()):
        raise DegenerateError("the readings do not determine the poses")
    scale = diagonal**-0.5
    try:
        return scale, cho_factor(scale[:, None] * dense * scale + 1e-15 * np.eye(len(dense)))
    except np.linalg.LinAlgError as error:
        raise DegenerateError("the readings do not determine the poses") from error
