"""Listens to a mapper step by step, and keeps what happens as a list for the page: extractions,
decisions about lines, corrections, loops, goals.
"""

import math
from itertools import takewhile
from typing import Any

import numpy as np

from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.inspect.columns import rounded
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.slam.core.diagnostics import (
    AssociationRecord,
    CandidateTest,
    Closure,
    Comparison,
    Extraction,
)
from limslam_agent.slam.core.line_fit import bin_size
from limslam_agent.slam.slam import Estimator
from limslam_agent.status.status import LEVELS
from limslam_env.geometry import FloatArray

MOST_TESTS = 10
"""Only so many landmarks are kept of each comparison, the most similar ones."""

_FAR = 1.5
"""Landmarks that are farther away from a line than this, m, are not listed."""

Event = dict[str, Any]

_MOVED_GOAL = 1.0
"""A goal is an event if it has moved by more than this, m."""


class EventLog:
    """Keeps the events of one run. Nothing that it does changes the mapper.

    Attributes
    ----------
    events
        What has happened, each with its ``kind`` and its ``row``, the number of the step.
    associations
        The associations of the present map, each with the step in which it was made.
    """

    def __init__(self, mapper: Mapper) -> None:
        self.events: list[Event] = []
        self.associations: list[tuple[int, AssociationRecord]] = []
        self._mapper = mapper
        self._row = 0
        self._open: tuple[Event, Comparison, int] | None = None
        self._extraction: Extraction | None = None
        self._closures = 0
        self._frame = mapper.frame
        self._places = 0
        self._goals = np.full((len(mapper.poses), 2), np.nan)
        self._levels = [0] * len(mapper.poses)
        self._slam: Estimator | None = None
        self._listen()

    def note(self, goals: FloatArray) -> None:
        """Take a step that the mapper has made, with the goal (n, 2), m, of each robot, NaN for
        none.
        """
        self._close()
        self._look_at(self._mapper.slam)
        self._note_changes()
        self._listen()
        self._note_goals(goals)
        self._row += 1

    def finish(self) -> None:
        """Note what the mapper has done with the pending readings at the end of the run."""
        self._row = max(self._row - 1, 0)
        self._close()
        self._listen()
        self._look_at(self._mapper.slam)
        self._note_changes()

    @property
    def is_in_another_frame(self) -> bool:
        """Whether the mapper has changed its frame since the last step that was noted."""
        return self._mapper.frame != self._frame

    def mark(self, row: int, kind: str, words: str) -> None:
        """Add an event of a step that the mapper does not know, such as that the robot was carried
        away.
        """
        self.events.append({"row": row, "kind": kind, "words": words})
        self.events.sort(key=lambda event: int(event["row"]))

    def _listen(self) -> None:
        """Keep the associations of the present map, and listen to its SLAM: another frame has
        another one.

        The local map of a lost robot is left alone, since most of it is forgotten.
        """
        slam = self._mapper.slam
        is_lost = self._mapper.statuses[0].level == "lost"
        if slam is not self._slam:
            if self._slam is not None and not self._mapper.frame:
                words = "all observations are processed again, with what is known now"
                self._add({"kind": "restart", "words": words})
            if not is_lost:
                slam.on_association = self._on_association
                slam.on_comparison = self._on_comparison
                kept = zip(self.associations, slam.associations, strict=False)
                del self.associations[
                    sum(1 for _ in takewhile(lambda pair: pair[0][1] is pair[1], kept)) :
                ]
            self._slam = slam
            self._closures = len(slam.closures)
            self._extraction = slam.last_extraction
        if slam.on_association is not None:
            self.associations += [
                (self._row, record) for record in slam.associations[len(self.associations) :]
            ]

    def _on_comparison(self, comparison: Comparison) -> None:
        slam = self._slam
        assert slam is not None  # noqa: S101 (it calls this)
        self._close()
        self._look_at(slam)
        event = self._add(_comparison_event(comparison, slam))
        self._open = event, comparison, len(slam.closures)

    def _on_association(self, record: AssociationRecord) -> None:
        if self._open is None or self._slam is None or self._open[1].robot != record.robot:
            return
        event, _, _ = self._open
        _correct(event, record, self._slam)
        self._open = None

    def _close(self) -> None:
        """Finish the event of a line that was compared but not associated."""
        if self._open is None or self._slam is None:
            return
        event, _, closures = self._open
        self._open = None
        merges = isinstance(self._mapper.config.estimator, ConsistentConfig)
        if len(self._slam.closures) > closures and not merges:
            event["why"] = (
                "it shows that two walls are one: it closes the loop and is not used further"
            )
            return
        _explain_waiting(event, self._mapper.slam.association_limits)

    def _add(self, event: Event) -> Event:
        event["row"] = self._row
        self.events.append(event)
        return event

    def _look_at(self, slam: Estimator) -> None:
        """Note a new extraction, and the loops that were closed."""
        last = slam.last_extraction
        hough = slam.config.estimator.hough
        if last is not None and last is not self._extraction and slam is self._slam:
            self._extraction = last
            if len(last.points):
                self._add(
                    _extraction_event(last, hough.min_votes, bin_size(hough, slam.config.range_std))
                )
        if slam is self._slam:
            for closure in slam.closures[self._closures :]:
                self._add(_loop_event(closure))
            self._closures = len(slam.closures)

    def _note_changes(self) -> None:
        """Note a new frame of the map, what happened to a lost robot, and changes of the status."""
        mapper = self._mapper
        records = mapper.places.records
        for record in records[self._places :]:
            words = [str(record[name]) for name in ("event", "reason") if record.get(name)]
            self._add({"kind": "place", "words": ": ".join(words)})
        if mapper.frame != self._frame and len(records) == self._places:
            self._add({"kind": "place", "words": "the map goes on in another frame"})
        self._places = len(records)
        self._frame = mapper.frame
        for number, status in enumerate(mapper.statuses):
            level = LEVELS.index(status.level)
            if level != self._levels[number]:
                self._add(
                    {"kind": "status", "robot": number, "level": level, "words": status.words}
                )
                self._levels[number] = level

    def _note_goals(self, goals: FloatArray) -> None:
        for number, goal in enumerate(goals):
            is_near = np.hypot(*(goal - self._goals[number])) <= _MOVED_GOAL
            if not (np.isnan(goal).any() or is_near):
                self._goals[number] = goal
                self._add({"kind": "goal", "robot": number, "goal": rounded(goal, 2)})


