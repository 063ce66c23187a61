"""What happens in a run, as a list for the page: extractions, decisions about lines, corrections, loops, goals."""

import math
from typing import Any

import numpy as np

from limslam_agent.slam.core.diagnostics import AssociationRecord, CandidateTest, Closure, Comparison, Extraction
from limslam_agent.slam.slam import LineSlam
from limslam_env.geometry import FloatArray

MOST_TESTS = 10
"""Only so many landmarks are kept of each comparison, the most similar ones."""

_FAR = 1.5
"""Landmarks that are farther away from a line than this, m, are not listed."""

Event = dict[str, Any]


def rounded(values: Any, digits: int = 4) -> Any:
    """Numbers or nested lists of numbers for JSON, with a few digits. What is not finite becomes None."""
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if isinstance(values, list | tuple):
        return [rounded(value, digits) for value in values]
    return round(float(values), digits) if math.isfinite(values) else None


def upper_triangle(covariance: FloatArray) -> list[float]:
    """The six numbers of a covariance (3, 3): xx, xy, xt, yy, yt, tt. Small numbers keep their digits."""
    return [float(f"{value:.4g}") for value in covariance[np.triu_indices(3)].tolist()]


def extraction_event(extraction: Extraction, threshold: int, r_step: float) -> Event:
    """The lines that were found in one scan. The page counts the votes again from the points, which is exact and small.

    Points are whole millimetres in the robot's frame, and lines are (r, theta) there.
    """
    return {
        "kind": "hough", "robot": extraction.robot, "side": extraction.side, "pose": rounded(extraction.pose),
        "points": np.rint(1e3 * extraction.points).astype(int).ravel().tolist(),
        "lines": rounded(extraction.lines), "ends": rounded(extraction.ends.reshape(-1, 4), 3),
        "threshold": threshold, "r_step": r_step,
    }  # fmt: skip


def comparison_event(comparison: Comparison, slam: LineSlam) -> Event:
    """An observed line with the landmarks that it was compared with, and the pose before it is used."""
    robot = comparison.robot
    return {
        "kind": "waits", "robot": robot, "ends": rounded(comparison.ends.ravel(), 3), "used": len(comparison.readings),
        "tests": [_row(test) for test in _nearest(comparison.tests)],
        "before": {"pose": rounded(slam.poses[robot], 5), "cov": upper_triangle(slam.covariances[robot])},
    }  # fmt: skip


def correct(event: Event, record: AssociationRecord, slam: LineSlam) -> None:
    """Change the event of a comparison into the one of the association that followed, with the pose after it."""
    robot = record.robot
    event |= {
        "kind": "new" if record.is_new else "again", "wall": record.landmark + 1,
        "after": {"pose": rounded(slam.poses[robot], 5), "cov": upper_triangle(slam.covariances[robot])},
    }  # fmt: skip


def explain_waiting(event: Event, limits: dict[str, float]) -> None:
    """Say why a line was not used, from the distances of the walls that it was compared with."""
    fits = sorted((test["d2"], test["wall"]) for test in event["tests"] if test["out"] == "" and test["d2"] is not None)
    near = [test for test in event["tests"] if test["d2"] is not None and test["d2"] <= limits.get("far_gate", 0.0)]
    if fits:
        event["why"] = f"wall {fits[0][1]} fits, but its points are too few, not straight enough, or beyond its ends"
    elif near:
        event["why"] = f"it is neither clearly wall {near[0]['wall']} nor clearly another wall: the points wait"
    elif "far_gate" in limits:
        event["why"] = "no wall fits, and for a new wall it is too short or too uncertain: the points wait"
    else:
        event["why"] = "no wall fits, and for a new wall it is too short: the points are dropped"


def loop_event(closure: Closure) -> Event:
    """Two walls that were found to be one."""
    return {
        "kind": "loop", "wall": closure.younger + 1, "other": closure.older + 1,
        "d2": rounded([closure.distance_before, closure.distance_after], 3),
        "offset": rounded([closure.offset_before, closure.offset_after]),
    }  # fmt: skip


def _nearest(tests: tuple[CandidateTest, ...]) -> list[CandidateTest]:
    """The landmarks most like a line: first those that passed the tests, and then by offset and gap."""
    near = [test for test in tests if test.excluded in {"", "gate"} or (test.offset < _FAR and test.gap < _FAR)]
    return sorted(near, key=_unlikeness)[:MOST_TESTS]


def _unlikeness(test: CandidateTest) -> tuple[bool, float]:
    if math.isfinite(test.distance):
        return False, test.distance
    return True, test.offset + max(test.gap, 0.0) + test.angle


def _row(test: CandidateTest) -> dict[str, Any]:
    return {
        "wall": test.landmark + 1, "out": test.excluded, "angle": rounded(math.degrees(test.angle), 1),
        "offset": rounded(test.offset, 3), "gap": rounded(test.gap, 3), "d2": rounded(test.distance, 2),
    }  # fmt: skip
