"""Precision and recall of the loops of a smoothed log, against known relations.

A relation says how two places of a log lie to each other. A loop between two other times can be compared with it where
the robot has driven only a little between the times: odometry is accurate enough over so short a way.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from limslam_agent.logs.relations import LOOP_AFTER, Relations
from limslam_env.geometry import BoolArray, FloatArray, IntArray, se2

KEPT = "kept"
"""The reason of loops that are part of the result, as ``loops.json`` has it."""

COMPARED_WITHIN = 2.0
"""A loop is compared with a relation if this distance or less was driven between them at both ends, m."""

HOLDS_WITHIN = 3.5
"""A loop holds the path up to this distance of driving from its ends, m: half of the length of a chunk."""

RIGHT_WITHIN = 1.0, np.radians(20.0)
"""A loop is right if it differs from the relation by at most this, m and rad, short drives by odometry included."""


def loop_scores(
    loops: Sequence[dict[str, Any]], relations: Relations, time: FloatArray, odometry: FloatArray
) -> dict[str, Any]:
    """Precision and recall of loops, by their names in ``docs/metrics.md``.

    Parameters
    ----------
    loops
        Entries of ``loops.json``.
    relations
        Known motions. Only those over more than 60 s count.
    time, odometry
        Times (n,), s, and poses by odometry (n, 3), m and rad, of all events.
    """
    order = np.argsort(time, kind="stable")
    time, odometry = time[order], odometry[order]
    travel = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(odometry[:, :2], axis=0).T))))
    known, truth = _both_ways(relations, time)
    ends = _events(time, np.array([(loop["first_time"], loop["second_time"]) for loop in loops]).reshape(-1, 2))
    relative = np.array([loop["relative"] for loop in loops]).reshape(-1, 3)
    kept = np.array([loop["reason"] == KEPT for loop in loops], dtype=np.bool_)
    apart = np.abs(travel[ends][:, None] - travel[known][None]).max(axis=2)
    judged, right = _judged(apart, ends, relative, known, truth, odometry)
    good = judged & right & kept
    half = apart[:, : len(known) // 2]
    held = (half[good] <= HOLDS_WITHIN).any(axis=0) | (apart[:, len(known) // 2 :][good] <= HOLDS_WITHIN).any(axis=0)
    return {
        "loops_judged": int((judged & kept).sum()),
        "loops_precision": _share(good.sum(), (judged & kept).sum()),
        "loops_recall": _share(held.sum(), len(held)),
        "loops_right_but_left_out": int((judged & right & ~kept).sum()),
    }


def _both_ways(relations: Relations, time: FloatArray) -> tuple[IntArray, FloatArray]:
    """Events (2 k, 2) of the loops among the relations, and their motions (2 k, 3), forwards and then backwards."""
    pairs = np.column_stack((relations.start_time, relations.end_time))
    inside = (pairs.min(axis=1) >= time[0]) & (pairs.max(axis=1) <= time[-1])
    chosen = inside & (np.abs(pairs[:, 1] - pairs[:, 0]) > LOOP_AFTER)
    events, motions = _events(time, pairs[chosen]), relations.relative[chosen]
    return np.vstack((events, events[:, ::-1])), np.vstack((motions, se2.inverse(motions)))


def _events(time: FloatArray, wanted: FloatArray) -> IntArray:
    """The events nearest to the wanted times."""
    after = np.clip(np.searchsorted(time, wanted), 1, len(time) - 1)
    return np.asarray(np.where(wanted - time[after - 1] < time[after] - wanted, after - 1, after))


def _judged(
    apart: FloatArray, ends: IntArray, relative: FloatArray, known: IntArray, truth: FloatArray, odometry: FloatArray
) -> tuple[BoolArray, BoolArray]:
    """Which loops (k,) have a relation nearby, and which loops agree with the nearest relation."""
    if not apart.size:
        return np.zeros(len(apart), dtype=np.bool_), np.zeros(len(apart), dtype=np.bool_)
    nearest = apart.argmin(axis=1)
    before = se2.between(odometry[ends[:, 0]], odometry[known[nearest, 0]])
    after = se2.between(odometry[known[nearest, 1]], odometry[ends[:, 1]])
    error = se2.between(se2.compose(se2.compose(before, truth[nearest]), after), relative)
    right = (np.hypot(error[:, 0], error[:, 1]) <= RIGHT_WITHIN[0]) & (np.abs(error[:, 2]) <= RIGHT_WITHIN[1])
    return apart.min(axis=1) <= COMPARED_WITHIN, right


def _share(part: int, whole: int) -> float | None:
    return float(part / whole) if whole else None
