"""The search for the pose of one robot's map in another robot's map, while both grow."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from limslam_agent.places.decision import (
    CONFIRMED,
    FAR_CONFIRMED,
    FIRST,
    LARGEST_RUNNER_UP,
    LONGEST,
    SPACING,
    Decision,
    agree,
    find_place,
    match_covariance,
    runner_up,
)
from limslam_agent.places.matching import best_fits
from limslam_agent.places.place_map import PlaceMap
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose, inverse, transform_points


class Meeting:
    """Matches the maps of two robots. The map with the shorter walls is matched with the other one.

    Attributes
    ----------
    is_open
        Whether the search goes on.
    records
        How the search ended, for ``result.json``.
    """

    def __init__(self) -> None:
        self.is_open = True
        self.records: list[dict[str, Any]] = []
        self._driven, self._sought, self._steps = 0.0, FIRST - SPACING, 0
        self._refused, self._contradicted = 0, 0
        self._latest: Decision | None = None
        self._is_second_local = True
        self._unconfirmed: PlaceMap | None = None
        self._joined_at = 0.0

    def drive(self, motions: Sequence[FloatArray]) -> None:
        """Note the motions (3,) of all robots in a step."""
        self._driven += float(np.mean([np.hypot(*motion[:2]) for motion in motions]))
        self._steps += 1

    @property
    def is_due(self) -> bool:
        """Whether the maps are to be matched now."""
        return self.is_open and self._driven - self._sought >= SPACING

    def seek(
        self, first: PlaceMap, second: PlaceMap, start: FloatArray, covariances: Sequence[FloatArray]
    ) -> tuple[FloatArray, FloatArray] | None:
        """Match two maps, whose robots have poses with covariances (3, 3) in their own maps.

        Returns
        -------
        found
            If two matches in succession find the same place: the pose (3,) in the first map of a pose (3,) in the
            second map, with its covariance (3, 3). None otherwise.
        """
        self._sought = self._driven
        is_second_local = second.length <= first.length
        known, local = (first, second) if is_second_local else (second, first)
        before = self._latest if is_second_local == self._is_second_local else None
        self._is_second_local = is_second_local
        decision = self._latest = find_place(known, local)
        self._refused += not decision.is_accepted
        if before is None or decision.fit is None or not agree(before, decision, local):
            if self._steps >= LONGEST:
                self.end("the search took too long")
            return None
        middle = local.middle
        if is_second_local:
            frame, middle = decision.fit.pose, transform_points(decision.fit.pose, middle[None])[0]
        else:
            frame = inverse(decision.fit.pose)
        placed = compose(frame, start)
        drift = sum(float(np.trace(each[:2, :2])) / 2 for each in covariances), sum(float(c[2, 2]) for c in covariances)
        return placed, match_covariance(middle, placed, drift)

    def refuse(self, reason: str) -> None:
        """Take back the latest match, although it counted."""
        self._contradicted += 1
        self.records.append(self._record("match refused", reason=reason))
        self._latest = None
        if self._contradicted >= 3:
            self.end("the readings contradicted three matches")

    def has_joined(self, start: FloatArray, local: PlaceMap) -> None:
        """Note that the robots are a team, the second robot's own map, and its start pose (3,) in the first map."""
        self.records.append(self._record("joined", start=start.tolist()))
        self.is_open, self._unconfirmed, self._joined_at = False, local, self._driven

    @property
    def is_doubtful(self) -> bool:
        """Whether the robots are a team, and a part of the building that was not seen yet may look the same."""
        return self._unconfirmed is not None

    @property
    def is_to_be_confirmed(self) -> bool:
        """Whether the robots have driven far enough to compare the shared map with the second robot's map again."""
        return (
            self.is_doubtful and self._driven - self._sought >= SPACING and self._driven - self._joined_at >= CONFIRMED
        )

    def confirm(self, whole: PlaceMap, *, is_complete: bool) -> str:
        """End the doubt if the shared map is complete, or much of it was seen, and has no other place that fits.

        Returns
        -------
        ambiguity
            Why the doubt remains although so much was seen, in words; empty otherwise.
        """
        self._sought = self._driven
        is_known = is_complete or self._driven - self._joined_at >= FAR_CONFIRMED
        if self._unconfirmed is None or not is_known:
            return ""
        fits = best_fits(whole, self._unconfirmed)
        share = runner_up(fits) if fits else 0.0
        if fits and share <= LARGEST_RUNNER_UP:
            self.records.append({"event": "confirmed", "step": max(self._steps - 1, 0)})
            self._unconfirmed = None
        return (
            f"ambiguous: another place of the shared map has {share:.0%} of the score"
            if share > LARGEST_RUNNER_UP
            else ""
        )

    def take_back(self, reason: str) -> None:
        """The robots are no team any more, and the search has ended."""
        self._unconfirmed = None
        self.end(f"joined, and taken back: {reason}")

    def end(self, reason: str) -> None:
        """End a search that found nothing."""
        self.records.append(self._record("not joined", reason=reason))
        self.is_open = False

    def _record(self, event: str, **details: Any) -> dict[str, Any]:
        match = {} if self._latest is None else {"match": self._latest.record}
        return {"event": event, "step": max(self._steps - 1, 0), **details, "refused": self._refused, **match}
