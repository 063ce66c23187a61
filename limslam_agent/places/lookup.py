"""The search for a robot's place in the map of an earlier run."""

import math
from typing import Any, NamedTuple

from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.places.decision import FIRST, LONGEST, SPACING, match_covariance
from limslam_agent.places.history import LoggedStep
from limslam_agent.places.localisation import KnownPlaces, Localisation, agree, localise
from limslam_agent.places.rays import moved, rays_of, wall_points
from limslam_agent.places.saved_map import SavedMap
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose, transform_points
from limslam_env.interface import RobotSpec


class Arrival(NamedTuple):
    """The place of a robot in a saved map.

    Attributes
    ----------
    frame
        Pose (3,) of the robot's frame in the saved map.
    start, covariance
        Start pose (3,) in the saved map, and its covariance (3, 3).
    rays
        The rays (n, 6) in the saved map by which it was found.
    """

    frame: FloatArray
    start: FloatArray
    covariance: FloatArray
    rays: FloatArray

    @property
    def ends(self) -> FloatArray:
        """Where these rays have met walls (m, 2), m."""
        return wall_points(self.rays)


NOT_YET_FOUND = Status("unsure", "the robot's place in the saved map is not found yet")
"""The status of a robot that maps in a frame of its own, and searches for its place in an earlier map."""


class Lookup:
    """Searches for a robot's place in a saved map, while the robot maps in a frame of its own.

    Parameters
    ----------
    saved
        The saved map.
    robot
        Body and beams.
    sensor
        How the ranges are measured, as specified.

    Attributes
    ----------
    steps
        All steps of the robot so far.
    is_open
        Whether the search goes on.
    records
        How the search ended, for ``result.json``.
    """

    def __init__(self, saved: SavedMap, robot: RobotSpec, sensor: RangeSensor) -> None:
        self.saved, self._robot = saved, robot
        self._place = KnownPlaces(saved.segments, saved.grid, sensor)
        self.steps: list[LoggedStep] = []
        self.is_open = True
        self.records: list[dict[str, Any]] = []
        self._driven, self._sought, self._refused = 0.0, FIRST - SPACING, 0
        self._latest: Localisation | None = None

    def note(self, step: LoggedStep) -> None:
        """Keep a step of the robot."""
        self.steps.append(step)
        self._driven += math.hypot(*step.motion[:2].tolist())
        if len(self.steps) > LONGEST:
            self.end(f"the search took more than {LONGEST} steps")

    @property
    def is_due(self) -> bool:
        """Whether the saved map is to be searched now."""
        return self._driven - self._sought >= SPACING * math.sqrt(self._place.size)

    def seek(self, start: FloatArray, sensor: RangeSensor) -> Arrival | None:
        """Search the saved map for the place; it is found if two searches in succession find the same place.

        ``start`` is the start pose (3,) in the robot's own frame, and ``sensor`` the sensor that is known now.
        """
        self._sought, self._place.sensor = self._driven, sensor
        rays, before = rays_of(self.steps, self._robot, sensor), self._latest
        likely = [] if before is None else [fit.pose for fit in before.open]
        decision = self._latest = localise(self._place, rays, likely)
        self._refused += not decision.is_accepted
        if before is None or decision.fit is None or not agree(before, decision, may_be_bent=True):
            return None
        frame = decision.fit.pose
        placed, middle = compose(frame, start), transform_points(frame, decision.middle[None])[0]
        self._close("found in the saved map")
        return Arrival(frame, placed, match_covariance(middle, placed), moved(rays, frame))

    def end(self, reason: str) -> None:
        """End a search that found nothing."""
        self._close("not found in the saved map", reason=reason)

    def _close(self, event: str, **details: Any) -> None:
        match = {} if self._latest is None else {"match": self._latest.record}
        self.records.append({"event": event, "step": len(self.steps) - 1, **details, "refused": self._refused, **match})
        self.is_open = False


def begin_lookup(saved: SavedMap, robot: RobotSpec, config: AgentConfig, sensor: RangeSensor, robots: int) -> Lookup:
    """The search of a number of robots for their place in a saved map.

    Raises
    ------
    ValueError
        If there is more than one robot, lost robots stay lost by the settings, or the settings have other cells.
    """
    if not config.can_recover or robots != 1:
        raise ValueError("only one robot with the preset graph or consistent can look for its place in a map")
    OccupancyGrid.of(saved.grid, config.grid)
    return Lookup(saved, robot, sensor)
