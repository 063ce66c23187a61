"""The map of a solution: wall segments that are cut at doors and holes, and landmarks with
covariances.

Beams confirm a wall where they end, and contradict it where they pass through.
"""

from dataclasses import replace

import numpy as np

from limslam_agent.kernels.crossings import count_passes
from limslam_agent.kernels.tables import BIN, FEWEST, THROUGH_SIGMAS, THROUGH_SLACK
from limslam_agent.slam.consistent.limits import MAX_GAP, THROUGH_TOLERANCE
from limslam_agent.slam.consistent.wall_map import WallExtent
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.line_graph.problem import Readings, State
from limslam_agent.slam.line_graph.reassociation import (
    Association,
    places_along,
    solve_again,
)
from limslam_env.geometry import BoolArray, FloatArray, IntArray, no_rows
from limslam_env.geometry.line import direction, normal, normalise


def tally(found: Association) -> tuple[list[WallExtent], FloatArray]:
    """Where along each line of a solution beams ended and passed, and how much each of the looks
    (k,) contradicts walls.

    Where more beams passed than ended, those that ended are the contradiction, as where somebody
    stood for a moment: all that passed there count as much as these.
    """
    problem = found.problem
    state = found.state
    used = found.labels >= 0
    looks = problem.looks
    labels = found.labels[used]
    along = places_along(problem, state, found.labels)[used]
    bins = np.floor(along / BIN).astype(np.int64)
    count = len(state.lines)
    low = np.full(count, np.iinfo(np.int64).max)
    high = np.full(count, np.iinfo(np.int64).min)
    np.minimum.at(low, labels, bins)
    np.maximum.at(high, labels, bins)
    bins -= low[labels]
    hits = np.zeros((count, int((high - low).max(initial=0)) + 1), dtype=np.int64)
    np.add.at(hits, (labels, bins), 1)
    reached = np.stack((np.full(hits.shape, np.inf), np.full(hits.shape, -np.inf)), axis=1)
    np.minimum.at(reached[:, 0], (labels, bins), along)
    np.maximum.at(reached[:, 1], (labels, bins), along)
    margin = THROUGH_SIGMAS * problem.range_std + THROUGH_SLACK
    free = np.where(
        problem.is_hit,
        problem.true(looks.distances, looks.places, state.calibration),
        looks.distances,
    )
    rays = state.rays(looks.places, problem.look_beams, free)
    misses = np.zeros_like(hits)
    against = np.empty(len(rays))
    nothing = np.zeros(hits.shape)
    count_passes(rays, state.line_rows, low, margin, misses, nothing, against)
    shares = np.where(_is_wall(hits), np.minimum(hits / np.maximum(misses, 1), 1.0), 0.0)
    count_passes(rays, state.line_rows, low, margin, misses.copy(), shares, against)
    counted = np.stack((hits, misses), axis=1)
    return [
        WallExtent(int(first), *each) for first, *each in zip(low, counted, reached, strict=True)
    ], against


def _is_wall(hits: IntArray) -> BoolArray:
    """In which bins (m, b) of lines beams have ended that also ended in one of the two adjacent
    bins on each side.
    """
    is_wall = np.zeros(hits.shape, dtype=bool)
    before = hits[:, :-4] + hits[:, 1:-3]
    after = hits[:, 3:-1] + hits[:, 4:]
    is_wall[:, 2:-2] = (hits[:, 2:-2] > 0) & (before > 0) & (after > 0)
    return is_wall


def lasting(found: Association) -> Association:
    """The optimum without the readings of what did not last, as somebody who walked by: of places
    where more beams passed than ended.
    """
    along = places_along(found.problem, found.state, found.labels)
    labels = found.labels.copy()
    for index, extent in enumerate(tally(found)[0]):
        own = np.flatnonzero(labels == index)
        bins = np.floor(along[own] / BIN).astype(np.int64) - extent.low
        hits, misses = extent.counted[:, bins]
        labels[own[misses > THROUGH_TOLERANCE * hits]] = -1
    if np.array_equal(labels, found.labels):
        return found
    return solve_again(found.problem, found.state, labels)


