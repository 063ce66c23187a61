"""The text of a video: what happens, and why, in two lines for each kind of event."""

from limslam_agent.video.belief_picture import BeliefFrame, Event

SPEED = 5.0
"""How much faster the video is than the run."""

LESSONS = {
    "start": (
        "The robot knows its start pose, but nothing about the building.",
        "It builds the map on the right from a few short range beams and its wheel encoders alone.",
    ),
    "drive": (
        "Predict and collect: wheel encoders measure the motion, and beams that hit add points to two scan buffers.",
        "The uncertainty grows with every metre: the ellipse and the sector hold position and heading (95 %).",
    ),
    "hough": (
        "Find lines: each point of a full scan buffer votes for all lines through it (Hough transform).",
        "A point gives a curve of votes. Many points lie on one line where many curves cross.",
    ),
    "new": (
        "Associate: this line fits no wall of the map, so it becomes a new wall.",
        "The pale band shows the uncertainty of the wall (2 sigma) in distance and direction.",
    ),
    "again": (
        "Correct: this line is a known wall.",
        "The Kalman filter corrects robot and walls by the difference between expected and observed line.",
    ),
    "goal": (
        "Explore: free cells next to unknown cells are the frontier.",
        "The robot drives to the frontier of least cost, found by Dijkstra's algorithm on the grid.",
    ),
    "loop": (
        "Close the loop: two walls of the map are the same wall.",
        "The older wall is more certain. It measures the newer one, which corrects the map and the pose.",
    ),
    "doubt": (
        "The estimate cannot be trusted at the moment.",
        "Many readings that contradict the map, or an uncertain heading, show that the pose may be wrong.",
    ),
}
"""A headline and an explanation for each kind of event."""

# Seconds of the video before a more important caption may follow, before any may, and until the one of driving does.
_LEAST_HOLD, _HOLD, _LONGEST = 1.5, 2.5, 4.0

_WEIGHTS = {"doubt": 6, "loop": 5, "start": 4, "new": 3, "goal": 2, "hough": 1, "again": 1, "drive": 0}


class Narrator:
    """Chooses the captions so that they can be read, although several events happen in every second."""

    def __init__(self) -> None:
        self._kind, self._since = "start", 0.0
        self._event: Event | None = None
        self._waiting: dict[str, Event | None] = {}
        self._extracted = -1.0

    def hear(self, frame: BeliefFrame) -> tuple[str, Event | None]:
        """The kind of the caption of a frame, as in ``LESSONS``, and the event of walls that it is about, if any."""
        self._waiting |= self._happening(frame)
        held = (frame.time - self._since) / SPEED
        best = max(self._waiting, key=_WEIGHTS.__getitem__, default="drive")
        is_urgent = _WEIGHTS[best] > _WEIGHTS[self._kind]
        if held >= (_LEAST_HOLD if is_urgent else _HOLD if self._waiting else _LONGEST):
            self._kind, self._event, self._since = best, self._waiting.get(best), frame.time
            self._waiting = {}
        return self._kind, self._event

    def _happening(self, frame: BeliefFrame) -> dict[str, Event | None]:
        """The events since the last frame by their kinds."""
        found: dict[str, Event | None] = {event.kind: event for event in frame.events}
        if frame.is_doubted:
            found["doubt"] = None
        if frame.has_new_goal and frame.time > 0.0:
            found["goal"] = None
        if frame.extraction is not None and frame.extraction.time > self._extracted:
            self._extracted = frame.extraction.time
            found["hough"] = None
        return found
