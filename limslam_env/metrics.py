"""Scores of an estimate against the truth, and of the association of its data: pure functions on
arrays.

Poses are (x, y, theta) in m and rad, segments ``x1, y1, x2, y2`` in m, all in the world frame.
A metric that does not apply (no door in the world, too short a drive) is None, never a made-up
number.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.spatial import cKDTree

from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.consistency import BAND_95, has_left_start, nees
from limslam_env.geometry.se2 import between, transform_points, wrap_angle
from limslam_env.geometry.segment import distances, lengths, sample
from limslam_env.worlds.regions import starting_cells
from limslam_env.worlds.world import World

SAMPLE_SPACING = 0.05  # m of wall that one sample stands for
# m from a wall that still match it; NEARER in the metrics named _5cm
NEAR = 0.10
NEARER = 0.05
# a match differs by less
WALL_ANGLE = math.radians(10.0)
DOOR_ANGLE = math.radians(30.0)
SHORTEST_SIDE = 0.2  # m; below, sides of obstacles are not asked of a map
_STAND_SPACING = 0.1
_FIRST_STANDS = 8
_PAIRS_AT_ONCE = 1_000_000
_ROBOT = -2

WallSamples: TypeAlias = tuple[FloatArray, FloatArray, IntArray]
"""Samples of walls: points (n, 2) in m, directions (n,) in [0, pi] rad, indices (n,) of the edges
they lie on.
"""


def rigid_alignment(true_xy: FloatArray, estimated_xy: FloatArray) -> FloatArray:
    """The rigid motion (3,) that brings estimated points (n, 2) onto the true ones (n, 2), in m, in
    least squares.

    Umeyama's alignment ("Least-squares estimation of transformation parameters between two point
    patterns", 1991) without scale, in its closed form for the plane, which knows no reflection.
    Fewer than two points, or points all in one place, leave the heading as it is.
    """
    if len(true_xy) == 0:
        return np.zeros(3)
    true_mean = np.mean(true_xy, axis=0)
    mean = np.mean(estimated_xy, axis=0)
    target = true_xy - true_mean
    source = estimated_xy - mean
    theta = 0.0
    # If all points lie in one place, only rounding errors remain, and their angle means nothing.
    if min(np.abs(target).max(), np.abs(source).max()) > 1e-9:
        turned = np.sum(source[:, 0] * target[:, 1] - source[:, 1] * target[:, 0])
        theta = math.atan2(turned, np.sum(source * target))
    return np.array(
        [*(true_mean - transform_points(np.array([0.0, 0.0, theta]), mean[None])[0]), theta]
    )


def trajectory_metrics(true: FloatArray, estimated: FloatArray) -> dict[str, float | None]:
    """Errors of an estimated trajectory (n, 3), n >= 1, against the true one (n, 3).

    ``ate_m`` is the root mean square (RMS) of the position error, ``ate_aligned_m`` the same after
    :func:`rigid_alignment`; ``heading_rmse_deg`` and ``final_error_m`` are unaligned;
    ``rpe_m_per_m`` is the RMS error of the motion over stretches of 1 m of true travel laid end to
    end, None if there is none (evo's RPE, delta 1 m).
    """
    errors = np.linalg.norm(true[:, :2] - estimated[:, :2], axis=1)
    moved = transform_points(rigid_alignment(true[:, :2], estimated[:, :2]), estimated[:, :2])
    starts, ends = _stretches(true, 1.0)
    drift = between(true[starts], true[ends]) - between(estimated[starts], estimated[ends])
    return {
        "ate_m": _rms(errors),
        "ate_aligned_m": _rms(np.linalg.norm(true[:, :2] - moved, axis=1)),
        "heading_rmse_deg": math.degrees(_rms(wrap_angle(true[:, 2] - estimated[:, 2]))),
        "final_error_m": float(errors[-1]),
        "rpe_m_per_m": _rms(np.linalg.norm(drift[:, :2], axis=1)) if len(starts) else None,
    }


def consistency_metrics(
    true: FloatArray, estimated: FloatArray, covariances: FloatArray
) -> dict[str, float | None]:
    """Whether the errors of poses (n, 3) are as large as their covariances (n, 3, 3) say.

    Steps before 0.5 m of true travel are left out, as the known start has P = 0. ``anees`` is the
    mean :func:`nees` / 3, above 1 when overconfident; ``nees_in_95`` the share of steps in the
    two-sided 95 % chi-square band. Both are None if there are no such steps.
    """
    counted = has_left_start(true)
    if not counted.any():
        return {"anees": None, "nees_in_95": None}
    squared = nees(true[counted], estimated[counted], covariances[counted])
    low, high = BAND_95
    inside = (squared >= low) & (squared <= high)
    return {"anees": float(np.mean(squared)) / 3.0, "nees_in_95": float(np.mean(inside))}


@functools.lru_cache(maxsize=8)
def visible_samples(
    world: World,
    radius: float,
    max_range: float,
    spacing: float = SAMPLE_SPACING,
    shortest: float = SHORTEST_SIDE,
) -> WallSamples:
    """Samples of the true walls that a robot could see: what a complete map holds.

    Each edge is cut into equal pieces of at most ``spacing`` (m), and each piece gives its middle
    if a free sight line of at most ``max_range`` (m, from the robot's centre: a beam on the rim
    adds its radius) reaches it from where a disc of ``radius`` (m) can get to from the world's
    starts, or without starts in the largest closed region. Sides of obstacles below ``shortest``
    (m) block the sight but give no samples.

    The latest results are kept, because a suite scores many runs in one world. The arrays are
    read-only.
    """
    edges = world.edges
    points, directions, owner = _samples(edges, spacing)
    asked = lengths(edges) >= shortest - 1e-9
    asked[: len(world.walls)] = True
    stands = _stands(world, radius)
    tree = cKDTree(stands)
    seen = np.zeros(len(points), dtype=bool)
    for index in np.flatnonzero(asked[owner]):
        point = points[index]
        around = distances(point[None], edges)[0] <= max_range
        around[owner[index]] = False
        near = stands[tree.query_ball_point(point, max_range)]
        near = near[np.argsort(np.linalg.norm(near - point, axis=1))]
        # Most samples are seen from the nearest places, so these are tried first.
        batches = near[:_FIRST_STANDS], near[_FIRST_STANDS:]
        seen[index] = any(_in_sight(point, batch, edges[around]) for batch in batches)
    samples = points[seen], directions[seen], owner[seen]
    for each in samples:
        each.setflags(write=False)
    return samples


def wall_metrics(
    visible: WallSamples, all_edges: FloatArray, estimated: FloatArray, alignment: FloatArray
) -> dict[str, float]:
    """How well estimated segments (m, 4) draw the true edges (k, 4).

    A sample matches a segment of the other set within 10 cm (exact distance) whose direction
    differs by less than 10 deg. Recall is over the visible samples (:func:`visible_samples` at its
    default spacing), precision over samples of the estimate, each 5 cm, against all true edges: a
    mapped wall that truly exists is no error.

    Names with ``_5cm`` use 5 cm instead; those with ``_aligned`` first move the estimate by
    ``alignment`` (3,), the
    :func:`rigid_alignment` of the trajectories. So do, since a turned map is no invented wall,
    ``spurious_walls`` (segments with less than half their samples matched), ``spurious_m`` (their
    length) and ``duplicate_m`` (length of visible wall matched by more than one segment). An empty
    estimate has 0 for all.
    """
    estimated = estimated.reshape(-1, 4)
    moved = transform_points(alignment, estimated.reshape(-1, 2)).reshape(-1, 4)
    recall, precision, f1 = _wall_scores(visible, all_edges, estimated, NEAR)
    return {
        "wall_recall": recall,
        "wall_precision": precision,
        "wall_f1": f1,
        "wall_f1_5cm": _wall_scores(visible, all_edges, estimated, NEARER)[2],
        "wall_f1_aligned": _wall_scores(visible, all_edges, moved, NEAR)[2],
        "wall_f1_aligned_5cm": _wall_scores(visible, all_edges, moved, NEARER)[2],
        **_surplus(visible, all_edges, moved),
    }


def doors_open(doors: FloatArray, estimated: FloatArray) -> float | None:
    """Share of doors (d, 4) whose middle 40 % no estimated segment (m, 4) covers (within 10 cm, 30
    deg).
    """
    if len(doors) == 0:
        return None
    low, high = (doors[:, :2] + part * (doors[:, 2:] - doors[:, :2]) for part in (0.3, 0.7))
    # Samples are a tenth of the matching distance apart, so that no wall is missed between two of
    # them.
    points, owner = sample(np.hstack((low, high)), 0.1 * NEAR)
    matches = _matches(
        (points, _directions(doors)[owner], owner), estimated.reshape(-1, 4), NEAR, DOOR_ANGLE
    )
    return float(np.mean(np.bincount(owner, weights=matches, minlength=len(doors)) == 0.0))


def coverage_times(time: FloatArray, coverage: FloatArray) -> dict[str, float | None]:
    """First times (s), of those in ``time`` (n,), at which ``coverage`` (n,) reached 50, 90 and 95
    %; None if never.
    """
    first = {level: np.flatnonzero(coverage >= level / 100.0)[:1] for level in (50, 90, 95)}
    return {
        f"time_to_{level}_s": float(time[at[0]]) if at.size else None for level, at in first.items()
    }


def path_length(true: FloatArray) -> float:
    """Length (m) of the path through poses (n, 3)."""
    return float(_steps(true).sum())


def contacts_begun(collision: BoolArray) -> int:
    """How often contact began in a record (n,) of which steps were in contact."""
    return int(np.count_nonzero(np.diff(np.asarray(collision, dtype=np.int8), prepend=0) == 1))


def coverage_claims(
    claimed_free: FloatArray,
    claimed_cell: float,
    coverable: BoolArray,
    origin: FloatArray,
    cell: float,
) -> dict[str, float | None]:
    """What the agent calls free (``coverage_claimed``), and what of it truly is, at that place
    (``coverage_correct``).

    The agent's free cells, of side ``claimed_cell``, have their centres at ``claimed_free`` (k, 2);
    the true cells, of side ``cell``, are those of ``coverable`` (rows, columns), row 0 at the
    bottom, lower left corner at ``origin`` (2,), all in m. A claim is correct where its centre lies
    in a coverable cell. Both are shares of the coverable area, so that no wrong claim raises
    ``coverage_correct``; None if that area is 0.
    """
    area = float(np.count_nonzero(coverable)) * cell**2
    if area == 0.0:
        return {"coverage_claimed": None, "coverage_correct": None}
    columns, rows = np.floor((claimed_free.reshape(-1, 2) - origin) / cell).astype(int).T
    inside = (
        (rows >= 0) & (rows < coverable.shape[0]) & (columns >= 0) & (columns < coverable.shape[1])
    )
    correct = np.count_nonzero(coverable[rows[inside], columns[inside]])
    share = claimed_cell**2 / area
    return {"coverage_claimed": len(rows) * share, "coverage_correct": float(correct) * share}


@dataclass(frozen=True)
class AssociationEvent:
    """One observed line, and the landmark that it was matched to or (``is_new``) that was created
    from it.
    """

    landmark: int
    is_new: bool
    true_walls: tuple[
        int, ...
    ]  # for each reading in the line, the index of the wall hit; -1 nothing, -2 a robot


def association_metrics(
    events: Sequence[AssociationEvent], wall_count: int
) -> dict[str, float | None]:
    """How often observed lines got the right landmark, judged by the walls (``wall_count`` of them)
    truly hit.

    An observation's true wall is the one that more than half of its readings hit, a landmark's that
    of the observation that created it. Where either has none there is no right answer: such events
    are mixed.

    Counts (int) of ``association_right``, ``association_wrong`` (matched to another wall's
    landmark), ``association_new`` (rightly), ``association_wrongly_new`` (the wall had a landmark),
    ``association_mixed``; ``association_right_share`` is the share of right and rightly new among
    all not mixed, None if there are none.
    """
    counts = dict.fromkeys(("right", "wrong", "wrongly_new", "new", "mixed"), 0)
    wall_of: dict[int, int | None] = {}
    for event in events:
        wall = _majority(event.true_walls, wall_count)
        known = wall if event.is_new else wall_of.get(event.landmark)
        if wall is None or known is None:
            verdict = "mixed"
        elif event.is_new:
            verdict = "wrongly_new" if wall in wall_of.values() else "new"
        else:
            verdict = "right" if wall == known else "wrong"
        counts[verdict] += 1
        wall_of[event.landmark] = known
    judged = len(events) - counts["mixed"]
    share = (counts["right"] + counts["new"]) / judged if judged else None
    return {
        **{f"association_{name}": count for name, count in counts.items()},
        "association_right_share": share,
    }


def closure_metrics(
    events: Sequence[AssociationEvent], closures: Sequence[tuple[int, int]], wall_count: int
) -> dict[str, int]:
    """How many of the merged pairs of landmarks truly belong to one wall.

    Counts of ``closures_right``, ``closures_wrong`` and ``closures_mixed``: a landmark's true wall
    is that of the observation that created it, and where either has none there is no right answer.
    """
    wall_of = {
        event.landmark: _majority(event.true_walls, wall_count) for event in events if event.is_new
    }
    counts = dict.fromkeys(("right", "wrong", "mixed"), 0)
    for older, younger in closures:
        first = wall_of.get(older)
        second = wall_of.get(younger)
        is_known = first is not None and second is not None
        counts[("right" if first == second else "wrong") if is_known else "mixed"] += 1
    return {f"closures_{name}": count for name, count in counts.items()}


def dropped_beam_metrics(dropped: BoolArray, wall_seen: IntArray) -> dict[str, float | None]:
    """How beams that hit another robot were classified, and how many other beams were rejected.

    ``robot_beams_dropped`` is the share of the beams on robots that were left out,
    ``robot_beams_dropped_wrongly`` the share of what was left out that had hit no robot, both None
    where there is nothing to share. ``dropped`` and ``wall_seen`` have one shape; -2 in the latter
    is a robot.
    """
    on_robot = wall_seen == _ROBOT
    hits = int(np.count_nonzero(on_robot))
    left_out = int(np.count_nonzero(dropped))
    return {
        "robot_beams_dropped": float(np.count_nonzero(dropped & on_robot)) / hits if hits else None,
        "robot_beams_dropped_wrongly": float(np.count_nonzero(dropped & ~on_robot)) / left_out
        if left_out
        else None,
    }


def _wall_scores(
    visible: WallSamples, edges: FloatArray, estimated: FloatArray, tolerance: float
) -> list[float]:
    """Recall, precision and F1 at a matching distance (m)."""
    found = _matches(visible, estimated, tolerance) > 0
    right = _matches(_samples(estimated, SAMPLE_SPACING), edges, tolerance) > 0
    recall, precision = (float(np.mean(hits)) if hits.size else 0.0 for hits in (found, right))
    return [recall, precision, 2.0 * recall * precision / max(recall + precision, 1e-300)]


def _surplus(
    visible: WallSamples, all_edges: FloatArray, estimated: FloatArray
) -> dict[str, float]:
    """The spurious and the duplicate parts of aligned segments (m, 4)."""
    drawn = _samples(estimated, SAMPLE_SPACING)
    hits = np.bincount(
        drawn[2], weights=_matches(drawn, all_edges, NEAR) > 0, minlength=len(estimated)
    )
    spurious = hits < 0.5 * np.bincount(drawn[2], minlength=len(estimated))
    return {
        "spurious_walls": int(np.count_nonzero(spurious)),
        "spurious_m": float(lengths(estimated)[spurious].sum()),
        "duplicate_m": SAMPLE_SPACING
        * int(np.count_nonzero(_matches(visible, estimated, NEAR) >= 2)),
    }


def _matches(
    samples: WallSamples, segments: FloatArray, tolerance: float, angle: float = WALL_ANGLE
) -> IntArray:
    """How many segments (k, 4) lie within ``tolerance`` (m) and less than ``angle`` (rad) of each
    of n samples.
    """
    points, directions, _ = samples
    counts = np.zeros(len(points), dtype=np.intp)
    step = max(1, _PAIRS_AT_ONCE // max(1, len(segments)))
    for first in range(0, len(points), step):
        rows = slice(first, first + step)
        turn = np.abs(directions[rows, None] - _directions(segments))
        parallel = np.minimum(turn, math.pi - turn) < angle
        counts[rows] = np.count_nonzero(
            parallel & (distances(points[rows], segments) <= tolerance), axis=1
        )
    return counts


def _samples(segments: FloatArray, spacing: float) -> WallSamples:
    """Middles of equal pieces of segments (k, 4), at most ``spacing`` (m) long, so that no sample
    is a corner.
    """
    ends, owner = sample(segments, spacing)
    inner = owner[:-1] == owner[1:]
    owner = owner[:-1][inner]
    return 0.5 * (ends[:-1] + ends[1:])[inner], _directions(segments)[owner], owner


def _directions(segments: FloatArray) -> FloatArray:
    """Directions (k,) of segments without regard to their sense, in [0, pi] rad."""
    return np.arctan2(segments[:, 3] - segments[:, 1], segments[:, 2] - segments[:, 0]) % math.pi


def _stands(world: World, radius: float) -> FloatArray:
    """Places (n, 2) about 0.1 m apart that the centre of the robot's disc can get to, m."""
    space = world.free_space(radius)
    centres = space.centres(starting_cells(world, space))
    # One place of each block is enough, as long as no block holds both sides of a wall.
    blocks = np.floor((centres - space.origin) / min(_STAND_SPACING, radius)).astype(int)
    _, first = np.unique(blocks, axis=0, return_index=True)
    return centres[first]


def _in_sight(point: FloatArray, stands: FloatArray, edges: FloatArray) -> bool:
    """Whether a straight line from any of the places (n, 2) reaches a point (2,) without crossing
    an edge (k, 4).
    """
    sight = point - stands[:, None]
    span = edges[:, 2:] - edges[:, :2]
    offset = edges[:, :2] - stands[:, None]
    cross = sight[..., 0] * span[:, 1] - sight[..., 1] * span[:, 0]
    # Edges that run along the line of sight divide by zero and block nothing; their neighbours do.
    with np.errstate(divide="ignore", invalid="ignore"):
        reached = (offset[..., 0] * span[:, 1] - offset[..., 1] * span[:, 0]) / cross
        part = (offset[..., 0] * sight[..., 1] - offset[..., 1] * sight[..., 0]) / cross
    # The tolerance closes the joint of two edges. An edge through the point itself does not hide
    # the point.
    blocked = (part > -1e-9) & (part < 1.0 + 1e-9) & (reached > 0.0) & (reached < 1.0 - 1e-6)
    return bool((~blocked.any(axis=1)).any())


def _steps(poses: FloatArray) -> FloatArray:
    """Lengths (n - 1,) of the steps between poses (n, 3), m."""
    return np.asarray(np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1))


def _stretches(poses: FloatArray, length: float) -> tuple[IntArray, IntArray]:
    """First and last steps (k,) of stretches of at least ``length`` (m), each beginning where the
    last ended.
    """
    marks = [0]
    driven = 0.0
    for step, travel in enumerate(_steps(poses), start=1):
        driven += float(travel)
        if driven >= length:
            marks.append(step)
            driven = 0.0
    return np.array(marks[:-1], dtype=np.intp), np.array(marks[1:], dtype=np.intp)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _majority(walls: tuple[int, ...], wall_count: int) -> int | None:
    """The wall that more than half of the readings hit; None if there is none."""
    if walls and max(walls) >= wall_count:
        raise ValueError(f"a reading of wall {max(walls)}, but there are {wall_count} walls")
    counts = np.bincount([wall for wall in walls if wall >= 0], minlength=1)
    return int(np.argmax(counts)) if 2 * counts.max() > len(walls) else None
