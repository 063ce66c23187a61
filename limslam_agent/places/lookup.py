"""The search for a robot's place in the map of an earlier run."""

import math
from typing import Any

from limslam_agent.config.places import PlaceConfig
from limslam_agent.grid.occupancy import GridView
from limslam_agent.places.decision import Decision, agree, find_place, placed_covariance
from limslam_agent.places.history import LoggedStep
from limslam_agent.places.place_map import place_map
from limslam_agent.places.saved_map import SavedMap
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose

NOT_YET_FOUND = Status("unsure", "the robot's place in the saved map is not found yet")
"""The status of a robot that maps in a frame of its own, and searches for its place in an earlier map."""


class Lookup:
    """Searches for a robot's place in a saved map, while the robot maps in a frame of its own.

    Parameters
    ----------
    saved
        The saved map.
    config
        Settings of the search.

    Attributes
    ----------
    steps
        All steps of the robot so far.
    is_open
        Whether the search goes on.
    records
        How the search ended, for ``result.json``.
    """

    def __init__(self, saved: SavedMap, config: PlaceConfig) -> None:
        self.saved, self._config = saved, config
        self._place = place_map(saved.segments, saved.grid)
        self.steps: list[LoggedStep] = []
        self.is_open = True
        self.records: list[dict[str, Any]] = []
        self._driven, self._sought, self._refused = 0.0, config.first - config.spacing, 0
        self._latest: Decision | None = None

    def note(self, step: LoggedStep) -> None:
        """Keep a step of the robot."""
        self.steps.append(step)
        self._driven += math.hypot(*step.motion[:2].tolist())
        if len(self.steps) > self._config.longest:
            self.end(f"the search took more than {self._config.longest} steps")

    @property
    def is_due(self) -> bool:
        """Whether the robot's map is to be matched now."""
        return self._driven - self._sought >= self._config.spacing

    def seek(
        self, start: FloatArray, segments: FloatArray, grid: GridView
    ) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Match the robot's map with the saved map.

        Returns
        -------
        found
            If two matches in succession find the same place: the pose (3,) of the robot's frame in the saved map, and
            the pose (3,) there of the start pose (3,), with its covariance (3, 3). None otherwise.
        """
        self._sought = self._driven
        local, before = place_map(segments, grid), self._latest
        decision = self._latest = find_place(self._place, local, self._config)
        self._refused += not decision.is_accepted
        if before is None or decision.fit is None or not agree(before, decision, local, self._config):
            return None
        placed = compose(decision.fit.pose, start)
        self._close("found in the saved map")
        return decision.fit.pose, placed, placed_covariance(local, decision, placed, self._config)

    def end(self, reason: str) -> None:
        """End a search that found nothing."""
        self._close("not found in the saved map", reason=reason)

    def _close(self, event: str, **details: Any) -> None:
        match = {} if self._latest is None else {"match": self._latest.record}
        self.records.append({"event": event, "step": len(self.steps) - 1, **details, "refused": self._refused, **match})
        self.is_open = False
