"""Errors of a trajectory against relations: known motions between pairs of times.

The method is from Kuemmerle et al., "On measuring the accuracy of SLAM algorithms" (2009). It
compares the motion between two times, so no common frame is needed. An error counts once, where it
was made, however far the robot drives on.
"""

from dataclasses import dataclass
from os import fspath

import numpy as np

from limslam_agent.logs.recorded_log import FilePath, LogError, parse_number, read_lines
from limslam_env.geometry import BoolArray, FloatArray, se2

NEAREST_WITHIN = 0.1
"""A pose that is at most this far away in time (s) counts as the pose at that time."""

OUTSIDE_BY = 1.0
"""A relation that begins or ends farther outside of the log than this (s) is left out."""

LOOP_AFTER = 60.0
"""Relations over more time than this (s) are loops. The mean over all relations would hide a
failure there.
"""

_COLUMNS = ("translation", "rotation", "is_loop")
_FIELDS = ("t1", "t2", "x", "y", "z", "roll", "pitch", "yaw")


@dataclass(frozen=True, eq=False)
class Relations:
    """Known motions from ``start_time`` to ``end_time``, both (k,), s.

    ``relative`` (k, 3), m, m, rad, is the pose at the end relative to the pose at the start.
    """

    start_time: FloatArray
    end_time: FloatArray
    relative: FloatArray

    def within(self, time: FloatArray) -> BoolArray:
        """Which relations (k,) lie within the times (n,), s, of a log."""
        first = time.min() - OUTSIDE_BY
        last = time.max() + OUTSIDE_BY
        times = np.array((self.start_time, self.end_time))
        return np.asarray(((times >= first) & (times <= last)).all(axis=0))


@dataclass(frozen=True, eq=False)
class RelationErrors:
    """Errors of a trajectory's motions, for the ``k`` relations within the time of the log."""

    translation: FloatArray  # Length of the translation error (k,), m
    rotation: FloatArray  # Size of the rotation error (k,), rad, 0 to pi
    is_loop: BoolArray  # Whether the relation is over more than 60 s (k,), bool
    unmatched: int  # Number of relations that were left out because they lie outside of the log


def read_relations(path: FilePath) -> Relations:
    """Read relations, plain or gzip: lines ``t1 t2 x y z roll pitch yaw`` (s, m, rad), with
    comments after ``#``. Raises a LogError if the file cannot be read, is cut short, has a line
    with other fields, or has no relations.
    """
    numbers: list[float] = []

    def add(line: bytes) -> None:
        fields = line.partition(b"#")[0].split()
        if fields and len(fields) != len(_FIELDS):
            raise ValueError(
                f"{len(fields)} fields where {len(_FIELDS)} are needed: {' '.join(_FIELDS)}"
            )
        numbers.extend(map(parse_number, fields, _FIELDS))

    read_lines(path, add)
    if not numbers:
        raise LogError(f"{fspath(path)}: has no relations")
    table = np.array(numbers).reshape(-1, len(_FIELDS))
    return Relations(table[:, 0], table[:, 1], table[:, [2, 3, 7]])


def relation_errors(
    relations: Relations, time: FloatArray, poses: FloatArray, odometry: FloatArray | None = None
) -> RelationErrors:
    """Compare a trajectory's motions with known motions: e = inverse(d) * (inverse(x1) * x2).

    Parameters
    ----------
    relations
        Known motions d.
    time
        (n,), s, in any order.
    poses
        Poses of the trajectory at these times (n, 3), m, m, rad. The pose at another time is the
        nearest pose within 0.1 s, or otherwise the previous pose, moved by odometry.
    odometry
        Absolute odometry poses at the same times (n, 3), m, m, rad, interpolated linearly. Without
        odometry the trajectory itself is interpolated.
    """
    inside = relations.within(time)
    start_time = relations.start_time[inside]
    end_time = relations.end_time[inside]
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


def summary(*errors: RelationErrors) -> dict[str, float | int | None]:
    """Mean and standard deviation, m and deg, over all relations and over the loops. None if there
    are none.
    """
    columns = (np.concatenate([getattr(each, name) for each in errors]) for name in _COLUMNS)
    translation, rotation, is_loop = columns
    figures: dict[str, float | int | None] = {}
    for prefix, chosen in (("", np.ones_like(is_loop)), ("loop_", is_loop)):
        count = int(chosen.sum())
        for unit, values in (("m", translation[chosen]), ("deg", np.degrees(rotation[chosen]))):
            name = f"{prefix}relation_error"
            figures[f"{name}_{unit}"] = float(values.mean()) if count else None
            figures[f"{name}_std_{unit}"] = float(values.std()) if count else None
        figures[f"{prefix}relations"] = count
    return {**figures, "relations_unmatched": sum(each.unmatched for each in errors)}


def _poses_at(
    wanted: FloatArray, time: FloatArray, poses: FloatArray, moves: FloatArray
) -> FloatArray:
    """Poses of the trajectory (k, 3) at the wanted times (k,), as :func:`relation_errors`
    describes.
    """
    # The times of a log may step back.
    order = np.argsort(time, kind="stable")
    time = time[order]
    poses = poses[order]
    moves = moves[order]
    before = np.maximum(np.searchsorted(time, wanted, side="right") - 1, 0)
    after = np.minimum(before + 1, len(time) - 1)
    nearest = np.where(np.abs(time[after] - wanted) < np.abs(time[before] - wanted), after, before)
    span = time[after] - time[before]
    # The motion before the first and after the last event is unknown, so the pose stays.
    fraction = np.clip((wanted - time[before]) / np.where(span > 0.0, span, 1.0), 0.0, 1.0)
    moved = se2.compose(poses[before], _part_of_motion(moves[before], moves[after], fraction))
    return np.where(
        (np.abs(time[nearest] - wanted) <= NEAREST_WITHIN)[:, None], poses[nearest], moved
    )


def _part_of_motion(start: FloatArray, end: FloatArray, fraction: FloatArray) -> FloatArray:
    """The first ``fraction`` (k,) of the motions from ``start`` to ``end`` (k, 3), relative to
    ``start``.
    """
    position = start[:, :2] + fraction[:, None] * (end[:, :2] - start[:, :2])
    heading = start[:, 2] + fraction * se2.wrap_angle(end[:, 2] - start[:, 2])
    return se2.between(start, np.column_stack((position, heading)))
