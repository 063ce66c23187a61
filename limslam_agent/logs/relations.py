"""The error of a trajectory over relations: pairs of times between which somebody knows how the robot moved.

After Kuemmerle et al., "On measuring the accuracy of SLAM algorithms" (2009). It compares the
motion between two moments, so it depends on no common frame, and an error is counted once,
where it was made, however far the robot drives on.
"""

from dataclasses import dataclass
from os import fspath

import numpy as np
from numpy.typing import NDArray

from limslam_agent.logs.recorded_log import FilePath, LogError, numbered_lines, parse_number
from limslam_env.geometry import BoolArray, FloatArray, se2

NEAREST_WITHIN = 0.1
"""A pose this near in time (s) stands for the moment itself."""

OUTSIDE_BY = 1.0
"""A relation that begins or ends further (s) outside the log than this is left out."""

LOOP_AFTER = 60.0
"""Relations over more time (s) than this are loops: the mean over all would hide a failure there."""

_FIELDS = ("t1", "t2", "x", "y", "z", "roll", "pitch", "yaw")


@dataclass(frozen=True, eq=False)
class Relations:
    """Known motions: from ``start_time`` to ``end_time``, both (k,) s.

    ``relative`` (k, 3) m, m, rad is the pose at the end as seen from the one at the start.
    """

    start_time: FloatArray
    end_time: FloatArray
    relative: FloatArray


@dataclass(frozen=True, eq=False)
class RelationErrors:
    """How far a trajectory's motions are off, for the ``k`` relations within the log's time.

    Attributes
    ----------
    translation
        (k,) m, length of the error's translation.
    rotation
        (k,) rad, size of the error's rotation, 0 to pi.
    is_loop
        (k,) bool, whether the relation is over more than 60 s.
    unmatched
        Number of relations left out since they lie outside the log's time.
    """

    translation: FloatArray
    rotation: FloatArray
    is_loop: BoolArray
    unmatched: int


def read_relations(path: FilePath) -> Relations:
    """Read relations, plain or gzip: lines ``t1 t2 x y z roll pitch yaw`` (s, m, rad), and comments after ``#``.

    Raises
    ------
    LogError
        If the file cannot be read, is cut short, a line has other fields than these, or there is none.
    """
    rows: list[list[float]] = []
    for number, line in numbered_lines(path):
        fields = line.partition(b"#")[0].split()
        if not fields:
            continue
        if len(fields) != len(_FIELDS):
            wanted = f"{len(_FIELDS)} are needed: {' '.join(_FIELDS)}"
            raise LogError(f"{fspath(path)}: line {number}: {len(fields)} fields where {wanted}")
        try:
            rows.append([parse_number(field, name) for field, name in zip(fields, _FIELDS, strict=True)])
        except ValueError as error:
            raise LogError(f"{fspath(path)}: line {number}: {error}") from error
    if not rows:
        raise LogError(f"{fspath(path)}: holds no relations")
    table = np.array(rows)
    return Relations(table[:, 0], table[:, 1], table[:, [2, 3, 7]])


def relation_errors(
    relations: Relations, time: FloatArray, poses: FloatArray, odometry: FloatArray | None = None
) -> RelationErrors:
    """Compare a trajectory's motions with the known ones: e = inverse(d) * (inverse(x1) * x2).

    Parameters
    ----------
    relations
        The known motions d.
    time
        (n,) s, in any order.
    poses
        (n, 3) m, m, rad: the trajectory at these times. Its pose at another time is the nearest one within 0.1 s,
        otherwise the one before, moved on by odometry.
    odometry
        (n, 3) m, m, rad: absolute odometry poses at the same times, interpolated linearly. Without it the trajectory
        itself is interpolated.
    """
    first, last = time.min() - OUTSIDE_BY, time.max() + OUTSIDE_BY
    early = np.minimum(relations.start_time, relations.end_time)
    late = np.maximum(relations.start_time, relations.end_time)
    inside = (early >= first) & (late <= last)
    start_time, end_time = relations.start_time[inside], relations.end_time[inside]
    moves = poses if odometry is None else odometry
    start = _poses_at(start_time, time, poses, moves)
    end = _poses_at(end_time, time, poses, moves)
    error = se2.between(relations.relative[inside], se2.between(start, end))
    return RelationErrors(
        translation=np.hypot(error[:, 0], error[:, 1]),
        rotation=np.abs(error[:, 2]),
        is_loop=np.abs(end_time - start_time) > LOOP_AFTER,
        unmatched=int(np.sum(~inside)),
    )


def summary(errors: RelationErrors) -> dict[str, float | int | None]:
    """Mean and standard deviation in m and deg, over all relations and over the loops; None where there are none."""
    everything = np.ones_like(errors.is_loop)
    return {
        **_figures("", errors, everything),
        **_figures("loop_", errors, errors.is_loop),
        "relations_unmatched": errors.unmatched,
    }


def _poses_at(wanted: FloatArray, time: FloatArray, poses: FloatArray, moves: FloatArray) -> FloatArray:
    """The trajectory (n, 3) at the wanted times (k,), as :func:`relation_errors` describes it."""
    # Logs step back in time here and there.
    order = np.argsort(time, kind="stable")
    time, poses, moves = time[order], poses[order], moves[order]
    before = np.maximum(np.searchsorted(time, wanted, side="right") - 1, 0)
    after = np.minimum(before + 1, len(time) - 1)
    nearest = np.where(np.abs(time[after] - wanted) < np.abs(time[before] - wanted), after, before)
    span = time[after] - time[before]
    # Before the first and beyond the last event nothing is known of the motion: the pose stays.
    fraction = np.clip((wanted - time[before]) / np.where(span > 0.0, span, 1.0), 0.0, 1.0)
    moved = se2.compose(poses[before], _part_of_motion(moves[before], moves[after], fraction))
    return np.where((np.abs(time[nearest] - wanted) <= NEAREST_WITHIN)[:, None], poses[nearest], moved)


def _part_of_motion(start: FloatArray, end: FloatArray, fraction: FloatArray) -> FloatArray:
    """The first ``fraction`` (k,) of the ways from ``start`` to ``end`` (k, 3), seen from ``start``."""
    position = start[:, :2] + fraction[:, None] * (end[:, :2] - start[:, :2])
    heading = start[:, 2] + fraction * se2.wrap_angle(end[:, 2] - start[:, 2])
    return se2.between(start, np.column_stack((position, heading)))


def _figures(prefix: str, errors: RelationErrors, chosen: NDArray[np.bool_]) -> dict[str, float | int | None]:
    translation, rotation = errors.translation[chosen], np.degrees(errors.rotation[chosen])
    known = bool(chosen.any())
    return {
        f"{prefix}relation_error_m": float(translation.mean()) if known else None,
        f"{prefix}relation_error_std_m": float(translation.std()) if known else None,
        f"{prefix}relation_error_deg": float(rotation.mean()) if known else None,
        f"{prefix}relation_error_std_deg": float(rotation.std()) if known else None,
        f"{prefix}relations": int(chosen.sum()),
    }
