"""The search for the place of one robot in another robot's map, while both drive."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from limslam_agent.grid.occupancy import GridView
from limslam_agent.kernels.tables import POSE
from limslam_agent.places.history import LoggedStep
from limslam_agent.places.localisation import KnownPlaces, match_covariance
from limslam_agent.places.search import CONFIRMED, FAR_CONFIRMED, LONGEST, PlaceSearch, other_place
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.core.teammates import may_hit_others
from limslam_agent.slam.slam import LineSlam
from limslam_agent.status.known_map import DECIDED, MATCH_COVARIANCE
from limslam_agent.status.rays import STEPS, moved, rays_of
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose, inverse, transform_points
from limslam_env.interface import RobotSpec

FIRST = 15.0
"""Distance that the robots drive before the first search, m, in the mean. Small maps of one room fit into another room.
"""

_PLACED = block_diag(np.zeros((POSE, POSE)), MATCH_COVARIANCE)  # covariance of both poses
_MOST_REFUSED = 3  # places that the readings contradicted end the search


class Meeting:
    """Searches for the place of the second of two robots in the map of the first one.

    Parameters
    ----------
    robot
        Body and beams of each robot as specified.

    Attributes
    ----------
    is_open
        Whether the search goes on.
    records
        How the search ended, for ``result.json``.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._robot, self.is_open = robot, True
        self.records: list[dict[str, Any]] = []
        nothing = GridView(np.zeros(2), 1.0, np.zeros((0, 0), dtype=np.int16))
        self._search = PlaceSearch(KnownPlaces(np.zeros((0, 4)), nothing, RangeSensor(0.0)))
        self._own: tuple[list[LoggedStep], list[LoggedStep]] = ([], [])
        self._steps, self._contradicted = 0, 0
        self._driven = 0.0
        self._rays: FloatArray = np.empty((0, 7))  # those by which the place was found
        self._unconfirmed: FloatArray | None = None

    def drive(self, motions: Sequence[FloatArray]) -> None:
        """Note the motions (3,) of both robots in a step."""
        self._steps += 1
        self._driven += float(np.mean([np.hypot(*motion[:2]) for motion in motions]))
        self._search.drive(np.mean(np.abs(motions), axis=0))

    def note(self, steps: Sequence[LoggedStep]) -> None:
        """Keep a step of each robot in its own frame."""
        for kept, step in zip(self._own, steps, strict=True):
            kept.append(step)

    @property
    def is_due(self) -> bool:
        """Whether the map of the first robot is to be searched now."""
        return self.is_open and self._driven >= FIRST and self._search.is_due

    def seek(
        self, slams: Sequence[LineSlam], grids: Sequence[GridView], start: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """Search the map of the first robot for the place of the second one.

        Returns
        -------
        found
            If two searches in succession find the same place, and the readings of the first robot do not contradict the
            map of the second one there: the pose (3,) in the first map of a pose (3,) in the second map, with its
            covariance (3, 3). None otherwise.
        """
        places = [KnownPlaces(slam.segments, grid, slam.range_sensor) for slam, grid in zip(slams, grids, strict=True)]
        self._search.place, before = places[0], self._search.latest
        likely = None if before is None or before.fit is None else before.fit.pose
        rays = self._seen(1, places[1].sensor, None if likely is None else inverse(likely))
        found = self._search.seek(rays, may_be_bent=False)
        if found is None or found.fit is None:
            if self._steps >= LONGEST:
                self.end("the search took too long")
            return None
        frame = found.fit.pose
        (back,) = places[1].weigh(inverse(frame)[None], self._seen(0, places[0].sensor, frame))
        if back.is_on_map < -DECIDED or back.evidence < 0.0:
            return None
        placed, middle = compose(frame, start), transform_points(frame, found.middle[None])[0]
        drift = sum(slam.covariance for slam in slams)
        self._rays = moved(rays, frame)
        return placed, match_covariance(middle, placed) + np.diag(np.diag(drift))

    def _seen(self, number: int, sensor: RangeSensor, frame: FloatArray | None) -> FloatArray:
        """The latest rays (n, 7) of a robot in its own frame, without those that may have hit the other robot.

        ``frame`` (3,) is the likely pose of the other robot's frame; None if nothing is known of it.
        """
        own, other = (self._own[each][-STEPS:] for each in (number, 1 - number))
        if frame is None:
            return rays_of(own, self._robot, sensor)
        others, mounted = compose(frame, np.array([step.pose for step in other])), sensor.mounted(self._robot)
        reach = float(mounted.max_ranges.max()) + 2.0 * mounted.radius
        counting = list[LoggedStep]()
        for step, pose in zip(own, others, strict=True):
            if math.hypot(*(pose - step.pose)[:2]) <= reach:
                poses = np.array([step.pose, pose])
                met = may_hit_others(0, step.ranges, poses, _PLACED, mounted, sensor)
                step = replace(step, ranges=np.where(met, np.nan, step.ranges))  # noqa: PLW2901
            counting.append(step)
        return rays_of(counting, self._robot, sensor)

    def refuse(self, reason: str) -> None:
        """Take back the latest place, although it counted."""
        self._contradicted += 1
        self.records.append(self._record("match refused", reason=reason))
        self._search.begin_anew()
        if self._contradicted >= _MOST_REFUSED:
            self.end("the readings contradicted three matches")

    def has_joined(self, start: FloatArray) -> None:
        """Note that the robots are a team, and the second robot's start pose (3,) in the first map."""
        self.records.append(self._record("joined", start=start.tolist()))
        self.is_open, self._unconfirmed, self._driven = False, self._rays, 0.0

    @property
    def is_doubtful(self) -> bool:
        """Whether the robots are a team, and a part of the building that was not seen yet may look the same."""
        return self._unconfirmed is not None

    @property
    def is_to_be_confirmed(self) -> bool:
        """Whether the robots have driven far enough to search the shared map for the second robot's place again."""
        return self.is_doubtful and self._search.is_due and self._driven >= CONFIRMED

    def confirm(self, whole: KnownPlaces, *, is_complete: bool) -> str:
        """End the doubt if the shared map is complete, or much of it was seen, and has no other place that fits.

        Returns
        -------
        ambiguity
            Why the doubt remains although so much was seen, in words; empty otherwise.
        """
        self._search.wait()
        if self._unconfirmed is None or not (is_complete or self._driven >= FAR_CONFIRMED):
            return ""
        reason = other_place(whole, self._unconfirmed)
        if not reason:
            self.records.append({"event": "confirmed", "step": max(self._steps - 1, 0)})
            self._unconfirmed = None
        return reason

    def take_back(self, reason: str) -> None:
        """The robots are no team any more, and the search has ended."""
        self._unconfirmed = None
        self.end(f"joined, and taken back: {reason}")

    def end(self, reason: str) -> None:
        """End a search that found nothing."""
        self.records.append(self._record("not joined", reason=reason))
        self.is_open = False

    def _record(self, event: str, **details: Any) -> dict[str, Any]:
        return {"event": event, "step": max(self._steps - 1, 0), **details, **self._search.record}
