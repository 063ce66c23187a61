"""The search for a robot's place in a map of others: of an earlier run, or of another robot, while
both drive.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.occupancy import GridView, OccupancyGrid
from limslam_agent.places.absence import Placement
from limslam_agent.places.localisation import (
    CONFIRMED,
    FAR_CONFIRMED,
    KnownPlaces,
    PlaceSearch,
    match_covariance,
    other_place,
)
from limslam_agent.places.saved_map import SavedMap
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.slam import Estimator
from limslam_agent.status.known_map import DECIDED, PlaceFit, drift_fit
from limslam_agent.status.rays import STEPS, Sight, ends_of, moved, numbered_rays_of, rays_of
from limslam_agent.status.status import Status
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import between, compose, inverse, transform_points
from limslam_env.interface import RobotSpec

NOT_YET_FOUND = Status("unsure", "the robot's place in the saved map is not found yet")
"""The status of a robot that maps in a frame of its own, and searches for its place in an earlier
map.
"""

FIRST = 15.0
"""Distance that the robots drive before the first search, m, in the mean. Small maps of one room
fit into another room.
"""

_BODY = 0.4  # m: what ends so near to the middle of the other robot may be its body


class Lookup:
    """Searches for a robot's place in a saved map, while the robot maps in a frame of its own.

    Attributes
    ----------
    saved, place
        The saved map, also as it is searched.
    steps
        All steps of the robot so far.
    is_open
        Whether the search goes on.
    records
        How the search ended, for ``result.json``.

    Raises
    ------
    ValueError
        If there is more than one robot, lost robots stay lost by the settings, or the settings have
        other cells.
    """

    def __init__(self, saved: SavedMap, robot: RobotSpec, config: AgentConfig, robots: int) -> None:
        if not config.can_recover or robots != 1:
            raise ValueError(
                "only one robot with the preset graph or consistent can look for its place in a map"
            )
        OccupancyGrid.of(saved.grid, config.grid)
        self.saved = saved
        self._robot = robot
        self.place = KnownPlaces(saved.segments, saved.grid, RangeSensor(config.range_std))
        self._search = PlaceSearch(self.place)
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
        """Search the saved map for the start; it is found if two searches in succession find the
        same place.

        ``start`` is the start pose (3,) in the robot's own frame, and ``sensor`` the sensor that is
        known now.
        """
        self.place.sensor = sensor
        rays = rays_of(self.steps, self._robot, sensor)
        found = self._search.seek(rays, may_be_bent=True)
        if found is None or found.fit is None:
            return None
        frame = found.fit.pose
        placed = compose(frame, start)
        middle = transform_points(frame, found.middle[None])[0]
        self._close("found in the saved map")
        return Placement(0, placed, match_covariance(middle, placed), moved(rays, frame))

    def end(self, reason: str) -> None:
        """End a search that found nothing."""
        self._close("not found in the saved map", reason=reason)

    def _close(self, event: str, **details: Any) -> None:
        self.records.append(
            {"event": event, "step": len(self.steps) - 1, **details, **self._search.record}
        )
        self.is_open = False


class _MapOfOther(KnownPlaces):
    """The map of a robot, with which the rays of the other one are compared.

    What may have hit the body of the robot itself, if the other one is at the place that is
    weighed, says nothing. ``rays`` (n, 7) are those of the other robot in its own frame, and
    ``met`` (n, 2) is where the robot was then, m.
    """

    def __init__(self, slam: Estimator, grid: GridView, rays: FloatArray, met: FloatArray) -> None:
        super().__init__(slam.segments, grid, slam.sensor)
        self.rays = rays
        self._met = met

    def weigh(self, poses: FloatArray, rays: FloatArray) -> list[PlaceFit]:
        """How well the rays (n, 7) fit the map, for poses (m, 3) of their frame."""
        return [
            KnownPlaces.weigh(self, pose[None], rays[self.is_clear(pose, rays)])[0]
            for pose in poses
        ]

    def is_clear(self, pose: FloatArray, rays: FloatArray) -> BoolArray:
        """Which of the rays (n, 7) cannot have met the body, for a pose (3,) of their frame."""
        away = transform_points(pose, ends_of(rays)) - self._met
        return np.asarray(np.hypot(*away.T) > _BODY)


class Meeting:
    """Searches for the place of the second of two robots in the map of the first one.

    Attributes
    ----------
    steps
        The steps of each robot, in its own frame.
    is_open
        Whether the place is not found, or not confirmed, and the search goes on.
    records
        How the search ended, for ``result.json``.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._robot = robot
        self.is_open = True
        self.steps: tuple[list[Sight], list[Sight]] = ([], [])
        self.records: list[dict[str, Any]] = []
        nothing = GridView(np.zeros(2), 1.0, np.zeros((0, 0), dtype=np.int16))
        self._search = PlaceSearch(KnownPlaces(np.zeros((0, 4)), nothing, RangeSensor(0.0)))
        self._driven = self._joined_at = 0.0
        # the place that was found, and by what
        self._frame = np.zeros(3)
        self._rays = np.empty((0, 7))

    def note(self, steps: Sequence[Sight]) -> None:
        """Keep a step of each robot in its own frame."""
        for kept, step in zip(self.steps, steps, strict=True):
            kept.append(step)
        motions = np.abs([step.motion for step in steps])
        self._driven += float(np.mean(np.hypot(*motions[:, :2].T)))
        self._search.drive(motions.mean(axis=0))

    @property
    def ranges(self) -> FloatArray:
        """Readings (t, 2, n_beams) of both robots, m. They are NaN where there is no new
        reading.
        """
        return np.array([[step.ranges for step in steps] for steps in self.steps]).swapaxes(0, 1)

    @property
    def is_due(self) -> bool:
        """Whether the maps are to be compared now."""
        return self.is_open and self._driven >= FIRST and self._search.is_due

    def seek(self, own_maps: Sequence[tuple[Estimator, GridView]]) -> FloatArray | None:
        """Search the map of the first robot for the place of the second one.

        Returns
        -------
        frame
            The pose (3,) of the second robot's frame in the first map, if two searches in
            succession find the same place, and the readings of neither robot contradict the map of
            the other one there. None otherwise.
        """
        maps = self._maps(own_maps)
        self._search.place = maps[0]
        found = self._search.seek(maps[0].rays, may_be_bent=False)
        if found is not None and found.fit is not None:
            frame, (first, second) = found.fit.pose, maps
            (back,) = second.weigh(inverse(frame)[None], second.rays)
            if back.is_on_map >= -DECIDED:
                self._frame = frame
                self._rays = moved(first.rays[first.is_clear(frame, first.rays)], frame)
                return frame
        return None

    def has_joined(self, start: FloatArray) -> None:
        """Note that the robots are a team, and the second robot's start pose (3,) in the first
        map.
        """
        self._joined_at = self._driven
        self.records.append(self._record("joined", start=start.tolist()))

    def objection(
        self,
        own_maps: Sequence[tuple[Estimator, GridView]],
        shared: KnownPlaces,
        *,
        is_complete: bool,
    ) -> str:
        """Why the robots are no team after all, in words; empty if nothing speaks against it.

        The place is confirmed if the shared map is complete, or the robots have driven far, and the
        readings by which the place was found fit nowhere else in the shared map. ``own_maps`` are
        empty if they say nothing of the place.
        """
        self._search.wait()
        if own_maps:
            first = self._maps(own_maps)[0]
            drift = own_maps[0][0].covariance + own_maps[1][0].covariance
            if drift_fit(first, moved(first.rays, self._frame), drift).fit.is_on_map < -DECIDED:
                return "the readings contradict the other robot's map"
        driven = self._driven - self._joined_at
        if driven < CONFIRMED or not (is_complete or driven >= FAR_CONFIRMED):
            return ""
        ambiguity = other_place(shared, self._rays)
        if not ambiguity:
            self.records.append({"event": "confirmed", "step": self._step})
            self.is_open = False
        return ambiguity if is_complete else ""

    def has_parted(self, reason: str) -> None:
        """The robots are no team any more. The search goes on."""
        self.records.append(self._record("parted", reason=reason))
        self._search.begin_anew()

    def end(self, reason: str) -> None:
        """End a search that found nothing."""
        self.records.append(self._record("not joined", reason=reason))
        self.is_open = False

    def _maps(self, own_maps: Sequence[tuple[Estimator, GridView]]) -> list[_MapOfOther]:
        """The map of each robot, with what the other one has read."""
        maps = []
        for (slam, grid), own, other in zip(own_maps, self.steps, self.steps[::-1], strict=True):
            rays, numbers = numbered_rays_of(other[-STEPS:], self._robot, slam.sensor)
            met = np.array([step.pose[:2] for step in own[-STEPS:]])[numbers]
            maps.append(_MapOfOther(slam, grid, rays, met))
        return maps

    @property
    def _step(self) -> int:
        return max(len(self.steps[0]) - 1, 0)

    def _record(self, event: str, **details: Any) -> dict[str, Any]:
        return {"event": event, "step": self._step, **details, **self._search.record}


def may_have_met(poses: FloatArray, ranges: FloatArray, robot: RobotSpec) -> BoolArray:
    """Which readings (t, 2, n_beams), m, of two robots at poses (t, 2, 3) may be of the body of the
    other one.
    """
    points = robot.beam_origins + ranges[..., None] * robot.beam_directions
    others = between(poses, poses[:, ::-1])[..., None, :2]
    return np.asarray(np.hypot(*np.moveaxis(points - others, -1, 0)) < _BODY)
