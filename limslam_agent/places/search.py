"""The search for the place of a drive in one map, now and then while the robot drives on.

The same search serves a robot that is lost from a map, one that begins in the map of an earlier run, and two robots
that do not know where they are relative to each other. Its answer is a pose of the drive's frame in the map.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from limslam_agent.places.localisation import KnownPlaces, Localisation, agree, localise
from limslam_agent.status.known_map import PlaceFit
from limslam_agent.status.monitor import TURN_LENGTH
from limslam_agent.status.sudden_changes import WINDOW
from limslam_env.geometry import FloatArray

_FIRST, _SPACING = 0.8, 0.35  # m: way to the first search, and between two of them

LARGEST_RUNNER_UP = 0.70
"""Largest evidence of another place, as a share of the best one, at which a place is confirmed."""

CONFIRMED, FAR_CONFIRMED = WINDOW, 30.0
"""A place is confirmed after so much driving without contradictions, m: in a map without a frontier, and in any map."""


class PlaceSearch:
    """Searches one map.

    Attributes
    ----------
    place
        The map.
    latest
        The latest search; None before the first one.
    """

    def __init__(self, place: KnownPlaces) -> None:
        self.place = place
        self.latest: Localisation | None = None
        self._way, self._refused = 0.0, 0
        self.begin_anew()

    def begin_anew(self) -> None:
        """The frame of the drive is another one, in which the searches so far mean nothing."""
        self.latest, self._sought = None, self._way + _FIRST - _SPACING

    def drive(self, motion: FloatArray) -> None:
        """Note the motion (3,) of a step."""
        x, y, turn = motion.tolist()
        self._way += math.hypot(x, y) + TURN_LENGTH * abs(turn)

    @property
    def is_due(self) -> bool:
        """Whether the map is to be searched now: less often in a larger map, in which a search takes longer."""
        return self._way - self._sought >= _SPACING * math.sqrt(self.place.size)

    def wait(self) -> None:
        """Make the next search after the usual way."""
        self._sought = self._way

    def seek(
        self, rays: FloatArray, far: float = 1.0, near: Sequence[PlaceFit] = (), *, may_be_bent: bool
    ) -> Localisation | None:
        """Search the map for the place of rays (n, 7); the place if two searches in succession find the same one.

        ``far`` and ``near`` are those of :func:`localise`, and ``may_be_bent`` is that of :func:`agree`.
        """
        self.wait()
        before = self.latest
        likely = [np.zeros(3), *(fit.pose for fit in before.open)] if before is not None else [np.zeros(3)]
        self.latest = localise(self.place, rays, likely, far, near)
        self._refused += not self.latest.is_accepted
        is_found = before is not None and agree(before, self.latest, may_be_bent=may_be_bent)
        return self.latest if is_found else None

    def accept(self, fit: PlaceFit, middle: FloatArray) -> Localisation:
        """Take a place near the believed pose for that of the drive, whose middle (2,) is given."""
        self.latest = Localisation(fit, 0.0, middle, "")
        return self.latest

    @property
    def record(self) -> dict[str, Any]:
        """The latest search as it stands in ``result.json``, and how many searches did not count."""
        return {} if self.latest is None else {"refused": self._refused, "match": self.latest.record}


def other_place(place: KnownPlaces, rays: FloatArray) -> str:
    """Why rays (n, 7) in the frame of a map may also be elsewhere in it, in words; empty if they fit in one place."""
    found = localise(place, rays, [np.zeros(3)])
    if found.is_accepted and found.likeness > LARGEST_RUNNER_UP:
        return f"ambiguous: another place has {found.likeness:.0%} of the evidence"
    return found.refusal
