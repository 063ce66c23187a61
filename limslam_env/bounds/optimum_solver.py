"""Gauss-Newton over all poses and lines of a log, for :mod:`limslam_env.bounds.offline_optimum`.

gtsam factors the sparse equations of each step; residuals and Jacobians are whole arrays, as a Python callback for
each factor would take minutes. What a step changes are the motions, and the poses are walked again from them: so the
path stays one that wheels can drive, and a large correction of a heading turns all that comes after it rigidly.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from limslam_env.bounds.optimum_model import GRAZING, Expected, Readings, expected_readings, motion_jacobians, walk
from limslam_env.geometry import FloatArray

if TYPE_CHECKING:
    import gtsam

# What keeps the equations of a line regular that was read only once, m and rad; others do not feel it.
LINE_STD = np.array([100.0, 10.0])
CLOSE = 1e-7  # m or rad; a step that moves no pose by more is the last
_MOST_STEPS, _MOST_HALVINGS = 50, 12


@dataclass(frozen=True, eq=False)
class Problem:
    """What was measured, and how surely.

    Attributes
    ----------
    axle
        Of the robots, m.
    starts
        Poses (n, 3), known for sure.
    motions, motion_stds
        (t - 1, n, 3), m.
    readings, range_std
        What the beams read, and its standard deviation, m.
    anchors, guess
        (m, 2), m, and (m, 2), m and rad: where the lines are about, and where they begin.
    """

    axle: float
    starts: FloatArray
    motions: FloatArray
    motion_stds: FloatArray
    readings: Readings
    range_std: float
    anchors: FloatArray
    guess: FloatArray


@dataclass(frozen=True, eq=False)
class State:
    """What is solved for: motions (t - 1, n, 3), with the poses (t, n, 3) that they lead to, and lines (m, 2)."""

    motions: FloatArray
    poses: FloatArray
    lines: FloatArray


@dataclass(frozen=True)
class Solution:
    """An optimum, the steps that it took, and whether the last of them was a whole one and a small one."""

    state: State
    iterations: int
    is_converged: bool


def solve(problem: Problem, state: State) -> Solution:
    """The optimum near a state."""
    ordering, total = None, cost(problem, state)
    for iteration in range(1, _MOST_STEPS + 1):
        graph = _linearised(problem, state)
        ordering = ordering or _ordering(graph)
        try:
            motion_step, line_step = _step(problem, state, graph, ordering)
        except RuntimeError:  # gtsam's word for equations too ill-conditioned to solve
            break
        for halving in range(_MOST_HALVINGS):
            share = 0.5**halving
            new = moved_to(problem, state.motions + share * motion_step, state.lines + share * line_step)
            change, new_total = float(np.abs(new.poses - state.poses).max()), cost(problem, new)
            # Near the optimum rounding alone decides which of two costs is the lower.
            if new_total <= total or change < CLOSE:
                break
        else:
            break
        state, total = new, new_total
        if change < CLOSE:
            return Solution(state, iteration, halving == 0)
    return Solution(state, iteration, is_converged=False)


def cost(problem: Problem, state: State) -> float:
    """What is minimised: the sum of the squares of all residuals, in standard deviations."""
    far = (state.lines - problem.guess) / LINE_STD
    return chi_square(problem, state) + float(np.sum(far[np.unique(problem.readings.line)] ** 2))


def chi_square(problem: Problem, state: State) -> float:
    """The sum of the squared residuals of wheels and beams, in standard deviations."""
    driven = (state.motions - problem.motions) / problem.motion_stds
    read = (expected(problem, state).distance - problem.readings.distance) / problem.range_std
    return float(np.sum(driven**2) + np.sum(read**2))


def expected(problem: Problem, state: State) -> Expected:
    """What each beam should read."""
    readings = problem.readings
    poses = state.poses[readings.step, readings.robot]
    return expected_readings(poses, state.lines[readings.line], problem.anchors[readings.line], readings)


def without_grazing(problem: Problem, state: State) -> Problem:
    """The problem without the readings that graze their lines as they are in a state."""
    kept = np.abs(expected(problem, state).cosine) >= GRAZING
    return replace(problem, readings=problem.readings.where(kept))


def moved_to(problem: Problem, motions: FloatArray, lines: FloatArray) -> State:
    """The state with motions (t - 1, n, 3) and lines (m, 2)."""
    return State(motions, walk(problem.starts, motions, problem.axle), lines)


def _linearised(problem: Problem, state: State) -> "gtsam.GaussianFactorGraph":
    """The equations of a step: of the poses after the start, which is known, then of the lines that are read."""
    import gtsam

    graph = gtsam.GaussianFactorGraph()
    _add_motions(graph, problem, state)
    _add_readings(graph, problem, state)
    first = _line_key(state)
    pull, weights = (problem.guess - state.lines) / LINE_STD, np.diag(1.0 / LINE_STD)
    for line in np.unique(problem.readings.line).tolist():
        graph.add(first + line, weights, pull[line])
    return graph


def _add_motions(graph: "gtsam.GaussianFactorGraph", problem: Problem, state: State) -> None:
    steps, robots, _ = state.motions.shape
    before, after = motion_jacobians(state.poses, state.motions, problem.axle)
    before /= problem.motion_stds[..., None]
    after /= problem.motion_stds[..., None]
    residual = (problem.motions - state.motions) / problem.motion_stds
    for step in range(steps):
        for robot in range(robots):
            key = step * robots + robot
            if step == 0:
                graph.add(key, after[step, robot], residual[step, robot])
            else:
                graph.add(key - robots, before[step, robot], key, after[step, robot], residual[step, robot])


def _add_readings(graph: "gtsam.GaussianFactorGraph", problem: Problem, state: State) -> None:
    """One factor for all readings that one pose has of one line."""
    readings, first = problem.readings, _line_key(state)
    robots = len(problem.starts)
    pose, line = (readings.step - 1) * robots + readings.robot, readings.line
    order = np.lexsort((line, pose))
    pose, line = pose[order], line[order]
    should = expected(problem, state)
    by_pose, by_line = should.by_pose[order] / problem.range_std, should.by_line[order] / problem.range_std
    residual = ((readings.distance - should.distance) / problem.range_std)[order]
    begins = np.flatnonzero(np.append(True, (np.diff(pose) != 0) | (np.diff(line) != 0)))
    ends = np.append(begins[1:], len(pose))
    for begin, end, key, number in zip(
        begins.tolist(), ends.tolist(), pose[begins].tolist(), line[begins].tolist(), strict=True
    ):
        if key < 0:
            graph.add(first + number, by_line[begin:end], residual[begin:end])
        else:
            graph.add(key, by_pose[begin:end], first + number, by_line[begin:end], residual[begin:end])


def _line_key(state: State) -> int:
    """Key of the first line: the poses after the start come before it."""
    return len(state.motions) * len(state.poses[0])


def _ordering(graph: "gtsam.GaussianFactorGraph") -> "gtsam.Ordering":
    import gtsam

    return gtsam.Ordering.ColamdGaussianFactorGraph(graph)


def _step(
    problem: Problem, state: State, graph: "gtsam.GaussianFactorGraph", ordering: "gtsam.Ordering"
) -> tuple[FloatArray, FloatArray]:
    """Changes of motions (t - 1, n, 3) and lines (m, 2) that solve the equations."""
    import gtsam

    # Shifts are known a thousand times as exactly as readings. Cholesky would factor the square of that ratio, which
    # costs too many digits. QR does not square it.
    values = graph.optimize(ordering, gtsam.EliminateQR)
    count = _line_key(state)
    seen = np.unique(problem.readings.line)
    poses = np.zeros_like(state.poses)
    poses[1:] = values.vector(list(range(count))).reshape(state.motions.shape)
    lines = np.zeros_like(state.lines)
    lines[seen] = values.vector([count + line for line in seen.tolist()]).reshape(-1, 2)
    before, after = motion_jacobians(state.poses, state.motions, problem.axle)
    return np.einsum("snij,snj->sni", before, poses[:-1]) + np.einsum("snij,snj->sni", after, poses[1:]), lines
