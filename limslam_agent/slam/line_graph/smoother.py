"""Smoothing of a finished run: all poses and the map, from the observations and the filter's
estimates.
"""

from dataclasses import replace

import numpy as np

from limslam_agent.config.smoother import SmootherConfig
from limslam_agent.kernels.tables import FEWEST
from limslam_agent.slam.core.diagnostics import AssociationRecord
from limslam_agent.slam.core.late_ranges import ahead
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.graph.graph import DegenerateError
from limslam_agent.slam.line_graph.association import Association, reassociate
from limslam_agent.slam.line_graph.map import contradictions, lasting, smoothed_map
from limslam_agent.slam.line_graph.problem import (
    CALIBRATION_PRIOR,
    HEADING_PRIOR,
    RELATIVE_PRIOR,
    Problem,
    make_problem,
    state_from_poses,
)
from limslam_agent.slam.line_graph.run import FilteredRun, SmoothedRun
from limslam_agent.slam.line_graph.solution import Solution, solve, where_read
from limslam_env.geometry import IntArray
from limslam_env.geometry.se2 import compose, inverse, wrap_angle

# Chi-square of the estimated errors, of which each robot has five, from which on they are taken to
# be real. Felt by the rows "drive 4 cm" and "sharp" of the scoreboard, whose robots have no such
# errors.
_CALIBRATION_GATE = 40.0


def smooth_run(
    run: FilteredRun, config: SmootherConfig | None = None, unplaced: int | None = None
) -> SmoothedRun | None:
    """Estimate all poses and lines of a run from all its measurements.

    The filter's associations are the initial associations, and every association can change. The
    result is None if the robots did not move or no wall was seen often enough: there is nothing to
    smooth then.

    ``unplaced`` is the step from which on the filter did not know the place of the only robot. From
    there on, the poses are those of the filter.
    """
    run = run.synchronous
    association = settle(run.until(unplaced), config or SmootherConfig())
    return None if association is None else _smoothed(association, run)


def smooth_with_unknown_start(
    run: FilteredRun, config: SmootherConfig | None = None
) -> SmoothedRun | None:
    """Smooth a run of two robots as :func:`smooth_run`. The second one's start is known only
    roughly.

    It may have been carried before its first step. Its start then follows from its pose after this
    step.
    """
    usable = run.usable.copy()
    usable[0, 1] = False
    smoothed = smooth_run(replace(run, usable=usable, breaks=(*run.breaks, (1, 1))), config)
    if smoothed is not None:
        motion = compose(inverse(run.poses[1, 1]), run.poses[0, 1])
        smoothed.poses[0, 1] = compose(smoothed.poses[1, 1], motion)
        smoothed.covariances[0, 1] = smoothed.covariances[1, 1]
    return smoothed


def settle(run: FilteredRun, config: SmootherConfig) -> Association | None:
    """The solution of a run; None if there is nothing to smooth."""
    if len(run.poses) < 2:
        return None
    prior = CALIBRATION_PRIOR if config.calibrate == "always" else None
    if run.headings is not None and config.calibrate != "never":
        prior = HEADING_PRIOR
    problem = make_problem(run, prior)
    labels = filter_labels(problem, run)
    if np.count_nonzero(labels >= 0) < FEWEST:
        return None
    try:
        best = lasting(reassociate(problem, state_from_poses(run.poses), labels))
        if config.calibrate == "if_needed" and run.headings is None:
            best = _calibrated_if_needed(best, run, labels)
    except DegenerateError:
        return None
    return best


def _calibrated_if_needed(
    association: Association, run: FilteredRun, labels: IntArray
) -> Association:
    """The solution with constant errors of wheels, axle and ranges if these are significant, before
    and after it.
    """
    sized = _calibrated(association.problem)
    if sized.sensor.scale_std:  # the size of the whole map is unknown, too
        return reassociate(sized, association.state, labels)
    if not _has_errors(sized, solve(sized, association.state, association.labels)):
        return association
    again = lasting(reassociate(sized, state_from_poses(run.poses), labels))
    return again if _has_errors(sized, again.solution) else association


