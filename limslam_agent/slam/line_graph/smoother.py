"""Smoothing a finished run: from what was observed and what the filter made of it to all poses at once, and the map."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from limslam_agent.config.smoother import SmootherConfig
from limslam_agent.slam.core.diagnostics import AssociationRecord, Closure
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.line_graph.line_smoother import (
    DegenerateError,
    Problem,
    make_problem,
    pose_covariances,
    solve,
    state_from_poses,
)
from limslam_agent.slam.line_graph.map_score import score
from limslam_agent.slam.line_graph.mending import is_contradicted, mend
from limslam_agent.slam.line_graph.reassociation import Association, reassociate
from limslam_agent.slam.line_graph.smoothed_map import smoothed_landmarks, smoothed_segments
from limslam_env.geometry import BoolArray, FloatArray, IntArray, no_rows
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import NominalNoise, RobotSpec


@dataclass(frozen=True, eq=False)
class FilteredRun:
    """A run of n robots in t steps: what was observed, and what the filter made of it.

    Attributes
    ----------
    robot, noise
        Body and beams of each robot, and what its builder knows of its noise.
    wheels, ranges
        (t, n, 2) and (t, n, n_beams), m: the observations; row 0 is the moment of the reset.
    usable
        (t, n, n_beams), which readings are of walls, not perhaps of other robots.
    poses, covariances
        What the filter believed at each step (t, n, 3) and (t, n, 3, 3); the first poses are the known starts.
    associations, closures
        What became of observed lines, and which landmarks were merged, in order.
    """

    robot: RobotSpec
    noise: NominalNoise
    wheels: FloatArray
    ranges: FloatArray
    usable: BoolArray
    poses: FloatArray
    covariances: FloatArray
    associations: list[AssociationRecord]
    closures: list[Closure]


@dataclass(frozen=True, eq=False)
class SmoothedRun:
    """What is known of a run at its end.

    Attributes
    ----------
    poses, covariances
        (t, n, 3), m and rad, and (t, n, 3, 3).
    landmarks, segments
        The lines with covariances, and the walls (k, 4) as they are drawn, m.
    calibration
        (n, 4), the shares by which left wheel, right wheel and axle are larger than specified, and what all ranges read
        too much, m; None where the robots are taken to be as specified.
    moves
        By which moves the associations were mended; empty where that was not needed, or did not help.
    """

    poses: FloatArray
    covariances: FloatArray
    landmarks: list[Landmark]
    segments: FloatArray
    calibration: FloatArray | None
    moves: tuple[str, ...]


def smooth_run(run: FilteredRun, config: SmootherConfig | None = None) -> SmoothedRun:
    """All poses and lines of a run by all that was known at its end.

    The filter's associations are where the smoother begins; none of them is final. Where beams contradict the result,
    or where the filter's heading was unsure, wrong associations are looked for, too. Where there is nothing to smooth,
    because the robots did not move or no wall was seen often enough, the filter's poses are given back.
    """
    config = config or SmootherConfig()
    prior = config.calibration if config.calibrate == "always" else None
    problem = make_problem(run.robot, run.noise, run.poses[0], run.wheels, run.ranges, run.usable, prior)
    labels = filter_labels(problem, run.associations, run.closures)
    if problem.steps < 2 or np.count_nonzero(labels >= 0) < config.reassociation.fewest:
        return _unsmoothed(run)
    try:
        best = _settled(problem, run, labels, config)
        if config.calibrate == "if_needed" and _may_need_calibration(best, config):
            sized = replace(problem, prior=config.calibration.information)
            best = max(best, _settled(sized, run, labels, config), key=lambda each: each.worth(config))
    except DegenerateError:
        return _unsmoothed(run)
    return _smoothed(best, config)


@dataclass(frozen=True, eq=False)
class _Settled:
    """A solution with its problem, and the moves by which it was mended."""

    problem: Problem
    association: Association
    moves: tuple[str, ...]

    def worth(self, config: SmootherConfig) -> float:
        """The score, less what a calibration has to gain to be believed."""
        price = 0.0 if self.problem.prior is None else config.calibration_price
        return score(self.problem, self.association, config.score).total - price


def _settled(problem: Problem, run: FilteredRun, labels: IntArray, config: SmootherConfig) -> _Settled:
    """The solution for a problem, mended where that is needed."""
    found = reassociate(problem, state_from_poses(problem, run.poses), labels, config.reassociation)
    if not needs_mending(problem, found, run.covariances, config):
        return _Settled(problem, found, ())
    kept = mend(problem, found, config)
    return _Settled(problem, kept[-1].association, tuple(candidate.move for candidate in kept[1:]))


def _may_need_calibration(found: _Settled, config: SmootherConfig) -> bool:
    """Whether beams contradict a solution, or its wheels and ranges fit better by far with other sizes.

    The second is Wald's test: the calibration that is estimated with the same associations, in standard deviations.
    """
    if is_contradicted(found.problem, found.association, config):
        return True
    sized = replace(found.problem, prior=config.calibration.information)
    solution = solve(sized, found.association.state, found.association.labels)
    values, first = solution.state.calibration.ravel(), 3 * len(sized.starts)
    covariance = solution.factored.covariance[first : first + len(values), first : first + len(values)]
    return float(values @ np.linalg.solve(covariance, values)) > config.calibration_gate * len(sized.starts)


def filter_labels(problem: Problem, associations: Iterable[AssociationRecord], closures: list[Closure]) -> IntArray:
    """For each reading of a problem the landmark that the filter took it for at last (k,), or -1."""
    count, steps = len(problem.starts), problem.steps
    table = np.full((count * steps, len(problem.robot.beams)), -1)
    united = {closure.younger: closure.older for closure in closures}
    for record in associations:
        number = record.landmark
        while number in united:
            number = united[number]
        table[record.robot * steps + record.readings[:, 0], record.readings[:, 1]] = number
    return np.asarray(table[problem.readings.places, problem.readings.beams])


def needs_mending(problem: Problem, found: Association, covariances: FloatArray, config: SmootherConfig) -> bool:
    """Whether beams contradict a solution, or the filter was once unsure of its heading."""
    heading_std = math.sqrt(max(float(covariances[..., 2, 2].max()), 0.0))
    return heading_std > config.mending.unsure_heading or is_contradicted(problem, found, config)


def _unsmoothed(run: FilteredRun) -> SmoothedRun:
    return SmoothedRun(run.poses, run.covariances, [], no_rows(4), None, ())


def _smoothed(best: _Settled, config: SmootherConfig) -> SmoothedRun:
    problem, found = best.problem, best.association
    poses = np.moveaxis(found.state.poses, 0, 1).copy()
    poses[..., 2] = wrap_angle(poses[..., 2])
    return SmoothedRun(
        poses=poses,
        covariances=np.moveaxis(pose_covariances(found.solution), 0, 1).copy(),
        landmarks=smoothed_landmarks(problem, found),
        segments=smoothed_segments(problem, found, config),
        calibration=None if problem.prior is None else found.state.calibration,
        moves=best.moves,
    )
