"""Recovery of one robot: it is here, lost, or placed again without being sure of it.

A robot that is lost goes on in a new local frame, with a map of its own. The earlier map is kept as
it was before the first doubt about the estimate. The readings since then are compared with it again
and again, until two searches in succession find the same place. The robot then goes on there, until
its place is confirmed or refuted.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from limslam_agent.belief import Guess
from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.grid.occupancy import GridView, OccupancyGrid
from limslam_agent.places.absence import (
    LEAST_KNOWN,
    Absence,
    KnownFrame,
    Placed,
    Placement,
    StepLog,
    carried_at,
    known_before,
)
from limslam_agent.places.localisation import (
    CONFIRMED,
    FAR_CONFIRMED,
    FAR_SHARE,
    LEAD,
    KnownPlaces,
    Localisation,
    PlaceSearch,
    is_far,
    match_covariance,
    other_place,
)
from limslam_agent.places.revisions import BEGUN_ANEW, GIVEN_UP, NOT_CONFIRMED
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.slam import ConsistentEstimator
from limslam_agent.status.known_map import DECIDED, UNLIKELY, KnownMap, drift_fit, slip_fit
from limslam_agent.status.monitor import Loss, StatusMonitor
from limslam_agent.status.rays import STEPS, Sight, moved, rays_of
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose, transform_points
from limslam_env.interface import RobotSpec

# Number of steps between two copies of the estimate, number of copies that are kept, and least
# number of steps by which a copy must be older than the first doubt about the estimate.
_CHECKPOINT = 50
_CHECKPOINTS = 6
_MARGIN = 100

LONGEST_ABSENCE = 18_000
"""Number of steps after which the frame from before a doubt is given up: half an hour with steps of
0.1 s. All steps since the doubt are kept until then, since they would have to be processed again in
that frame.
"""


class Recovery:
    """Follows the estimate of one robot, and finds its place again when it is lost.

    The robot is as specified. The sensor that is passed with each call may turn its beams.

    Attributes
    ----------
    log
        The latest steps; all steps since the robot was lost, as long as it may go back to the
        earlier frame.
    absence
        What is known about a robot that is lost, or that is not yet sure of its place; None
        otherwise.
    breaks
        Steps before which the robot was carried away, in the frame that it has found again.
    slips
        Parts of the drive in which it has slipped: from where its place was known to where it was
        placed near by.
    records
        What happened, for ``result.json``.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig) -> None:
        self._robot = robot
        self._agent = config
        self.log = StepLog()
        self._copies: list[KnownFrame] = []
        self.absence: Absence | None = None
        self.breaks: list[int] = []
        self.slips: list[tuple[int, int]] = []
        self.records: list[dict[str, Any]] = []
        self._offset = np.zeros((3, 3))  # covariance of a map that was begun anew
        # since when a robot may have been carried away, and the search for where it is then
        self._doubt: tuple[int, PlaceSearch] | None = None

    @property
    def is_lost(self) -> bool:
        """Whether the robot is in a local frame."""
        return self.absence is not None and self.absence.placed is None

    @property
    def is_placed(self) -> bool:
        """Whether the robot has found its place, or begun a new map, without being sure of it
        yet.
        """
        return self.absence is not None and self.absence.placed is not None

    @property
    def may_be_wrong(self) -> bool:
        """Whether the robot is at a place that was found in the frame from which it was lost."""
        return self.is_placed and self.absence is not None and self.absence.known is not None

    @property
    def guesses(self) -> list[Guess]:
        """Where the robot may be while it is lost, by the latest search."""
        if self.absence is None or not self.is_lost or self.absence.search.latest is None:
            return []
        grid = self.absence.search.place.grid
        likely = self.absence.search.latest.open
        return [
            Guess(fit.pose, min(fit.evidence - UNLIKELY, fit.is_on_map), grid) for fit in likely
        ]

    def status(self, own: Status) -> Status:
        """The status of the robot, whose own status in its frame is given."""
        if self.absence is None:
            return own
        if self.absence.placed is None:
            return self.absence.loss.status
        if own.level != "ok":
            return own
        return Status(
            "unsure",
            NOT_CONFIRMED if self.absence.known is not None else self.absence.loss.status.reason,
        )

    @property
    def added_covariance(self) -> FloatArray:
        """What has to be added to the covariance (3, 3) of the pose; zero if the robot is not lost.

        The pose at which a new map was begun stays uncertain, and all poses in this map with it.
        """
        if self.absence is None or self.absence.placed is not None:
            return self._offset
        return self._offset + self.absence.covariance_at(self.log.steps[-1].pose)

    def note(
        self,
        step: Sight,
        slam: ConsistentEstimator,
        grid: OccupancyGrid,
        *,
        is_suspicious: bool = False,
    ) -> None:
        """Keep a step of the robot, and now and then a copy of its estimate after it.

        While the robot may have been carried away, half of the copies are kept from before.
        """
        self.log.steps.append(step)
        if self.absence is not None:
            self.absence.driven += math.hypot(*step.motion[:2].tolist())
            self.absence.search.drive(step.motion)
            if self.is_lost:
                return
        elif self._doubt is not None:
            self._doubt[1].drive(step.motion)
        if not self._copies or self.log.end % _CHECKPOINT == 0:
            young = [each for each in self._copies if each.step > self.log.end - LONGEST_ABSENCE]
            kept = young[: _CHECKPOINTS // 2] if is_suspicious else []
            later = [*young[len(kept) :], self._copy(slam, grid)]
            self._copies = [*kept, *later[len(kept) - _CHECKPOINTS :]]
            if self.absence is None:
                self.log.forget_before(self._copies[0].step)
            elif self.absence.known is None:
                self.log.forget_before(min(self._copies[0].step, self.log.end - STEPS))

    def move(self, poses: Sequence[FloatArray]) -> None:
        """A renewal has moved the latest steps to poses (3,): copies from before and searches mean
        nothing any more.
        """
        self._copies = []
        self._doubt = None
        kept = poses[max(len(poses) - len(self.log.steps), 0) :]
        self.log.move(self.log.end - len(kept), kept)
        if self.absence is not None:
            self.absence.search.latest = None

    def lose(
        self, loss: Loss, jump: float, slam: ConsistentEstimator, grid: OccupancyGrid
    ) -> Absence:
        """The robot is lost, and the odometry has jumped by a distance, m.

        A robot whose place was found and is wrong goes back to the frame as it was before, and to
        what it believed and knew when it was lost from there: what it has read at a wrong place
        says nothing of the earlier map. If it has slipped since then, its place was right.
        """
        before = self.absence
        first = max(self.log.end - 1 - loss.ago, self.log.begin + 1)
        if before is None or before.known is None or (self.is_placed and loss.known is not None):
            before = self.absence = self._lost_from(first, loss, jump, slam, grid)
        elif before.placed is not None:
            if not before.placed.has_drifted:
                self.breaks.pop()
            elif before.placed.has_slipped:
                self.slips.pop()
            first = before.since
            before.placed = None
            self.log.steps[: len(before.steps)] = before.steps
        else:
            before.is_carried |= (
                loss.is_carried
            )  # the step in which that was remains unknown if it was so
        before.first = max(first, self.log.begin + 1)
        before.search.begin_anew()
        self._copies = []
        self.note_event("lost", step=before.first, reason=loss.status.reason)
        return before

    def _lost_from(
        self, first: int, loss: Loss, jump: float, slam: ConsistentEstimator, grid: OccupancyGrid
    ) -> Absence:
        """A robot that was lost at a step, from the latest frame before it.

        If the readings have said in which step it was carried away, the map until then is good.
        """
        known = known_before(self._copies, first, 1 if loss.is_dated else _MARGIN) or self._copy(
            slam, grid
        )
        self.log.forget_before(known.step)
        jump = max(jump, known.spread) if loss.is_carried else jump
        since = max(first, self.log.begin + 1)
        search = PlaceSearch(known.places)
        steps = self.log.before(since)
        return Absence(
            loss,
            since,
            since,
            search,
            known,
            steps,
            loss.is_carried,
            jump,
            slam.covariance,
            slam.pose,
        )

    def begin_anew(self) -> bool:
        """Whether a lost robot begins a new map where it believes to be, since it cannot be found
        in its earlier map.

        This is the case if the earlier map has too few walls. The new map then takes its place.
        """
        absence = self.absence
        if absence is None or absence.known is None or absence.known.walls_m >= LEAST_KNOWN:
            return False
        self._offset = self.added_covariance
        self.note_event("begun anew", step=absence.first)
        self._believe(BEGUN_ANEW, absence.first, absence.search.place, np.empty((0, 7)))
        return True

    @property
    def is_too_long(self) -> bool:
        """Whether the frame from which the robot was lost is to be given up."""
        is_away = self.absence is not None and self.absence.known is not None
        return is_away and len(self.log.steps) > LONGEST_ABSENCE

    def stay(self) -> None:
        """Give up the frame from which the robot was lost.

        The map in which it is now takes the place of the earlier one, and the robot is unsure of it
        until nothing speaks against it.
        """
        absence = self.absence
        reason = NOT_CONFIRMED
        assert absence is not None  # noqa: S101 (the robot is away)
        if absence.placed is None:
            self._offset = self.added_covariance
            self.note_event("given up", step=absence.first)
            absence.placed = Placed(absence.driven, np.empty((0, 7)), None)
            reason = GIVEN_UP
        absence.loss = Loss(Status("unsure", reason), 0)
        absence.known = None
        absence.steps = ()

    def arrive(
        self, steps: Sequence[Sight], poses: FloatArray, place: KnownPlaces, rays: FloatArray
    ) -> None:
        """The robot's place in the map of an earlier run was found by rays (n, 7), and has to be
        confirmed.

        The poses of its steps until now are ``poses`` (m, 3) in that map.
        """
        self.log = StepLog(0, list(steps))
        self.log.move(0, poses)
        self._believe(NOT_CONFIRMED, 0, place, rays)

    def _believe(self, reason: str, first: int, place: KnownPlaces, rays: FloatArray) -> None:
        """The robot is unsure of its place since a step, and has no other frame to go back to."""
        placed = Placed(0.0, rays, None)
        self.absence = Absence(
            Loss(Status("unsure", reason), 0), first, first, PlaceSearch(place), placed=placed
        )

    def is_refuted(self, sensor: RangeSensor) -> bool:
        """Whether the readings since the robot was placed contradict the map in which it was."""
        absence = self.absence
        if absence is None or absence.placed is None or absence.placed.place is None:
            return False
        return absence.placed.place.fit_here(self._rays(absence, sensor)).is_on_map < -DECIDED

    def is_due(self) -> bool:
        """Whether the known map is to be searched now, or a place to be confirmed."""
        return self.absence is not None and self.absence.search.is_due

    def seek(self, sensor: RangeSensor) -> Placement | None:
        """Search the known map for the place. The placement if two searches in succession find the
        same place.
        """
        absence = self.absence
        assert absence is not None  # noqa: S101 (only lost robots seek)
        place = absence.search.place
        rays = self._rays(absence, sensor)
        place.sensor = sensor
        if absence.is_carried:
            found = absence.search.seek(rays, may_be_bent=False)
        else:  # it has drifted, and is near, where a search of the whole map may miss its place
            near = drift_fit(place, rays, absence.covariance).fit
            found = absence.search.seek(rays, FAR_SHARE, [near], may_be_bent=True)
        return None if found is None else self._placement(absence, rays, found, sensor)

    def seek_elsewhere(
        self, own: StatusMonitor, slam: ConsistentEstimator, grid: OccupancyGrid
    ) -> Placement | None:
        """The placement of a robot that may have been carried away, if its readings since then fit
        at another place than the believed one, and there only.

        Where the map of that time ends, readings near the believed pose decide nothing.
        """
        doubt = own.doubt
        sensor = slam.sensor
        if self.absence is not None or doubt is None or not doubt.is_carried:
            self._doubt = None
            return None
        first = self.log.end - 1 - doubt.ago
        if self._doubt is None or self._doubt[0] != first:
            known = known_before(self._copies, first, 1)
            if known is None:
                return None
            self._doubt = first, PlaceSearch(known.places)
        search = self._doubt[1]
        rays = rays_of(self.log.since(first), self._robot, sensor)
        found = search.seek(rays, may_be_bent=False) if search.is_due else None
        if found is None or found.fit is None or not is_far(found.fit.pose, found.middle):
            return None
        return self._placement(self.lose(doubt, own.jump, slam, grid), rays, found, sensor)

    def seek_near(self, known: KnownMap | None, sensor: RangeSensor) -> Placement | None:
        """The placement of a robot that may have drifted, if its readings since then fit near the
        believed pose.

        Such a robot need not go on in a local frame. If it has slipped, ``known`` is the map of
        that moment.
        """
        absence = self.absence
        assert absence is not None and absence.known is not None  # noqa: PT018, S101 (the robot was lost from a frame)
        if known is None and absence.first <= absence.known.step + 1:
            # the doubtful readings may be in that map already, and would fit there in any case
            return None
        rays = self._rays(absence, sensor)
        # Ground that the map does not have is unlikely beforehand, since nothing says that the
        # robot was carried away.
        near = (
            slip_fit(known, rays)
            if known
            else drift_fit(absence.search.place, rays, absence.covariance)
        )
        if near.evidence < LEAD or near.fit.is_on_map < 0.0:  # without rays, the evidence is 0
            return None
        middle = rays[:, :2].mean(axis=0)
        if is_far(near.fit.pose, middle):  # along a long wall, other places near by fit as well
            return None
        absence.search.latest = found = Localisation(near.fit, 0.0, middle, "")
        return self._placement(absence, rays, found, sensor)

    @property
    def may_have_drifted(self) -> bool:
        """Whether nothing says that a lost robot was carried away, and no place was found that is
        wrong.
        """
        return (
            self.absence is not None
            and not self.absence.has_returned
            and not self.absence.was_moved
        )

    def has_been_renewed(
        self, poses: Sequence[FloatArray], slam: ConsistentEstimator, grid: OccupancyGrid
    ) -> None:
        """A renewal has moved the latest steps of a lost robot to poses (3,), where its readings
        fit.

        So the robot has drifted, and was not carried away. Its place is to be confirmed. The frame
        from before the doubt is kept until then.
        """
        self.move(poses)
        renewed = KnownPlaces(slam.segments, grid.view, slam.sensor)
        self.note_event("renewed", step=self.log.end - 1)
        self._return(np.empty((0, 7)), renewed, has_drifted=True)

    def has_joined(self, placement: Placement, closed: KnownPlaces | None = None) -> None:
        """The robot goes on in the known frame. If this has closed a loop, the map of this frame is
        ``closed`` now.
        """
        has_slipped = placement.has_drifted and closed is None
        if has_slipped:
            self.slips.append(
                (max([0, *self.breaks, *(last for _, last in self.slips)]), placement.step)
            )
        elif closed is None:
            self.breaks.append(placement.step)
        self.note_event("found", step=self.log.end - 1, carried_at=placement.step)
        self._return(
            placement.rays, closed, has_drifted=placement.has_drifted, has_slipped=has_slipped
        )

    def _return(
        self,
        rays: FloatArray,
        place: KnownPlaces | None,
        *,
        has_drifted: bool,
        has_slipped: bool = False,
    ) -> None:
        absence = self.absence
        assert absence is not None  # noqa: S101 (the robot was lost)
        absence.search.wait()
        absence.placed = Placed(
            absence.driven, rays, place or absence.search.place, has_drifted, has_slipped
        )
        absence.has_returned = True

    def still_fits(self, own: StatusMonitor, sensor: RangeSensor) -> bool:
        """Whether all readings of a robot that has drifted still fit, although its monitor says
        that it is lost.

        The monitor judges by a few readings what the search for a place judges by hundreds. Both
        have to agree, or the robot would be lost and found in turns.
        """
        placed = None if self.absence is None else self.absence.placed
        if self.absence is None or placed is None or not placed.has_drifted or own.loss is None:
            return False
        if own.loss.is_carried or own.jump > 0.0 or self.is_refuted(sensor):
            return False
        # The distance without contradictions begins again.
        self.absence.placed = placed._replace(at=self.absence.driven)
        return True

    def confirm(self, own: Status, slam: ConsistentEstimator, grid: GridView) -> None:
        """End an absence if nothing speaks against the place any more."""
        absence = self.absence
        assert absence is not None and absence.placed is not None  # noqa: PT018, S101 (a place is to be confirmed)
        absence.search.wait()
        driven = absence.driven - absence.placed.at
        if own.level != "ok" or driven < CONFIRMED:
            return
        if not absence.placed.has_drifted:
            if (
                driven < FAR_CONFIRMED
                and frontier_cells(grid, self._agent.policy.min_frontier).any()
            ):
                return
            rays = self._rays(absence, slam.sensor)
            if other_place(KnownPlaces(slam.segments, grid, slam.sensor), rays):
                return
        self.note_event("confirmed", step=self.log.end - 1)
        self.absence = None

    def _rays(self, absence: Absence, sensor: RangeSensor) -> FloatArray:
        """The rays (n, 7) of a robot since it was lost, after those by which it was placed."""
        rays = rays_of(self.log.since(absence.first), self._robot, sensor)
        return rays if absence.placed is None else np.concatenate((absence.placed.rays, rays))

    def _copy(self, slam: ConsistentEstimator, grid: OccupancyGrid) -> KnownFrame:
        return KnownFrame(self.log.end, slam.copied(), grid.copied())

    def _placement(
        self, absence: Absence, rays: FloatArray, found: Localisation, sensor: RangeSensor
    ) -> Placement:
        """Where the robot was before it was carried away."""
        assert found.fit is not None  # noqa: S101 (a place was found)
        log = self.log
        frame = found.fit.pose
        known = absence.known
        last = max(absence.first - 1, log.begin)
        # A robot that was lost in its local frame, too, was carried away before it was lost for the
        # first time.
        placed = log.driven_back(compose(frame, log[last].pose), last + 1)[
            : max(absence.since - log.begin, 1)
        ]
        step = log.begin + len(placed)
        if not absence.loss.is_dated:
            step = carried_at(log, placed, self._robot, sensor, absence.search.place)
        pose = placed[step - 1 - log.begin]
        covariance = match_covariance(transform_points(frame, found.middle[None])[0], pose)
        placed_rays = moved(rays, frame)
        has_drifted = not is_far(frame, found.middle)
        if not has_drifted and not absence.was_moved and known is not None:
            has_drifted = known.explains(frame, covariance, placed_rays)
        return Placement(step, pose, covariance, placed_rays, has_drifted)

    def note_event(self, event: str, **details: Any) -> None:
        """Add a record of what happened, with how the latest search stands."""
        record = {} if self.absence is None else self.absence.search.record
        if event == "lost":
            record.pop("match", None)
        self.records.append({"event": event, **details, **record})
