"""The search for a robot's place in the map of an earlier run."""

from typing import Any

from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.places.absence import Placement
from limslam_agent.places.localisation import KnownPlaces, PlaceSearch, match_covariance
from limslam_agent.places.saved_map import SavedMap
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.rays import Sight, moved, rays_of
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose, transform_points
from limslam_env.interface import RobotSpec

NOT_YET_FOUND = Status("unsure", "the robot's place in the saved map is not found yet")
"""The status of a robot that maps in a frame of its own, and searches for its place in an earlier map."""


class Lookup:
    """Searches for a robot's place in a saved map, while the robot maps in a frame of its own.

    Attributes
    ----------
    saved
        The saved map.
    steps
        All steps of the robot so far.
    is_open
        Whether the search goes on.
    records
        How the search ended, for ``result.json``.

    Raises
    ------
    ValueError
        If there is more than one robot, lost robots stay lost by the settings, or the settings have other cells.
    """

    def __init__(self, saved: SavedMap, robot: RobotSpec, config: AgentConfig, robots: int) -> None:
        if not config.can_recover or robots != 1:
            raise ValueError("only one robot with the preset graph or consistent can look for its place in a map")
        OccupancyGrid.of(saved.grid, config.grid)
        self.saved, self._robot = saved, robot
        self._search = PlaceSearch(KnownPlaces(saved.segments, saved.grid, RangeSensor(config.range_std)))
        self.steps: list[Sight] = []
        self.is_open = True
        self.records: list[dict[str, Any]] = []

    def note(self, step: Sight) -> None:
        """Keep a step of the robot."""
        self.steps.append(step)
        self._search.drive(step.motion)

    @property
    def is_due(self) -> bool:
        """Whether the saved map is to be searched now."""
        return self.is_open and self._search.is_due

    def seek(self, start: FloatArray, sensor: RangeSensor) -> Placement | None:
        """Search the saved map for the start; it is found if two searches in succession find the same place.

        ``start`` is the start pose (3,) in the robot's own frame, and ``sensor`` the sensor that is known now.
        """
        self._search.place.sensor = sensor
        rays = rays_of(self.steps, self._robot, sensor)
        found = self._search.seek(rays, may_be_bent=True)
        if found is None or found.fit is None:
            return None
        frame = found.fit.pose
        placed, middle = compose(frame, start), transform_points(frame, found.middle[None])[0]
        self._close("found in the saved map")
        return Placement(0, placed, match_covariance(middle, placed), moved(rays, frame))

    def end(self, reason: str) -> None:
        """End a search that found nothing."""
        self._close("not found in the saved map", reason=reason)

    def _close(self, event: str, **details: Any) -> None:
        self.records.append({"event": event, "step": len(self.steps) - 1, **details, **self._search.record})
        self.is_open = False
