"""The map of a solution: wall segments that are cut at doors and holes, and landmarks with covariances."""

import numpy as np

from limslam_agent.config.smoother import SmootherConfig
from limslam_agent.slam.consistent.wall_extent import BIN, WallExtent
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.line_graph.line_smoother import Problem, State
from limslam_agent.slam.line_graph.map_score import tally
from limslam_agent.slam.line_graph.reassociation import Association, places_along
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import direction, normal, normalise
from limslam_env.geometry.segment import lengths


def smoothed_landmarks(problem: Problem, found: Association) -> list[Landmark]:
    """The lines of a solution as landmarks: (r, theta) about the world's origin, covariances and end points."""
    state, counts = found.state, np.bincount(found.labels[found.labels >= 0], minlength=len(found.state.lines))
    lines, covariances = world_lines(found)
    along = places_along(problem, state, found.labels)
    landmarks = []
    for index, (line, covariance) in enumerate(zip(lines, covariances, strict=True)):
        own = along[found.labels == index]
        ends = _points(state, index, np.array([own.min(), own.max()]))
        r, theta = line.tolist()
        landmarks.append(Landmark(r, theta, covariance, ends, int(counts[index]), index))
    return landmarks


def world_lines(found: Association) -> tuple[FloatArray, FloatArray]:
    """Lines (m, 2) as (r, theta) about the world's origin, and their covariances (m, 2, 2)."""
    state, joint = found.state, found.solution.factored.lines
    lines = state.lines.copy()
    normals, tangents = normal(lines), direction(lines)
    lines[:, 0] += np.sum(normals * state.anchors, axis=1)
    lever = np.sum(tangents * state.anchors, axis=1)
    own = 2 * np.arange(len(lines))
    blocks = joint[own[:, None, None] + np.arange(2)[:, None], own[:, None, None] + np.arange(2)]
    jacobians = np.tile(np.eye(2), (len(lines), 1, 1))
    jacobians[:, 0, 1] = lever
    # Reversing the normal to make r positive changes the sign of the covariance between r and theta.
    jacobians[lines[:, 0] < 0.0, 0] *= -1.0
    return normalise(lines), np.asarray(jacobians @ blocks @ np.swapaxes(jacobians, 1, 2))


def smoothed_segments(problem: Problem, found: Association, config: SmootherConfig) -> FloatArray:
    """The wall segments (k, 4) of a solution, m: where beams ended along the lines and no beam passed through."""
    counted, state = tally(problem, found), found.state
    along, used = places_along(problem, state, found.labels), found.labels >= 0
    bins = np.floor(along[used] / BIN).astype(np.int64) - counted.low[found.labels[used]]
    least, most = np.full(counted.hits.shape, np.inf), np.full(counted.hits.shape, -np.inf)
    np.minimum.at(least, (found.labels[used], bins), along[used])
    np.maximum.at(most, (found.labels[used], bins), along[used])
    drawn = [np.zeros((0, 4))]
    for index in np.flatnonzero(counted.hits.sum(axis=1) >= config.shown_readings).tolist():
        counts, reached = np.stack((counted.hits[index], counted.misses[index])), np.stack((least[index], most[index]))
        extent = WallExtent.counted(int(counted.low[index]), counts, reached)
        pieces = extent.intervals(config.max_gap, config.through_tolerance)
        drawn.append(_points(state, index, pieces).reshape(-1, 4))
    every = np.concatenate(drawn)
    shortest = max(config.shown_length, config.shown_sigmas * problem.range_std)
    return np.asarray(every[lengths(every) >= shortest])


def _points(state: State, index: int, along: FloatArray) -> FloatArray:
    """Points (..., 2) in the world frame at places (...) along a line."""
    line = state.lines[index]
    foot = state.anchors[index] + line[0] * normal(line)
    return np.asarray(foot + along[..., None] * direction(line))
