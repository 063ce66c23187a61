"""Drives round a room for tests of the smoother: problems with the true poses and the true wall of
each reading.
"""

import numpy as np
from support.drives import ROBOT, along, drive, ranges_at, room

from limslam_agent.slam.line_graph.problem import make_problem
from limslam_agent.slam.line_graph.problem import state_from_motions as state_from
from limslam_agent.slam.line_graph.run import FilteredRun
from limslam_env import NominalNoise

WALLS = room(0.0, 0.0, 3.0, 2.4)
START = np.array([0.6, 0.6, 0.0])
ROUND = [(0.6, 0.6), (2.4, 0.6), (2.4, 1.8), (0.6, 1.8), (0.6, 0.7)]
WHEEL_VARIANCE = 2e-5


def noisy_drive(seed, noise=0.02, mismatch=0.0, robots=1, walls=WALLS, places=ROUND):
    """A drive round a room: wheel travel (t, n, 2) and ranges (t, n, n_beams) with noise, and true
    poses (n, t, 3).
    """
    generator = np.random.default_rng(seed)
    wheels = []
    ranges = []
    poses = []
    for _ in range(robots):
        observations, true = drive(
            walls, START, along(places), noise=noise, seed=int(generator.integers(1 << 30))
        )
        travel = np.array([each["wheels"] for each in observations], dtype=float)
        reported = travel + np.sqrt(WHEEL_VARIANCE * np.abs(travel)) * generator.standard_normal(
            travel.shape
        )
        wheels.append(reported * np.array([1.0 + mismatch, 1.0 - mismatch]))
        ranges.append([each["ranges"] for each in observations])
        poses.append(true)
    return np.moveaxis(wheels, 0, 1), np.moveaxis(ranges, 0, 1), np.array(poses)


def noisy_filtered(seed, noise=0.02, **changes):
    """A drive round a room as a filter leaves it that knew the poses."""
    wheels, ranges, poses = noisy_drive(seed, noise, **changes)
    poses = np.moveaxis(poses, 0, 1)
    usable = np.ones(ranges.shape, dtype=bool)
    nominal = NominalNoise(noise, WHEEL_VARIANCE)
    return FilteredRun(ROBOT, nominal, wheels, ranges, usable, poses, np.zeros((*poses.shape, 3)))


def noisy_run(seed, noise=0.02, prior=None, **changes):
    """The problem of a drive round a room that is reported with noise, and the true poses (n, t,
    3).
    """
    run = noisy_filtered(seed, noise, **changes)
    return make_problem(run, prior), np.moveaxis(run.poses, 1, 0)


def true_labels(problem, poses, walls=WALLS):
    """The wall that each reading of a problem truly ended on."""
    flat = poses.reshape(-1, 3)
    best = np.full((len(flat), len(ROBOT.beams)), -1)
    nearest = np.full((len(flat), len(ROBOT.beams)), np.inf)
    for number, wall in enumerate(walls):
        reach = np.array([ranges_at(pose, wall[None]) for pose in flat])
        is_nearer = (reach < ROBOT.too_far) & (reach < nearest)
        best = np.where(is_nearer, number, best)
        nearest = np.where(is_nearer, reach, nearest)
    return best[problem.readings.places, problem.readings.beams]


def position_error(state, poses):
    """Root mean square of the position errors of all poses, m."""
    return float(np.sqrt(np.mean(np.sum((state.poses - poses)[..., :2] ** 2, axis=-1))))


def state_from_motions(problem):
    """The state without lines that follows from the reported wheel travel, and from where robots
    were carried.
    """
    return state_from(problem.starts, problem.motions + problem.jumps)
