"""The search for a robot's place in a map of others: of an earlier run, or of another robot, while
both drive.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.occupancy import GridView, OccupancyGrid
from limslam_agent.places.localisation import (
    CONFIRMED,
    FAR_CONFIRMED,
    KnownPlaces,
    PlaceSearch,
    match_covariance,
    other_place,
)
from limslam_agent.places.lost import Placement
from limslam_agent.places.revisions import Event
from limslam_agent.places.saved_map import SavedMap
from limslam_agent.record import Drive
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.slam import Estimator
from limslam_agent.status.known_map import DECIDED, PlaceFit, drift_fit
from limslam_agent.status.rays import STEPS, ends_of, moved, numbered_rays_of, rays_of
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
    is_open
        Whether the search goes on.
    events
        How the search ended.

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
        self._step = -1
        self.is_open = True
        self.events: tuple[Event, ...] = ()

    def drive(self, motion: FloatArray) -> None:
        """Note the motion (3,) of a step."""
        self._step += 1
        self._search.drive(motion)

    @property
    def is_due(self) -> bool:
        """Whether the saved map is to be searched now."""
        return self.is_open and self._search.is_due

    def seek(self, drive: Drive, start: FloatArray, sensor: RangeSensor) -> Placement | None:
        """Search the saved map for the start; it is found if two searches in succession find the
        same place.

        ``drive`` are all steps of the robot in its own frame, which began at the pose ``start``
        (3,), and ``sensor`` is the sensor that is known now.
        """
        self.place.sensor = sensor
        rays = rays_of(drive.scans, self._robot, sensor)
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
        record = {"event": event, "step": self._step, **details, **self._search.record}
        self.events += (Event(record),)
        self.is_open = False


class OwnMap(NamedTuple):
    """The map and the drive of a robot in its own frame."""

    slam: Estimator
    grid: GridView
    drive: Drive


class _MapOfOther(KnownPlaces):
    """The map of a robot, with which the rays of the other one are compared.

    What may have hit the body of the robot itself, if the other one is at the place that is
    weighed, says nothing. ``rays`` (n, 7) are those of the other robot in its own frame.
    """

    def __init__(self, own: OwnMap, other: OwnMap, robot: RobotSpec) -> None:
        super().__init__(own.slam.segments, own.grid, own.slam.sensor)
        steps = other.drive.scans[-STEPS:]
        self.rays, numbers = numbered_rays_of(steps, robot, own.slam.sensor)
        # where this robot was then (n, 2), m
        self._met = np.array([scan.pose[:2] for scan in own.drive.scans[-STEPS:]])[numbers]

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
    is_open
        Whether the place is not found, or not confirmed, and the search goes on.
    events
        How the search ended.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._robot = robot
        self.is_open = True
        self.events: tuple[Event, ...] = ()
        nothing = GridView(np.zeros(2), 1.0, np.zeros((0, 0), dtype=np.int16))
        self._search = PlaceSearch(KnownPlaces(np.zeros((0, 4)), nothing, RangeSensor(0.0)))
        self._step = -1
        self._driven = self._joined_at = 0.0
        # the place that was found, and by what
        self._frame = np.zeros(3)
        self._rays = np.empty((0, 7))

    def drive(self, motions: FloatArray) -> None:
        """Note the motions (2, 3) of a step."""
        self._step += 1
        motions = np.abs(motions)
        self._driven += float(np.mean(np.hypot(*motions[:, :2].T)))
        self._search.drive(motions.mean(axis=0))

    @property
    def is_due(self) -> bool:
        """Whether the maps are to be compared now."""
        return self.is_open and self._driven >= FIRST and self._search.is_due

    def seek(self, own: Sequence[OwnMap]) -> FloatArray | None:
        """Search the map of the first robot for the place of the second one.

        Returns
        -------
        frame
            The pose (3,) of the second robot's frame in the first map, if two searches in
            succession find the same place, and the readings of neither robot contradict the map of
            the other one there. None otherwise.
        """
        first = _MapOfOther(own[0], own[1], self._robot)
        self._search.place = first
        found = self._search.seek(first.rays, may_be_bent=False)
        if found is None or found.fit is None:
            return None
        frame = found.fit.pose
        second = _MapOfOther(own[1], own[0], self._robot)
        (back,) = second.weigh(inverse(frame)[None], second.rays)
        if back.log_ratio_on_map < -DECIDED:
            return None
        self._frame = frame
        self._rays = moved(first.rays[first.is_clear(frame, first.rays)], frame)
        return frame

    def has_joined(self, start: FloatArray) -> None:
        """Note that the robots are a team, and the second robot's start pose (3,) in the first
        map.
        """
        self._joined_at = self._driven
        self._tell("joined", start=start.tolist())

    def objection(self, own: Sequence[OwnMap], shared: KnownPlaces, *, is_complete: bool) -> str:
        """Why the robots are no team after all, in words; empty if nothing speaks against it.

        The place is confirmed if the shared map is complete, or the robots have driven far, and the
        readings by which the place was found fit nowhere else in the shared map. ``own`` is empty
        if the own maps say nothing of the place.
        """
        self._search.wait()
        if own:
            first = _MapOfOther(own[0], own[1], self._robot)
            drift = own[0].slam.covariance + own[1].slam.covariance
            if (
                drift_fit(first, moved(first.rays, self._frame), drift).fit.log_ratio_on_map
                < -DECIDED
            ):
                return "the readings contradict the other robot's map"
        driven = self._driven - self._joined_at
        if driven < CONFIRMED or not (is_complete or driven >= FAR_CONFIRMED):
            return ""
        ambiguity = other_place(shared, self._rays)
        if not ambiguity:
            self.events += (Event({"event": "confirmed", "step": self._step}),)
            self.is_open = False
        return ambiguity if is_complete else ""

    def has_parted(self, reason: str) -> None:
        """The robots are no team any more. The search goes on."""
        self._tell("parted", reason=reason)
        self._search.begin_anew()

    def end(self, reason: str) -> None:
        """End a search that found nothing."""
        self._tell("not joined", reason=reason)
        self.is_open = False

    def _tell(self, event: str, **details: Any) -> None:
        step = max(self._step, 0)
        self.events += (Event({"event": event, "step": step, **details, **self._search.record}),)


def may_have_met(poses: FloatArray, ranges: FloatArray, robot: RobotSpec) -> BoolArray:
    """Which readings (t, 2, n_beams), m, of two robots at poses (t, 2, 3) may be of the body of the
    other one.
    """
    points = robot.beam_origins + ranges[..., None] * robot.beam_directions
    others = between(poses, poses[:, ::-1])[..., None, :2]
    return np.asarray(np.hypot(*np.moveaxis(points - others, -1, 0)) < _BODY)
