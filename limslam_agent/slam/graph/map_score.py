"""What a solution is worth without knowing the truth: what it explains, less what it claims and what contradicts it."""

from dataclasses import dataclass

import numpy as np

from limslam_agent.config.smoother import ScoreConfig
from limslam_agent.slam.consistent.wall_extent import BIN
from limslam_agent.slam.graph import line_kernels as kernels
from limslam_agent.slam.graph.line_smoother import Problem, wheel_chi_square
from limslam_agent.slam.graph.reassociation import Association, best_lines, ends_of, places_along
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
    margin = _THROUGH_SIGMAS * problem.range_std + _THROUGH_SLACK
    contradictions = kernels.count_crossings(
        state.flat_poses, looks.places, problem.look_beams, looks.distances, state.lines, state.anchors,
        low, hits, margin, misses, against,
    )  # fmt: skip
    return Tally(low, hits, misses, against, contradictions)


@dataclass(frozen=True)
class Score:
    """The parts of a score, all of them costs.

    Attributes
    ----------
    wheels, readings
        Half the sum of squared residuals, in variances; of a reading no more than the clip.
    contradictions, lines
        How many beams went through walls, and how many lines there are.
    total
        The score: the greater, the better.
    """

    wheels: float
    readings: float
    contradictions: int
    lines: int
    total: float


def score(problem: Problem, found: Association, config: ScoreConfig) -> Score:
    """The score of a solution.

    Readings are compared with the line that predicts them best, whether they were used for it or not, and readings
    that no line predicts cost as much as ``clip`` says. So a line is worth its price only if it predicts readings that
    no other line does.
    """
    misfits = explained_by_lines(problem, found)
    wheels = 0.5 * wheel_chi_square(problem, found.state)
    readings = 0.5 * float(np.minimum(misfits**2, config.clip).sum())
    against = tally(problem, found).contradictions
    count = len(found.state.lines)
    total = -wheels - readings - config.contradiction * against - config.line * count
    return Score(wheels, readings, against, count, total)


def explained_by_lines(problem: Problem, found: Association, beyond: float = 0.05) -> FloatArray:
    """How far each reading is from the nearest line that its beam meets (k,), in standard deviations."""
    ends = ends_of(problem, found.state, found.labels)
    return np.asarray(best_lines(problem, found.state, ends, beyond)[1][:, 0])