def contradictions(found: Association) -> float:
    """Share of the looks that pass through walls, without those that saw nothing and may be
    dropouts of the sensor, and without the beam that says most, which may be broken.

    A beam that saw nothing counts if it also saw nothing in the steps before and after.
    """
    problem = found.problem
    looks = found.problem.looks
    steps = len(problem.starts) * problem.steps
    beams = len(problem.robot.beams)
    is_empty = np.zeros((steps + 2, beams), dtype=bool)
    is_empty[looks.places[~problem.is_hit] + 1, looks.beams[~problem.is_hit]] = True
    lasts = is_empty[:-2] & is_empty[1:-1] & is_empty[2:]
    counts = problem.is_hit | lasts[looks.places, looks.beams]
    kept = Readings(looks.places[counts], looks.beams[counts], looks.distances[counts])
    _, weights = tally(replace(found, problem=replace(problem, looks=kept)))
    against = np.bincount(kept.beams, weights, minlength=beams)
    tested = np.bincount(kept.beams, minlength=beams)
    others = np.arange(beams) != against.argmax()
    return float(against[others].sum() / max(tested[others].sum(), 1))


def smoothed_map(found: Association) -> tuple[list[Landmark], FloatArray]:
    """The walls of a solution: the lines with walls, as landmarks about the world's origin, and the
    segments (k, 4), m.

    A wall is where beams ended along a line and no beam passed through.
    """
    segments, owners = _drawn(found)
    lines, covariances = world_lines(found)
    along = places_along(found.problem, found.state, found.labels)
    landmarks = []
    for index in np.unique(owners).tolist():
        own, (r, theta) = along[found.labels == index], lines[index].tolist()
        ends = _points(found.state, index, np.array([own.min(), own.max()]))
        rows = tuple(np.flatnonzero(owners == index).tolist())
        landmarks.append(Landmark(r, theta, covariances[index], ends, len(own), index, rows))
    return landmarks, segments


def world_lines(found: Association) -> tuple[FloatArray, FloatArray]:
    """Lines (m, 2) as (r, theta) about the world's origin, and their covariances (m, 2, 2)."""
    state = found.state
    joint = found.solution.of_lines
    lines = state.lines.copy()
    normals = normal(lines)
    tangents = direction(lines)
    lines[:, 0] += np.sum(normals * state.anchors, axis=1)
    lever = np.sum(tangents * state.anchors, axis=1)
    own = 2 * np.arange(len(lines))
    blocks = joint[own[:, None, None] + np.arange(2)[:, None], own[:, None, None] + np.arange(2)]
    jacobians = np.tile(np.eye(2), (len(lines), 1, 1))
    jacobians[:, 0, 1] = lever
    # Reversing the normal to make r positive changes the sign of the covariance between r and
    # theta.
    jacobians[lines[:, 0] < 0.0, 0] *= -1.0
    return normalise(lines), np.asarray(jacobians @ blocks @ np.swapaxes(jacobians, 1, 2))


def drawn_pieces(extent: WallExtent) -> FloatArray:
    """The pieces (k, 2) of a line that are drawn as walls, m along the line."""
    return extent.intervals(MAX_GAP, THROUGH_TOLERANCE)


def _drawn(found: Association) -> tuple[FloatArray, IntArray]:
    """The wall segments (k, 4), m, and the line (k,) of each."""
    drawn = [no_rows(4)]
    owners = [np.zeros(0, dtype=np.int64)]
    along = places_along(found.problem, found.state, found.labels)
    for index, extent in enumerate(tally(found)[0]):
        pieces = drawn_pieces(extent)
        own = along[found.labels == index, None]
        count = np.sum((own >= pieces[:, 0]) & (own <= pieces[:, 1]), axis=0)
        # Many beams that end at one point show no wall.
        pieces = pieces[(count >= FEWEST) & (np.ptp(pieces, axis=1) >= BIN)]
        drawn.append(_points(found.state, index, pieces).reshape(-1, 4))
        owners.append(np.full(len(pieces), index))
    return np.concatenate(drawn), np.concatenate(owners)


def _points(state: State, index: int, along: FloatArray) -> FloatArray:
    """Points (..., 2) in the world frame at places (...) along a line."""
    line = state.lines[index]
    foot = state.anchors[index] + line[0] * normal(line)
    return np.asarray(foot + along[..., None] * direction(line))
