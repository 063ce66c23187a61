"""The offline optimum of a run: the best estimate of its path, given which wall each beam truly
hit.

All poses and all wall lines are estimated together by least squares, as the line smoother does it,
but nothing is left to be associated, and contact is known. Nothing else of the truth is used:
neither where the walls are, nor which of them are parallel. The ratio of an estimator's error to
the error of this optimum shows how much the estimator loses.
"""

from dataclasses import replace

import numpy as np

from limslam_agent.slam.core.motion import LEAST_VARIANCE
from limslam_agent.slam.graph.graph import DegenerateError
from limslam_agent.slam.line_graph.association import relabelled, solve_labels
from limslam_agent.slam.line_graph.problem import ASIDE_STD, Problem, make_problem, state_from_poses
from limslam_agent.slam.line_graph.run import FilteredRun
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import NominalNoise, RobotSpec

# m or rad
_CONVERGED = 1e-5
_MOST_SOLUTIONS = 10


def offline_optimum(
    robot: RobotSpec,
    noise: NominalNoise,
    true: FloatArray,
    wheels: FloatArray,
    ranges: FloatArray,
    wall_seen: IntArray,
    contact: BoolArray,
) -> FloatArray | None:
    """The poses (t, n, 3) of n robots with the least sum of squared residuals, m and rad.

    Readings that hit nothing or another robot, repeated readings of slow sensors, readings at
    grazing angles, and walls with few readings are left out.

    Parameters
    ----------
    robot, noise
        Body and beams of each robot, and the noise that is assumed; 5 mm of a range where it is
        less.
    true
        Poses (t, n, 3), m and rad, from which the iteration begins. The first row is the known
        start.
    wheels, ranges, wall_seen
        (t, n, 2), m, (t, n, n_beams), m, and (t, n, n_beams): the log, row 0 the moment of the
        reset, and the wall that each beam truly hit (-1 nothing, -2 a robot).
    contact
        (t, n), in which rows a robot touches something. In these rows the wheels slip, and their
        travel only bounds the motion.

    Returns
    -------
    poses
        Or None, if no wall has enough readings.
    """
    covariances = np.zeros((*true.shape, 3))
    run = FilteredRun(robot, noise, wheels, ranges, wall_seen >= 0, true, covariances)
    problem = _with_contact(make_problem(run), run, contact)
    steps = len(true)
    number, step = np.divmod(problem.readings.places, steps)
    walls = wall_seen[step, number, problem.readings.beams]
    try:
        found = solve_labels(problem, state_from_poses(true), walls)
        # A solution ends before it has converged to the last digit, and finds grazing readings by
        # the poses before it.
        for _ in range(_MOST_SOLUTIONS):
            before = found.state.poses
            found = relabelled(found, found.labels)
            if np.abs(found.state.poses - before).max() < _CONVERGED:
                break
    except DegenerateError:
        return None
    return np.moveaxis(found.state.poses, 0, 1)


def _with_contact(problem: Problem, run: FilteredRun, contact: BoolArray) -> Problem:
    """The problem with motions that are as exact as the wheels, except where a robot touches
    something.
    """
    travel = np.abs(np.moveaxis(run.wheels, 0, 1)[:, 1:])
    stds = np.sqrt(run.noise.wheel_variance * travel + LEAST_VARIANCE)
    touching = np.moveaxis(contact, 0, 1)[:, 1:, None]
    stds = np.where(touching, np.maximum(stds, travel.max(axis=-1, keepdims=True)), stds)
    aside = np.where(touching[..., 0], np.maximum(ASIDE_STD, travel.max(axis=-1)), ASIDE_STD)
    # The roots of the inverse covariances of motions, by those of the wheels.
    half = 0.5 * run.robot.axle
    by_motion = np.array([[1.0, 0.0, -half], [1.0, 0.0, half], [0.0, 1.0, 0.0]])
    return replace(
        problem, roots=by_motion / np.concatenate((stds, aside[..., None]), axis=-1)[..., None]
    )