def _has_errors(problem: Problem, solution: Solution) -> bool:
    """Whether the estimated constant errors are significant, by Wald's test."""
    values = solution.state.calibration.ravel()
    covariance = solution.covariance(solution.graph.nodes.columns("calibrations"))
    squared = float(values @ np.linalg.solve(covariance, values))
    return squared > _CALIBRATION_GATE * len(problem.starts)


def _calibrated(problem: Problem) -> Problem:
    """The problem with constant errors of wheels, axle and ranges.

    What a wide beam reads, and what a sensor reads whose noise grows with the range, is known to
    some millimetres only. That looks like a common error of all sizes with a bias, so the robots of
    such sensors have relative errors alone, unless a bias or a scale is known: a wrong one has to
    be corrected.
    """
    sensor = problem.sensor
    is_rough = (sensor.cone > 0.0 or sensor.growth > 0.0) and not (sensor.bias or sensor.scale_std)
    return replace(problem, prior=RELATIVE_PRIOR if is_rough else CALIBRATION_PRIOR)


def filter_labels(problem: Problem, run: FilteredRun) -> IntArray:
    """For each reading (k,), the landmark of the filter's final association, or -1."""
    steps = problem.steps
    table = np.full((len(problem.starts) * steps, len(problem.robot.beams)), -1)
    united = {closure.younger: closure.older for closure in run.closures}
    for record in run.associations:
        number = record.landmark
        while number in united:
            number = united[number]
        rows = record.readings[:, 0] - run.first_step
        beams = record.readings[:, 1]
        table[record.robot * steps + rows[rows >= 0], beams[rows >= 0]] = number
    return np.asarray(table[problem.readings.places, problem.readings.beams])


def _smoothed(association: Association, run: FilteredRun) -> SmoothedRun:
    problem = association.problem
    covariances = np.moveaxis(
        association.solution.of_poses + problem.jitters(association.state), 0, 1
    )
    state = where_read(problem, association.state, association.labels)
    association = replace(association, solution=replace(association.solution, state=state))
    poses = np.moveaxis(state.poses, 0, 1).copy()
    poses[..., 2] = wrap_angle(poses[..., 2])
    landmarks, segments = smoothed_map(association)
    read_at = np.concatenate((poses, run.poses[len(poses) :]))
    sensor = problem.sensor
    calibration = np.add(association.state.calibration, (0.0, 0.0, 0.0, sensor.bias, sensor.scale))
    sensors = [sensor._replace(bias=bias, scale=scale) for *_, bias, scale in calibration.tolist()]
    ranges = [own.corrected(run.ranges[:, number], run.robot) for number, own in enumerate(sensors)]
    return SmoothedRun(
        ranges=np.stack(ranges, axis=1),
        poses=read_at if run.waiting is None else ahead(read_at, run.waiting, run.robot.axle),
        read_at=read_at,
        covariances=np.concatenate((covariances, run.covariances[len(poses) :])),
        landmarks=landmarks,
        segments=segments,
        associations=_associations(association, landmarks, run.first_step),
        calibration=calibration
        if problem.prior is not None or sensor.bias or sensor.scale
        else None,
        contradictions=contradictions(association),
        robot=problem.robot,
    )


def _associations(
    association: Association, landmarks: list[Landmark], first_step: int
) -> list[AssociationRecord]:
    problem = association.problem
    readings = association.problem.readings
    records = []
    for number, mark in enumerate(landmarks):
        for robot in range(len(problem.starts)):
            own = (association.labels == mark.number) & (readings.places // problem.steps == robot)
            rows = np.column_stack(
                (readings.places[own] % problem.steps + first_step, readings.beams[own])
            )
            if len(rows):
                records.append(AssociationRecord(number, is_new=False, readings=rows, robot=robot))
    return records
