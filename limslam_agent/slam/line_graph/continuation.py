"""Smoothing that goes on by itself where the filter did not know the place of its only robot."""

import numpy as np

from limslam_agent.slam.least_squares.normal_equations import DegenerateError
from limslam_agent.slam.line_graph.line_merging import ONE_WALL
from limslam_agent.slam.line_graph.problem import Problem, State, first_steps, moved, state_from_poses
from limslam_agent.slam.line_graph.reassociation import (
    ROUNDS,
    Association,
    hit_points,
    merge,
    reassociate_from,
    solve_labels,
)
from limslam_agent.slam.line_graph.smoothed_map import is_contradicted
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_RUN_GAP = 0.15  # m of driving without a reading that ends a run
_POINT_GAP = 0.30  # m between the ends of two readings of one wall

# A drive is continued without a filter in stretches of this length, m. A stretch may cross a hall without a wall, so
# its walls may be far from where the wheels place them.
_STRETCH, _STRETCH_ROUNDS, _FEWEST_OF_PIECE = 10.0, 2, 5
_FAR_LIMITS = ONE_WALL.wider(max_offset=2.5, max_angle=0.6, min_overlap=0.10)
_KNOWN_AGAIN = 0.5  # least share of the later readings that are of walls of the beginning


def continued(problem: Problem, known: State, labels: IntArray) -> Association | None:
    """The association of one robot's whole drive, from that of its beginning, without a filter.

    The drive goes on by its wheels, some metres at a time. Its readings are cut into straight pieces, and the pieces
    are merged with the lines so far, the surest first.

    Parameters
    ----------
    problem
        The measurements of the whole drive.
    known, labels
        The poses and the calibration of its beginning, and the lines of the readings there, which are the first ones of
        the problem.

    Returns
    -------
    Association
        None if beams contradict the result, or if few of the later readings are of walls of the beginning: then nothing
        says that the robot is where its wheels report.
    """
    begin, travel = known.poses.shape[1], driven_at(problem)
    part, done = first_steps(problem, begin), begin
    try:
        found = solve_labels(part, state_from_poses(part, np.moveaxis(known.poses, 0, 1), known.calibration), labels)
        while done < problem.steps:
            done = min(int(np.searchsorted(travel, travel[done - 1] + _STRETCH)) + 1, problem.steps)
            part = first_steps(problem, done)
            found = _with_stretch(part, found)
        found = reassociate_from(problem, found, ROUNDS)
    except DegenerateError:
        return None
    return found if _is_supported(problem, found, begin) else None


def _with_stretch(part: Problem, found: Association) -> Association:
    """The association of a longer part of a drive, whose last poses follow from the wheels alone."""
    before = found.state
    motions = part.motions(before.calibration)
    motions[:, : before.motions.shape[1]] = before.motions
    state = moved(part, motions, before.lines[:0], before.anchors[:0], before.calibration)
    labels = np.full(len(part.readings), -1)
    labels[: len(found.labels)] = found.labels
    pieces = straight_runs(part, state, labels < 0, _FEWEST_OF_PIECE)
    labels = np.where(pieces >= 0, pieces + int(labels.max(initial=-1)) + 1, labels)
    merged, _, _ = merge(part, solve_labels(part, state, labels), _FAR_LIMITS)
    return reassociate_from(part, merged, _STRETCH_ROUNDS)


def _is_supported(problem: Problem, found: Association, begin: int) -> bool:
    """Whether no more beams than usual contradict a drive, and enough readings from a step on are of lines that were
    also read before it.
    """
    used, later = found.labels >= 0, problem.readings.places >= begin
    again = np.isin(found.labels, np.unique(found.labels[used & ~later])) & used & later
    is_known_again = int(again.sum()) >= _KNOWN_AGAIN * max(int(later.sum()), 1)
    return is_known_again and not is_contradicted(problem, found)


def driven_at(problem: Problem) -> FloatArray:
    """Distance driven by each robot up to each pose (n t,), by its wheels, m."""
    travel = np.abs(problem.wheels[..., :2]).mean(axis=2)
    start = np.zeros((len(travel), 1))
    return np.concatenate((start, np.cumsum(travel, axis=1)), axis=1).ravel()


def straight_runs(problem: Problem, state: State, chosen: BoolArray, fewest: int) -> IntArray:
    """Straight wall segments among chosen readings: the number of the segment of each reading (k,), or -1.

    The successive readings of one beam are divided at gaps and at bends.
    """
    readings, driven = problem.readings, driven_at(problem)
    order = np.lexsort((readings.places, readings.beams, readings.places // problem.steps))
    order = order[chosen[order]]
    points = hit_points(problem, state, order)[0]
    place, beam = readings.places[order], readings.beams[order]
    breaks = (np.diff(beam) != 0) | (np.diff(driven[place]) > _RUN_GAP) | (np.diff(driven[place]) < 0.0)
    breaks |= np.linalg.norm(np.diff(points, axis=0), axis=1) > _POINT_GAP
    result, number = np.full(len(readings), -1), 0
    for run in np.split(np.arange(len(order)), np.flatnonzero(breaks) + 1):
        for piece in _unbent(points, run, 4.0 * problem.range_std, fewest):
            result[order[piece]] = number
            number += 1
    return result


def _unbent(points: FloatArray, run: IntArray, tolerance: float, fewest: int) -> list[IntArray]:
    """The parts of a run whose points lie within a tolerance (m) of a line: split-and-merge without the merge step."""
    if len(run) < fewest:
        return []
    off = points[run] - points[run].mean(axis=0)
    away = np.abs(off @ np.linalg.svd(off, full_matrices=False)[2][1])
    if away.max() <= tolerance:
        return [run]
    cut = min(max(int(away.argmax()), 1), len(run) - 1)
    return _unbent(points, run[:cut], tolerance, fewest) + _unbent(points, run[cut:], tolerance, fewest)
