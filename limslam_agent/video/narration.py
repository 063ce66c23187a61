"""What a video says: a caption for what is happening now, and a short lesson when it happens for the first time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from limslam_agent.video.belief_frame import BeliefFrame, Event

_LEAST_HOLD, _HOLD = 0.7, 1.8  # s of the video: before something greater may take over, and before anything may
_MOVED_GOAL = 1.0  # m; goals that wander along a frontier are no news
_LONGEST_LOG = 24
_WORDS_PER_SECOND = 5.0


@dataclass(frozen=True)
class Caption:
    """A line in words, and some more below it.

    Attributes
    ----------
    stages
        Which stages of the method it speaks of, counted from 0.
    headline, explanation
        The words.
    event
        What it speaks of, if that is about walls.
    """

    stages: tuple[int, ...]
    headline: str
    explanation: str = ""
    event: Event | None = None

    @property
    def reading_time(self) -> float:
        """How long it takes to read, s."""
        return 1.0 + len(f"{self.headline} {self.explanation}".split()) / _WORDS_PER_SECOND


@dataclass(frozen=True)
class Moment:
    """A caption, and how long the picture stands still for it, s of the video; 0 lets it go on."""

    caption: Caption
    pause: float


LESSONS = {
    "start": Caption(
        (),
        "The robot knows where it starts, and nothing else about the building.",
        "A few short beams and the turning of its wheels are all it has to draw the map on the right.",
    ),
    "drive": Caption(
        (0,),
        "Predict: the wheels tell how far it has gone, but they slip a little.",
        "So doubt grows with every metre: its position lies in the ellipse, its heading in the fan (95 %).",
    ),
    "collect": Caption(
        (1,),
        "Collect: a few beams are too few to see a line at once.",
        "Points on the left and on the right go into a buffer each, which is carried along as the robot drives.",
    ),
    "hough": Caption(
        (2,),
        "Find lines: a full buffer is handed on, and each of its points votes for all lines through it.",
        "A point gives a curve of votes. Where many curves cross, many points lie on one line: the rings.",
    ),
    "new": Caption(
        (3, 4),
        "Associate: no wall of the map is where this line is, so it becomes a new wall.",
        "The pale band is where the wall may be (2 sigma): its distance and its direction are both uncertain.",
    ),
    "again": Caption(
        (3, 4),
        "Correct: this line is a wall that is known already.",
        "It is not quite where it was expected: the Kalman filter moves the robot and all walls accordingly.",
    ),
    "goal": Caption(
        (6,),
        "Explore: known floor ends at the frontier cells. What is behind them?",
        "The robot goes to the one that costs least to reach: Dijkstra's algorithm on the grid.",
    ),
    "loop": Caption(
        (5,),
        "Close the loop: two walls of the map turn out to be the same wall.",
        "The older one is known better. Taking it for a measurement of the younger corrects all that came in between.",
    ),
}

_WEIGHTS = {"loop": 5, "new": 3, "goal": 2, "hough": 1, "again": 1, "drive": 0}


class Narrator:
    """Chooses what is said, so that it can be read although several things happen in every second.

    Parameters
    ----------
    speed
        Simulated seconds in a second of the video.
    explain
        Whether the picture stands still for a lesson when something happens for the first time.

    Attributes
    ----------
    log
        What has happened, the latest first: time (s), kind and words.
    """

    def __init__(self, speed: float, *, explain: bool = True) -> None:
        self._speed = speed
        self._untaught = set(LESSONS) if explain else set()
        self._last: BeliefFrame | None = None
        self._said, self._since = "drive", -np.inf
        self._waiting: dict[str, Caption] = {}
        self._caption = _captions_of_driving(1)
        self._noted, self._times = "", 0
        self.log: list[tuple[float, str, str]] = []

    def hear(self, frame: BeliefFrame) -> list[Moment]:
        """What is to be said about a frame: lessons, and the caption under which things go on last."""
        several = len(frame.poses) > 1
        new_goals = self._new_goals(frame)
        happening = _happenings(frame, self._last, new_goals)
        for event in frame.events:
            self._note(frame.time, event.kind, _who(event.robot, several and event.kind != "loop") + event.words)
        for robot in new_goals:
            self._note(frame.time, "goal", _who(robot, several) + "goes to a frontier")
        about: dict[str, Event] = {event.kind: event for event in frame.events}
        lessons = [replace(LESSONS[kind], event=about.get(kind)) for kind in happening if kind in self._untaught]
        self._untaught -= set(happening)
        self._last = frame
        self._waiting |= {kind: caption for kind, caption in _captions(frame, new_goals).items() if kind in happening}
        self._choose(frame.time)
        return [*(Moment(lesson, lesson.reading_time) for lesson in lessons), Moment(self._caption, 0.0)]

    def _note(self, time: float, kind: str, words: str) -> None:
        """Put something on top of the log; what happens again and again takes one line."""
        if self.log and self._noted == words:
            self._times += 1
            self.log[0] = (time, kind, f"{words}, {self._times} times")
            return
        self._noted, self._times = words, 1
        self.log = [(time, kind, words), *self.log][:_LONGEST_LOG]

    def _new_goals(self, frame: BeliefFrame) -> list[int]:
        before = self._last.goals if self._last is not None else ()
        old = [*before, *([None] * (len(frame.goals) - len(before)))]
        return [
            number
            for number, (was, goal) in enumerate(zip(old, frame.goals, strict=False))
            if goal is not None and (was is None or np.hypot(*(goal - was)) > _MOVED_GOAL)
        ]

    def _choose(self, time: float) -> None:
        """Another caption, when the present one could be read and there is something else to say."""
        held = (time - self._since) / self._speed
        others = {kind: caption for kind, caption in self._waiting.items() if kind != self._said} or self._waiting
        best = max(others, key=_WEIGHTS.__getitem__, default=None)
        if best is None or held < _LEAST_HOLD:
            return
        if held < _HOLD and _WEIGHTS[best] <= _WEIGHTS[self._said]:
            return
        self._said, self._caption, self._since = best, self._waiting[best], time
        self._waiting = {}


def _happenings(frame: BeliefFrame, last: BeliefFrame | None, new_goals: Sequence[int]) -> list[str]:
    """Kinds of what has happened since the last frame, in the order of the method."""
    if last is None:
        return ["start"]
    is_extracted = frame.hough is not None and len(frame.hough.peaks) and frame.hough is not last.hough
    is_collected = any(2 * len(buffer.points) >= buffer.size for buffer in frame.buffers)
    kinds = {event.kind for event in frame.events}
    found = {
        "goal": bool(new_goals) and last.time > 0.0,
        "drive": _has_moved(frame, last),
        "collect": is_collected,
        "hough": is_extracted and (last.hough is None or frame.hough is None or frame.hough.time > last.hough.time),
        "new": "new" in kinds,
        "again": "again" in kinds,
        "loop": "loop" in kinds,
    }
    return [kind for kind, is_so in found.items() if is_so]


def _has_moved(frame: BeliefFrame, last: BeliefFrame) -> bool:
    return bool((np.hypot(*(frame.poses[:, :2] - last.poses[:, :2]).T) > 0.01).any())


def _captions(frame: BeliefFrame, new_goals: Sequence[int]) -> dict[str, Caption]:
    """What could be said of a frame, by kind."""
    several = len(frame.poses) > 1
    said = {"drive": _captions_of_driving(len(frame.poses))}
    for robot in new_goals:
        said["goal"] = Caption(
            (6,), f"Explore{_whose(robot, several)}: a new goal, where known floor meets the unknown.",
            "Of all frontiers it is the one that costs least to reach.",
        )  # fmt: skip
    if frame.hough is not None:
        hough, count = frame.hough, len(frame.hough.peaks)
        whose = f"robot {hough.robot + 1}'s {hough.side}" if several else f"the {hough.side}"
        lines = "1 line has" if count == 1 else f"{count} lines have"
        said["hough"] = Caption(
            (2,), f"Find lines: {whose} buffer is handed on, and {lines} votes enough.",
            f"Its {len(hough.points)} points voted; every peak over the threshold is taken, so a corner gives two.",
        )  # fmt: skip
    for event in frame.events:
        said[event.kind] = _caption_of(event, _whose(event.robot, several))
    return said


def _captions_of_driving(robots: int) -> Caption:
    they = "the robots drive on" if robots > 1 else "the robot drives on"
    return Caption(
        (0, 1), f"Predict and collect: {they}, doubt grows, the buffers fill.",
        "Wheel travel moves the belief; beams that hit something on a side add a point to its buffer.",
    )  # fmt: skip


def _caption_of(event: Event, whose: str) -> Caption:
    words = {
        "loop": (
            (5,), f"Close the loop: wall {event.wall} is the older wall {event.other}.",
            "All that came in between is corrected at once.",
        ),
        "new": (
            (3, 4), f"Add{whose}: a line that fits no known wall becomes wall {event.wall}.",
            "It enters the state with its covariance with everything that is in it.",
        ),
        "again": (
            (3, 4), f"Associate and correct{whose}: this line is wall {event.wall}, seen again.",
            "The difference between expected and seen corrects the robot and all walls.",
        ),
    }  # fmt: skip
    return Caption(*words[event.kind], event)


def _who(robot: int, several: bool) -> str:
    return f"robot {robot + 1}: " if several else ""


def _whose(robot: int, several: bool) -> str:
    return f" (robot {robot + 1})" if several else ""