def _estimate(slam: Estimator, robot: int) -> dict[str, list[float]]:
    """A robot's pose, and the six numbers of its covariance: xx, xy, xt, yy, yt, tt. Small numbers
    keep their digits.
    """
    triangle = slam.covariances[robot][np.triu_indices(3)].tolist()
    return {
        "pose": rounded(slam.poses[robot], 5),
        "cov": [float(f"{value:.4g}") for value in triangle],
    }


def _extraction_event(extraction: Extraction, threshold: int, r_step: float) -> Event:
    """The lines that were found in one scan. The page counts the votes again from the points, which
    is exact and small.

    Points are whole millimetres in the robot's frame, and lines are (r, theta) there.
    """
    return {
        "kind": "hough",
        "robot": extraction.robot,
        "side": extraction.side,
        "pose": rounded(extraction.pose),
        "points": np.rint(1e3 * extraction.points).astype(int).ravel().tolist(),
        "lines": rounded(extraction.lines),
        "ends": rounded(extraction.ends.reshape(-1, 4), 3),
        "threshold": threshold,
        "r_step": r_step,
    }


def _comparison_event(comparison: Comparison, slam: Estimator) -> Event:
    """An observed line with the landmarks that it was compared with, and the pose before it is
    used.
    """
    robot = comparison.robot
    return {
        "kind": "waits",
        "robot": robot,
        "ends": rounded(comparison.ends.ravel(), 3),
        "used": len(comparison.readings),
        "tests": [_row(test) for test in _nearest(comparison.tests)],
        "before": _estimate(slam, robot),
    }


def _correct(event: Event, record: AssociationRecord, slam: Estimator) -> None:
    """Change the event of a comparison into the one of the association that followed, with the pose
    after it.
    """
    robot = record.robot
    event |= {
        "kind": "new" if record.is_new else "again",
        "wall": record.landmark + 1,
        "after": _estimate(slam, robot),
    }


def _explain_waiting(event: Event, limits: dict[str, float]) -> None:
    """Say why a line was not used, from the distances of the walls that it was compared with."""
    known = [test for test in event["tests"] if test["d2"] is not None]
    fits = sorted((test["d2"], test["wall"]) for test in known if test["out"] == "")
    near = [test["wall"] for test in known if test["d2"] <= limits.get("far_gate", 0.0)]
    if fits:
        why = f"wall {fits[0][1]} fits, but its points are too few, not straight enough, or beyond "
        why += "its ends"
    elif near:
        why = f"it is neither clearly wall {near[0]} nor clearly another wall: the points wait"
    elif "far_gate" in limits:
        why = "no wall fits, and for a new wall it is too short or too uncertain: the points wait"
    else:
        why = "no wall fits, and for a new wall it is too short: the points are dropped"
    event["why"] = why


def _loop_event(closure: Closure) -> Event:
    """Two walls that were found to be one."""
    return {
        "kind": "loop",
        "wall": closure.younger + 1,
        "other": closure.older + 1,
        "d2": rounded([closure.distance_before, closure.distance_after], 3),
        "offset": rounded([closure.offset_before, closure.offset_after]),
    }


def _nearest(tests: tuple[CandidateTest, ...]) -> list[CandidateTest]:
    """The landmarks most like a line: first those that passed the tests, and then by offset and
    gap.
    """
    near = [
        test
        for test in tests
        if test.excluded in {"", "gate"} or (test.offset < _FAR and test.gap < _FAR)
    ]
    return sorted(near, key=_unlikeness)[:MOST_TESTS]


def _unlikeness(test: CandidateTest) -> tuple[bool, float]:
    if math.isfinite(test.distance):
        return False, test.distance
    return True, test.offset + max(test.gap, 0.0) + test.angle


def _row(test: CandidateTest) -> dict[str, Any]:
    return {
        "wall": test.landmark + 1,
        "out": test.excluded,
        "angle": rounded(math.degrees(test.angle), 1),
        "offset": rounded(test.offset, 3),
        "gap": rounded(test.gap, 3),
        "d2": rounded(test.distance, 2),
    }
