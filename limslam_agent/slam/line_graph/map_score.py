"""The score of a solution without ground truth: likelihood of the measurements, minus a price for each line."""

from dataclasses import dataclass

import numpy as np

from limslam_agent.kernels.tables import BIN
from limslam_agent.slam.line_graph import line_kernels as kernels
from limslam_agent.slam.line_graph.line_smoother import calibration_chi_square, wheel_chi_square
from limslam_agent.slam.line_graph.problem import Problem
from limslam_agent.slam.line_graph.reassociation import Association, best_lines, faces_of, places_along
from limslam_env.geometry import FloatArray, IntArray

_THROUGH_SIGMAS, _THROUGH_SLACK = 3.0, 0.05
_CLIP = 16.0  # largest squared residual of a look, in variances
LINE_PRICE = 24.0
"""What a line costs, in logarithms of the likelihood."""


@dataclass(frozen=True, eq=False)
class Tally:
    """Counts of the beams that confirm or contradict each line, in bins of 5 cm along the line.

    Attributes
    ----------
    low
        Index of the first bin of each line (m,).
    hits, misses
        Numbers (m, b) of beams that ended in each bin, and of beams that passed through it.
    against
        Number (m,) of beams that passed through a wall of each line.
    contradictions
        Number of beams that passed through any wall.
    """

    low: IntArray
    hits: IntArray
    misses: IntArray
    against: IntArray
    contradictions: int


def tally(problem: Problem, found: Association) -> Tally:
    """Count hits and misses along the lines of a solution."""
    state, labels, looks = found.state, found.labels, problem.looks
    used = labels >= 0
    bins = np.floor(places_along(problem, state, labels)[used] / BIN).astype(np.int64)
    count = len(state.lines)
    low, high = np.full(count, np.iinfo(np.int64).max), np.full(count, np.iinfo(np.int64).min)
    np.minimum.at(low, labels[used], bins)
    np.maximum.at(high, labels[used], bins)
    hits = np.zeros((count, int((high - low).max(initial=0)) + 1), dtype=np.int64)
    np.add.at(hits, (labels[used], bins - low[labels[used]]), 1)
    misses, against = np.zeros_like(hits), np.zeros(count, dtype=np.int64)
    contradictions = kernels.count_crossings(
        state.flat_poses, looks.places, problem.look_beams, looks.distances, state.lines, state.anchors,
        low, hits, _margin(problem), misses, against,
    )  # fmt: skip
    return Tally(low, hits, misses, against, contradictions)


@dataclass(frozen=True)
class Score:
    """The parts of a score. Every part is a cost.

    Attributes
    ----------
    wheels, looks
        Half the sums of squared residuals, divided by variances: of wheels and calibration, and of looks. Each look
        contributes at most half the clip.
    lines
        Number of lines.
    total
        The score; a greater score is better.
    """

    wheels: float
    looks: float
    lines: int
    total: float


def score(problem: Problem, found: Association) -> Score:
    """The score of a solution: the log-likelihood of all wheels and looks, minus a price for each line.

    A beam is expected to end at the first wall that it meets. A look that no wall predicts, or that passes through a
    wall, costs as much as the largest residual. A second line close to a wall therefore does not raise the likelihood,
    whatever the noise.
    """
    misfits, _ = explained_looks(problem, found)
    wheels = 0.5 * (wheel_chi_square(problem, found.state) + calibration_chi_square(problem, found.state))
    looks = 0.5 * float(np.minimum(misfits**2, _CLIP).sum())
    count = len(found.state.lines)
    return Score(wheels, looks, count, -wheels - looks - LINE_PRICE * count)


def explained_looks(problem: Problem, found: Association) -> tuple[FloatArray, IntArray]:
    """The residual (k,) of each look to its expected wall, in standard deviations, and the line (k,)."""
    looks, state, counted = problem.looks, found.state, tally(problem, found)
    misfits, best = np.empty(len(looks)), np.empty(len(looks), dtype=np.int64)
    biases = state.calibration[looks.places // problem.steps, 3]
    kernels.explain_looks(
        state.flat_poses, looks.places, problem.look_beams, looks.distances - biases, problem.is_hit, state.lines,
        state.anchors, counted.low, counted.hits, _margin(problem), problem.beam_width, misfits, best,
    )  # fmt: skip
    return misfits / problem.range_std / problem.look_noise, best


def line_values(problem: Problem, found: Association) -> FloatArray:
    """The amount by which each line (m,) raises the score, before its price, if no other line explains its looks."""
    misfits, best = explained_looks(problem, found)
    gains = 0.5 * (_CLIP - np.minimum(misfits**2, _CLIP))
    # Without the wall, a look that passed through it would have cost nothing.
    gains[(misfits**2 >= _CLIP) & ~problem.is_hit] = -0.5 * _CLIP
    known = best >= 0
    return np.bincount(best[known], weights=gains[known], minlength=len(found.state.lines)).astype(float)


def explained_readings(problem: Problem, found: Association) -> FloatArray:
    """The residual (k,) of each reading to the nearest line that its beam meets, in standard deviations."""
    ends = faces_of(problem, found.state, found.labels)
    return np.asarray(best_lines(problem, found.state, ends)[1][:, 0])


def _margin(problem: Problem) -> float:
    return _THROUGH_SIGMAS * problem.range_std + _THROUGH_SLACK
