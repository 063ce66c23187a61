"""The text of a video: captions for current events, and a short explanation of each kind of
event.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from limslam_agent.video.belief_frame import BeliefFrame, Event, HoughView

SPEED = 5.0
"""How much faster the video is than the run."""

# s of the video before a more important caption, and before any caption, may follow
_LEAST_HOLD = 0.7
_HOLD = 1.8
_LONGEST_LOG = 24
_WORDS_PER_SECOND = 7.0
# s of the video between two explanations. Without it all pauses would come in the first seconds of
# the run.
_BETWEEN = 4.0
# s of the video after which the caption of an event gives way to the one of driving.
_OUTDATED = 4.0


@dataclass(frozen=True)
class Caption:
    """A headline and an explanation."""

    stages: tuple[int, ...]  # Stages of the method that the caption is about, counted from 0
    headline: str
    explanation: str = ""
    event: Event | None = None  # The event that the caption is about, if it is about walls
    # The votes that the caption is about. They stay in the picture as long as the caption, although
    # newer votes may follow. None shows the latest votes.
    hough: HoughView | None = field(default=None, compare=False)

    @property
    def reading_time(self) -> float:
        """Time to read the caption, s."""
        return 0.5 + len(f"{self.headline} {self.explanation}".split()) / _WORDS_PER_SECOND


LESSONS = {
    "start": Caption(
        (),
        "The robot knows its start pose, but nothing about the building.",
        "It builds the map on the right from a few short range beams and its wheel encoders alone.",
    ),
    "drive": Caption(
        (0,),
        "Predict: the wheel encoders measure the motion, with small errors.",
        "The uncertainty grows with every metre: the ellipse and the sector hold position and "
        "heading (95 %).",
    ),
    "collect": Caption(
        (1,),
        "Collect: a few beams are not enough to see a line at once.",
        "Points on the left and on the right go into one scan buffer each, while the robot drives "
        "on.",
    ),
    "hough": Caption(
        (2,),
        "Find lines: each point of a full scan buffer votes for all lines through it (Hough "
        "transform).",
        "A point gives a curve of votes. Many points lie on one line where many curves cross "
        "(rings).",
    ),
    "new": Caption(
        (3, 4),
        "Associate: this line fits no wall of the map, so it becomes a new wall.",
        "The pale band shows the uncertainty of the wall (2 sigma) in distance and direction.",
    ),
    "again": Caption(
        (3, 4),
        "Correct: this line is a known wall.",
        "The Kalman filter corrects robot and walls by the difference between expected and "
        "observed line.",
    ),
    "goal": Caption(
        (6,),
        "Explore: free cells next to unknown cells are the frontier.",
        "The robot drives to the frontier of least cost, found by Dijkstra's algorithm on the "
        "grid.",
    ),
    "loop": Caption(
        (5,),
        "Close the loop: two walls of the map are the same wall.",
        "The older wall is more certain. It measures the newer one, which corrects the map and "
        "the pose.",
    ),
}

_WEIGHTS = {"warning": 6, "loop": 5, "new": 3, "goal": 2, "hough": 1, "again": 1, "drive": 0}


class Narrator:
    """Chooses the captions so that they can be read, although several events happen in every
    second of a picture that is ``speed`` times faster than the run.

    Attributes
    ----------
    log
        Past events, with the latest first: time (s), kind and text.
    """

    def __init__(self, speed: float = SPEED) -> None:
        self._speed = speed
        self._untaught = set(LESSONS)
        self._last: BeliefFrame | None = None
        self._said = "drive"
        self._since = -np.inf
        self._waiting: dict[str, Caption] = {}
        self._caption = _captions_of_driving(1)
        self._noted = ""
        self._times = 0
        self._explained = -np.inf
        self._robots = 1
        self.log: list[tuple[float, str, str]] = []

    def hear(self, frame: BeliefFrame) -> list[tuple[Caption, float]]:
        """The captions of a frame, each with the time of the video for which the picture pauses, s:
        explanations first, and then the one with which the run continues, without a pause.
        """
        several = len(frame.poses) > 1
        self._robots = len(frame.poses)
        happening = _happenings(frame, self._last)
        for event in frame.events:
            who = f"robot {event.robot + 1}: " if several and event.kind != "loop" else ""
            self._note(frame.time, event.kind, who + event.words)
        for robot in frame.new_goals:
            who = f"robot {robot + 1}: " if several else ""
            self._note(frame.time, "goal", f"{who}drives to a frontier")
        self._last = frame
        captions = _captions(frame)
        self._waiting |= {kind: captions[kind] for kind in happening if kind in captions}
        self._choose(frame.time)
        spoken = [(self._caption, 0.0)]
        kind = self._to_explain(frame.time, happening)
        if kind is not None:
            about: dict[str, Event] = {event.kind: event for event in frame.events}
            lesson = replace(LESSONS[kind], event=about.get(kind))
            spoken.insert(0, (lesson, lesson.reading_time))
        return spoken

    def _to_explain(self, time: float, happening: Sequence[str]) -> str | None:
        """The kind to explain now: one at a time, with some of the run between two. Loops are rare
        and do not wait.
        """
        is_early = (time - self._explained) / self._speed < _BETWEEN
        for kind in happening:
            if kind in self._untaught and (kind == "loop" or not is_early):
                self._explained = time
                self._untaught.remove(kind)
                return kind
        return None

    def _note(self, time: float, kind: str, words: str) -> None:
        """Put an event on top of the log. Repeated events share one line."""
        if self.log and self._noted == words:
            self._times += 1
            self.log[0] = (time, kind, f"{words}, {self._times} times")
            return
        self._noted = words
        self._times = 1
        self.log = [(time, kind, words), *self.log][:_LONGEST_LOG]

    def _choose(self, time: float) -> None:
        """Change the caption after it could be read, if there is another one."""
        held = (time - self._since) / self._speed
        others = {
            kind: caption for kind, caption in self._waiting.items() if kind != self._said
        } or self._waiting
        best = max(others, key=_WEIGHTS.__getitem__, default=None)
        if held > _OUTDATED and (best is None or best == self._said != "drive"):
            self._say("drive", _captions_of_driving(self._robots), time)
        elif best is not None and held >= _LEAST_HOLD:
            is_urgent = _WEIGHTS[best] > _WEIGHTS[self._said]
            if held >= _HOLD or is_urgent:
                self._say(best, self._waiting[best], time)

    def _say(self, kind: str, caption: Caption, time: float) -> None:
        self._said = kind
        self._caption = caption
        self._since = time
        self._waiting = {}


def _happenings(frame: BeliefFrame, last: BeliefFrame | None) -> list[str]:
    """Kinds of the events since the last frame, in the order of the method."""
    if last is None:
        return ["start"]
    before = -np.inf if last.hough is None else last.hough.time
    hough = frame.hough
    kinds = {event.kind for event in frame.events}
    found = {
        "goal": bool(frame.new_goals) and last.time > 0.0,
        "drive": (np.hypot(*(frame.poses[:, :2] - last.poses[:, :2]).T) > 0.01).any(),
        "collect": any(2 * len(each.points) >= each.enough for each in frame.buffers),
        "hough": hough is not None and len(hough.peaks) > 0 and hough.time > before,
        "new": "new" in kinds,
        "again": "again" in kinds,
        "loop": "loop" in kinds,
        "warning": frame.warning != "",
    }
    return [kind for kind, is_so in found.items() if is_so]


def _captions(frame: BeliefFrame) -> dict[str, Caption]:
    """Possible captions of a frame by their kinds."""
    several = len(frame.poses) > 1
    said = {"drive": _captions_of_driving(len(frame.poses))}
    for robot in frame.new_goals:
        said["goal"] = Caption(
            (6,),
            f"Explore{_whose(robot, several)}: a new goal at a frontier.",
            "Of all frontiers, this frontier has the least cost.",
        )
    if frame.hough is not None:
        hough = frame.hough
        count = len(frame.hough.peaks)
        whose = f"robot {hough.robot + 1}'s {hough.side}" if several else f"the {hough.side}"
        lines = "1 line has" if count == 1 else f"{count} lines have"
        said["hough"] = Caption(
            (2,),
            f"Find lines: {whose} buffer was full, and {lines} enough votes.",
            f"Its {len(hough.points)} points voted. Each ring is a line: a corner gives two. The "
            "buffer fills again.",
            hough=hough,
        )
    if frame.warning:
        said["warning"] = Caption(
            (4,),
            f"The estimate is {frame.warning}.",
            "Many readings that contradict the map, or an uncertain heading, show that the pose "
            "may be wrong.",
        )
    for event in frame.events:
        said[event.kind] = _caption_of(event, _whose(event.robot, several), frame.hough)
    return said


def _captions_of_driving(robots: int) -> Caption:
    robots_drive = "the robots drive" if robots > 1 else "the robot drives"
    return Caption(
        (0, 1),
        f"Predict and collect: {robots_drive}, uncertainty grows, scan buffers fill.",
        "Wheel travel moves the estimate. Each side beam that hits something adds a point to its "
        "buffer.",
    )


def _caption_of(event: Event, whose: str, hough: HoughView | None) -> Caption:
    words = {
        "loop": (
            (5,),
            f"Close the loop: wall {event.wall} is the older wall {event.other}.",
            "The loop closure corrects the pose and all walls at once.",
        ),
        "new": (
            (3, 4),
            f"Add{whose}: a line that fits no known wall becomes wall {event.wall}.",
            "The wall enters the state of the filter, with its covariances.",
        ),
        "again": (
            (3, 4),
            f"Associate and correct{whose}: this line is wall {event.wall}, seen again.",
            "The difference between expected and observed line corrects the robot and all walls.",
        ),
    }
    return Caption(*words[event.kind], event, hough)


def _whose(robot: int, several: bool) -> str:
    return f" (robot {robot + 1})" if several else ""
