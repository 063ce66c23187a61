"""Listens to a mapper step by step, and keeps what happens: extractions, decisions about lines, loops, goals."""

from itertools import takewhile

import numpy as np

from limslam_agent.config.presets import ConsistentConfig
from limslam_agent.inspect.events import (
    Event,
    comparison_event,
    correct,
    explain_waiting,
    extraction_event,
    loop_event,
    rounded,
)
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.slam.core.diagnostics import AssociationRecord, Comparison, Extraction
from limslam_agent.slam.core.line_fit import bin_size
from limslam_agent.slam.slam import LineSlam
from limslam_agent.status.status import LEVELS
from limslam_env.geometry import FloatArray

_MOVED_GOAL = 1.0
"""A goal is an event if it has moved by more than this, m."""


class EventLog:
    """Keeps the events of one run. Nothing that it does changes the mapper.

    Parameters
    ----------
    mapper
        The mapper.

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
        self._mapper, self._row = mapper, 0
        self._open: tuple[Event, Comparison, int] | None = None
        self._extraction: Extraction | None = None
        self._closures, self._frame, self._places = 0, mapper.frame, 0
        self._goals = np.full((len(mapper.poses), 2), np.nan)
        self._levels = [0] * len(mapper.poses)
        self._slam: LineSlam | None = None
        self._listen()

    def note(self, goals: FloatArray) -> None:
        """Take a step that the mapper has made, with the goal (n, 2), m, of each robot, NaN for none."""
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
        """Add an event of a step that the mapper does not know, such as that the robot was carried away."""
        self.events.append({"row": row, "kind": kind, "words": words})
        self.events.sort(key=lambda event: int(event["row"]))

    def _listen(self) -> None:
        """Keep the associations of the present map, and listen to its SLAM: another frame has another one.

        The local map of a lost robot is left alone, since most of it is forgotten.
        """
        slam, is_lost = self._mapper.slam, self._mapper.statuses[0].level == "lost"
        if slam is not self._slam:
            if self._slam is not None and not self._mapper.frame:
                self._add({"kind": "restart", "words": "all observations are processed again, with what is known now"})
            if not is_lost:
                slam.on_association, slam.on_comparison = self._on_association, self._on_comparison
                kept = zip(self.associations, slam.associations, strict=False)
                del self.associations[sum(1 for _ in takewhile(lambda pair: pair[0][1] is pair[1], kept)) :]
            self._slam, self._closures, self._extraction = slam, len(slam.closures), slam.last_extraction
        if slam.on_association is not None:
            self.associations += [(self._row, record) for record in slam.associations[len(self.associations) :]]

    def _on_comparison(self, comparison: Comparison) -> None:
        slam = self._slam
        assert slam is not None  # noqa: S101 (it calls this)
        self._close()
        self._look_at(slam)
        event = self._add(comparison_event(comparison, slam))
        self._open = event, comparison, len(slam.closures)

    def _on_association(self, record: AssociationRecord) -> None:
        if self._open is None or self._slam is None or self._open[1].robot != record.robot:
            return
        event, _, _ = self._open
        correct(event, record, self._slam)
        self._open = None

    def _close(self) -> None:
        """Finish the event of a line that was compared but not associated."""
        if self._open is None or self._slam is None:
            return
        (event, _, closures), self._open = self._open, None
        if len(self._slam.closures) > closures and not self._mapper_merges:
            event["why"] = "it shows that two walls are one: it closes the loop and is not used further"
            return
        explain_waiting(event, self._mapper.slam.association_limits)

    @property
    def _mapper_merges(self) -> bool:
        return isinstance(self._mapper.config.estimator, ConsistentConfig)

    def _add(self, event: Event) -> Event:
        event["row"] = self._row
        self.events.append(event)
        return event

    def _look_at(self, slam: LineSlam) -> None:
        """Note a new extraction, and the loops that were closed."""
        last, hough = slam.last_extraction, slam.config.estimator.hough
        if last is not None and last is not self._extraction and slam is self._slam:
            self._extraction = last
            if len(last.points):
                self._add(extraction_event(last, hough.min_votes, bin_size(hough, slam.config.range_std)))
        if slam is self._slam:
            for closure in slam.closures[self._closures :]:
                self._add(loop_event(closure))
            self._closures = len(slam.closures)

    def _note_changes(self) -> None:
        """Note a new frame of the map, what happened to a lost robot, and changes of the status."""
        mapper = self._mapper
        records = mapper.places.records
        for record in records[self._places :]:
            words = f"{record['event']}: {record['reason']}" if record.get("reason") else str(record["event"])
            self._add({"kind": "place", "words": words})
        if mapper.frame != self._frame and len(records) == self._places:
            self._add({"kind": "place", "words": "the map goes on in another frame"})
        self._places, self._frame = len(records), mapper.frame
        for number, status in enumerate(mapper.statuses):
            level = LEVELS.index(status.level)
            if level != self._levels[number]:
                self._add({"kind": "status", "robot": number, "level": level, "words": status.words})
                self._levels[number] = level

    def _note_goals(self, goals: FloatArray) -> None:
        for number, goal in enumerate(goals):
            is_near = np.hypot(*(goal - self._goals[number])) <= _MOVED_GOAL
            if not (np.isnan(goal).any() or is_near):
                self._goals[number] = goal
                self._add({"kind": "goal", "robot": number, "goal": rounded(goal, 2)})
