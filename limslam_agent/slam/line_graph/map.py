"""The map of a solution: wall segments that are cut at doors and holes, and landmarks with
covariances.

Beams confirm a wall where they end, and contradict it where they pass through.
"""

import numpy as np

from limslam_agent.kernels.crossings import count_passes
from limslam_agent.kernels.tables import BIN, FEWEST, THROUGH_SIGMAS, THROUGH_SLACK
from limslam_agent.slam.consistent.limits import MAX_GAP, THROUGH_TOLERANCE
from limslam_agent.slam.consistent.wall_map import WallExtent
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.line_graph.association import Association, relabelled
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.line import direction, normal, normalise


def tally(
    association: Association, chosen: BoolArray | None = None
) -> tuple[list[WallExtent], FloatArray]:
    """Where along each line of a solution beams ended and passed, and how much each of the chosen
    looks (k,) contradicts walls.

    Where more beams passed than ended, those that ended are the contradiction, as where somebody
    stood for a moment: all that passed there count as much as these.
    """
    problem = association.problem
    looks = problem.looks
    used = association.labels >= 0
    labels = association.labels[used]
    along = association.along[used]
    bins = np.floor(along / BIN).astype(np.int64)
    count = len(association.state.lines)
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
    distances = problem.true(looks, association.state.calibration)
    free = np.where(problem.is_hit, distances, looks.distances)
    rays = association.state.rays(looks.places, problem.look_beams, free)
    rays = rays if chosen is None else rays[chosen]
    lines = association.state.line_rows
    misses = np.zeros_like(hits)
    against = np.empty(len(rays))
    count_passes(rays, lines, low, margin, misses, np.zeros(hits.shape), against)
    shares = np.where(_is_wall(hits), np.minimum(hits / np.maximum(misses, 1), 1.0), 0.0)
    count_passes(rays, lines, low, margin, misses.copy(), shares, against)
    counted = np.stack((hits, misses), axis=1)
    extents = zip(low.tolist(), counted, reached, strict=True)
    return [WallExtent(*each) for each in extents], against


def _is_wall(hits: IntArray) -> BoolArray:
    """In which bins (m, b) of lines beams have ended that also ended in one of the two adjacent
    bins on each side.
    """
    is_wall = np.zeros(hits.shape, dtype=bool)
    before = hits[:, :-4] + hits[:, 1:-3]
    after = hits[:, 3:-1] + hits[:, 4:]
    is_wall[:, 2:-2] = (hits[:, 2:-2] > 0) & (before > 0) & (after > 0)
    return is_wall


def lasting(association: Association) -> Association:
    """The optimum without the readings of what did not last, as somebody who walked by: of places
    where more beams passed than ended.
    """
    labels = association.labels.copy()
    for index, extent in enumerate(tally(association)[0]):
        own = np.flatnonzero(labels == index)
        bins = np.floor(association.along[own] / BIN).astype(np.int64) - extent.low
        hits, misses = extent.counted[:, bins]
        labels[own[misses > THROUGH_TOLERANCE * hits]] = -1
    return (
        association
        if np.array_equal(labels, association.labels)
        else relabelled(association, labels)
    )


def contradictions(association: Association) -> float:
    """Share of the looks that pass through walls, without those that saw nothing and may be
    dropouts of the sensor, and without the beam that says most, which may be broken.

    A beam that saw nothing counts if it also saw nothing in the steps before and after.
    """
    problem = association.problem
    looks = problem.looks
    beams = len(problem.robot.beams)
    is_empty = np.zeros((len(association.state.flat_poses) + 2, beams), dtype=bool)
    is_empty[looks.places[~problem.is_hit] + 1, looks.beams[~problem.is_hit]] = True
    lasts = is_empty[:-2] & is_empty[1:-1] & is_empty[2:]
    counts = problem.is_hit | lasts[looks.places, looks.beams]
    own = looks.beams[counts]
    against = np.bincount(own, tally(association, counts)[1], minlength=beams)
    tested = np.bincount(own, minlength=beams)
    others = np.arange(beams) != against.argmax()
    return float(against[others].sum() / max(tested[others].sum(), 1))


def smoothed_map(association: Association) -> tuple[list[Landmark], FloatArray]:
    """The walls of a solution: the lines with walls, as landmarks about the world's origin, and the
    segments (k, 4), m.

    A wall is where beams ended along a line and no beam passed through.
    """
    segments = [np.zeros((0, 4))]
    landmarks = []
    count = 0
    lines, covariances = world_lines(association)
    for index, extent in enumerate(tally(association)[0]):
        own = association.along[association.labels == index]
        pieces = drawn_pieces(extent)
        within = (own[:, None] >= pieces[:, 0]) & (own[:, None] <= pieces[:, 1])
        # Many beams that end at one point show no wall.
        pieces = pieces[(within.sum(axis=0) >= FEWEST) & (np.ptp(pieces, axis=1) >= BIN)]
        if not len(pieces):
            continue
        line = association.state.lines[index]
        foot = association.state.anchors[index] + line[0] * normal(line)
        segments.append((foot + pieces[..., None] * direction(line)).reshape(-1, 4))
        ends = foot + np.array([[own.min()], [own.max()]]) * direction(line)
        rows = tuple(range(count, count + len(pieces)))
        count += len(pieces)
        r, theta = lines[index].tolist()
        landmarks.append(Landmark(r, theta, covariances[index], ends, len(own), index, rows))
    return landmarks, np.concatenate(segments)


def world_lines(association: Association) -> tuple[FloatArray, FloatArray]:
    """Lines (m, 2) as (r, theta) about the world's origin, and their covariances (m, 2, 2)."""
    state = association.state
    lines = state.lines.copy()
    lever = np.sum(direction(lines) * state.anchors, axis=1)
    lines[:, 0] += np.sum(normal(lines) * state.anchors, axis=1)
    count = len(lines)
    joint = association.solution.of_lines.reshape(count, 2, count, 2)
    blocks = joint[np.arange(count), :, np.arange(count)]
    jacobians = np.tile(np.eye(2), (count, 1, 1))
    jacobians[:, 0, 1] = lever
    # Reversing the normal to make r positive changes the sign of the covariance between r and
    # theta.
    jacobians[lines[:, 0] < 0.0, 0] *= -1.0
    return normalise(lines), np.asarray(jacobians @ blocks @ np.swapaxes(jacobians, 1, 2))


def drawn_pieces(extent: WallExtent) -> FloatArray:
    """The pieces (k, 2) of a line that are drawn as walls, m along the line."""
    return extent.intervals(MAX_GAP, THROUGH_TOLERANCE)
