"""What a solution is worth without knowing the truth: what it explains, less what it claims and what contradicts it."""

from dataclasses import dataclass

import numpy as np

from limslam_agent.config.smoother import ScoreConfig
from limslam_agent.slam.consistent.wall_extent import BIN
from limslam_agent.slam.line_graph import line_kernels as kernels
from limslam_agent.slam.line_graph.line_smoother import Problem, calibration_chi_square, wheel_chi_square
from limslam_agent.slam.line_graph.reassociation import Association, best_lines, ends_of, places_along
from limslam_env.geometry import FloatArray, IntArray

_THROUGH_SIGMAS, _THROUGH_SLACK = 3.0, 0.05


@dataclass(frozen=True, eq=False)
class Tally:
    """What beams say about each line, by bins of 5 cm along it.

    Attributes
    ----------
    low
        First bin (m,) of each line.
    hits, misses
        How many beams ended in each bin, and how many went through it, (m, b).
    against
        How many beams went through a wall of each line (m,).
    contradictions
        How many beams went through any wall.
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
    """The parts of a score, all of them costs.

    Attributes
    ----------
    wheels, looks
        Half the sums of squared residuals, in variances: of wheels and calibration, and of looks. A look counts for no
        more than half the clip.
    lines
        How many lines there are.
    total
        The score: the greater, the better.
    """

    wheels: float
    looks: float
    lines: int
    total: float


def score(problem: Problem, found: Association, config: ScoreConfig) -> Score:
    """The score of a solution: the log-likelihood of all wheels and looks, less a price for each line.

    A look ends at the first wall that its beam meets. A look that no wall predicts, or that goes through a wall, costs
    as much as ``clip`` says. So a second line close to a wall explains nothing more, whatever the noise.
    """
    misfits, _ = explained_looks(problem, found)
    wheels = 0.5 * (wheel_chi_square(problem, found.state) + calibration_chi_square(problem, found.state))
    looks = 0.5 * float(np.minimum(misfits**2, config.clip).sum())
    count = len(found.state.lines)
    return Score(wheels, looks, count, -wheels - looks - config.line * count)


def explained_looks(problem: Problem, found: Association) -> tuple[FloatArray, IntArray]:
    """How far each look is from the wall that its beam should meet (k,), in standard deviations, and the line (k,)."""
    looks, state, counted = problem.looks, found.state, tally(problem, found)
    misfits, best = np.empty(len(looks)), np.empty(len(looks), dtype=np.int64)
    biases = state.calibration[looks.places // problem.steps, 3]
    kernels.explain_looks(
        state.flat_poses, looks.places, problem.look_beams, looks.distances - biases, problem.is_hit, state.lines,
        state.anchors, counted.low, counted.hits, _margin(problem), misfits, best,
    )  # fmt: skip
    return misfits / problem.range_std, best


def line_values(problem: Problem, found: Association, config: ScoreConfig) -> FloatArray:
    """By how much each line (m,) raises the score, before its price, if no other line explains its looks."""
    misfits, best = explained_looks(problem, found)
    gains = 0.5 * (config.clip - np.minimum(misfits**2, config.clip))
    # A look that went through a wall would have cost nothing without that wall.
    gains[(misfits**2 >= config.clip) & ~problem.is_hit] = -0.5 * config.clip
    known = best >= 0
    return np.bincount(best[known], weights=gains[known], minlength=len(found.state.lines)).astype(float)


def explained_readings(problem: Problem, found: Association, beyond: float = 0.10) -> FloatArray:
    """How far each reading is from the nearest line that its beam meets (k,), in standard deviations."""
    ends = ends_of(problem, found.state, found.labels)
    return np.asarray(best_lines(problem, found.state, ends, beyond)[1][:, 0])


def _margin(problem: Problem) -> float:
    return _THROUGH_SIGMAS * problem.range_std + _THROUGH_SLACK
