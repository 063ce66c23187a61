"""Recovery of one robot that is lost: copies of its earlier estimate, its steps since then, and the search for its
place.

A robot that is lost goes on in a new local frame, with a map of its own. The earlier map is kept as it was before the
first doubt about the estimate. The readings since then are compared with it again and again, until two searches in
succession find the same place.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from limslam_agent.belief import Guess
from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.grid.occupancy import GridView, OccupancyGrid
from limslam_agent.places.absence import LEAST_KNOWN, Absence, KnownFrame, Placement, known_before
from limslam_agent.places.decision import (
    CONFIRMED,
    FAR_CONFIRMED,
    LARGEST_RUNNER_UP,
    LONGEST,
    SPACING,
    match_covariance,
)
from limslam_agent.places.history import LoggedStep, StepLog, carried_at
from limslam_agent.places.kidnapping import SUSPECTED, Doubt, Kidnapping
from limslam_agent.places.localisation import (
    DRIFT,
    FAR,
    FAR_SHARE,
    LEAD,
    ON_MAP,
    KnownPlaces,
    Localisation,
    NearFit,
    PlaceFit,
    agree,
    is_far,
    localise,
    near_fit,
)
from limslam_agent.places.matching import APART
from limslam_agent.places.rays import moved, rays_of
from limslam_agent.places.revisions import BEGUN_ANEW, NOT_CONFIRMED
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.slam import LineSlam
from limslam_agent.status.monitor import StatusMonitor, covariance_of_lost
from limslam_agent.status.status import Status
from limslam_agent.status.sudden_changes import CLEAR
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import between, compose, compose_jacobians, transform_points
from limslam_env.interface import RobotSpec

_LOCAL_COPIES = 6
"""Number of copies of the local frame over the steps that are kept."""
WRONG_PLACE = Status("lost", "the readings contradict the map at the place that was found")
_LOST_FIRST, _LOST_SPACING = 0.8, 0.35  # m: way to the first search of a lost robot, and between two of them
_TURN_LENGTH = 0.1  # m of this way: a turn by one radian
_RECHECK = 0.3  # m: way after which the readings since a sudden change are weighed again
# Number of steps between two copies of the estimate, number of copies that are kept, and least number of steps by which
# a copy must be older than the first doubt about the estimate.
_CHECKPOINT, _CHECKPOINTS, _MARGIN = 50, 6, 100
_WATCHED = 300  # number of steps after a sudden change in which it is weighed


class _Loss(NamedTuple):
    """Why a robot is lost and since when, whether that step is certain, and whether the robot was carried away.

    ``has_fitted`` is that of :class:`Doubt`.
    """

    status: Status
    first: int
    is_dated: bool
    is_carried: bool
    has_fitted: bool = False


class Recovery:
    """Follows the estimate of one robot, and finds its place again when it is lost.

    Parameters
    ----------
    robot, config
        Body and beams as specified, and settings. The sensor that is passed with each call may turn the beams.

    Attributes
    ----------
    log
        The latest steps.
    absence
        What is known about a robot that is lost, or that is not yet sure of its place; None otherwise.
    breaks
        Steps before which the robot was carried away, in the frame that it has found again.
    losses
        Steps before which the robot was lost, since the odometry has jumped the last time.
    records
        What happened, for ``result.json``.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig) -> None:
        self._robot, self._agent = robot, config
        self.log = StepLog()
        self._copies: list[KnownFrame] = []
        self._local_copies: list[KnownFrame] = []
        self.absence: Absence | None = None
        self.breaks: list[int] = []
        self.losses: list[int] = []
        self.records: list[dict[str, Any]] = []
        self._arrival: Absence | None = None
        self._rechecked, self._kidnapping = 0.0, Kidnapping(robot)
        self._doubt: Doubt | None = None
        self._offset = np.zeros((3, 3))  # covariance of a map that was begun anew

    @property
    def is_lost(self) -> bool:
        """Whether the robot is in a local frame."""
        return self.absence is not None and not self.absence.is_placed

    @property
    def is_placed(self) -> bool:
        """Whether the robot has found its place in the frame that it was lost from, without being sure of it yet."""
        return self.absence is not None and self.absence.is_placed

    @property
    def guesses(self) -> list[Guess]:
        """Where the robot may be while it is lost, by the latest search."""
        absence = self.absence
        if absence is None or absence.is_placed or absence.place is None or not absence.decisions:
            return []
        return [Guess(fit.pose, fit.log_odds, absence.place.grid) for fit in absence.decisions[-1].open]

    def status(self, own: Status) -> Status:
        """The status of the robot, whose own status in its frame is given."""
        found = self.absence or self._arrival
        if found is None:
            return own if own.level != "ok" or self._doubt is None else self._doubt.status
        if not found.is_placed:
            return Status("lost", found.reason)
        if own.level != "ok":
            return own
        return Status("unsure", found.reason if found is self._arrival and found.reason else NOT_CONFIRMED)

    @property
    def added_covariance(self) -> FloatArray:
        """What has to be added to the covariance (3, 3) of the pose; zero if the robot is not lost.

        The pose at which the robot was lost stays as uncertain as it was in the earlier frame. An error of its heading
        moves the poses that are far from there. The pose at which a new map was begun stays uncertain, too, and all
        poses in this map with it.
        """
        if self.absence is None or self.absence.is_placed:
            return self._offset
        absence = self.absence
        since = covariance_of_lost(absence.jump, absence.driven, knows_heading=not absence.is_carried)
        by_left, _ = compose_jacobians(absence.left, between(absence.left, self.log.steps[-1].pose))
        return self._offset + by_left @ absence.covariance @ by_left.T + since

    def note(self, step: LoggedStep, slam: LineSlam, grid: OccupancyGrid) -> None:
        """Keep a step of the robot, and now and then a copy of its estimate after it."""
        self.log.steps.append(step)
        self._rechecked += math.hypot(*step.motion[:2].tolist())
        absence = self.absence or self._arrival
        if absence is not None:
            x, y, turn = step.motion.tolist()
            absence.driven += math.hypot(x, y)
            absence.moved += math.hypot(x, y) + _TURN_LENGTH * abs(turn)
        if self.absence is not None:
            begin = self.log.begin
            gone = self.log.forget_before(self.log.end - LONGEST)
            self.absence.gone += [step.pose for step in gone[max(self.absence.first - begin, 0) :]]
            if self.is_lost and self.log.end % (LONGEST // _LOCAL_COPIES) == 0:
                kept = [copy for copy in self._local_copies if copy.step > self.log.begin]
                self._local_copies = [*kept, self._copy(slam, grid)]
            return
        if not self._copies or self.log.end % _CHECKPOINT == 0:
            self._copies = self._kept([*self._copies, self._copy(slam, grid)])
            self.log.forget_before(self._copies[0].step)

    def _kept(self, copies: list[KnownFrame]) -> list[KnownFrame]:
        """The latest copies, and the latest one from before a change of the readings that is still doubtful."""
        latest, held = copies[-_CHECKPOINTS:], self._kidnapping.held
        before = [] if held is None else [copy for copy in copies if copy.step < held][-1:]
        return latest if not before or before[0] in latest else [*before, *latest]

    def move(self, poses: Sequence[FloatArray]) -> None:
        """A renewal has moved the latest steps to poses (3,): copies from before and searches mean nothing any more."""
        self._copies, self._local_copies = [], []
        self._kidnapping.forget()
        for back, pose in zip(range(1, len(self.log.steps) + 1), reversed(poses), strict=False):
            self.log.steps[-back] = replace(self.log.steps[-back], pose=pose)
        if self.absence is not None:
            self.absence.decisions.clear()

    def lose(self, own: StatusMonitor, slam: LineSlam, grid: OccupancyGrid) -> None:
        """The robot is lost: its monitor says so, or :meth:`is_elsewhere`.

        A robot that had found its place without being sure of it goes back to the frame as it was before, and to what
        it believed and knew when it was lost from there: what it has read at a wrong place says nothing of the earlier
        map. A robot that had only drifted near by keeps its place, or it would be found there and lost in turns. If
        the readings have said in which step the robot was carried away, the map until then is good.
        """
        status, first, is_dated, is_carried, has_fitted = self._first_doubt(own, slam)
        jump = math.sqrt(own.added_covariance[0, 0])
        before, self._arrival = self.absence, None
        if before is None:
            known = known_before(self._copies, first, 1 if is_dated else _MARGIN) or self._copy(slam, grid)
            self.absence = Absence(
                known, first, status.reason, jump, known.places, slam.covariance, slam.pose,
                has_fitted=has_fitted and jump == 0.0,
            )  # fmt: skip
            self.losses.append(known.step)
            self.log.forget_before(known.step)
            self.absence.believed = self.log[max(first - 1, self.log.begin)].pose
            if is_carried:
                # It may be anywhere in its map: the standard deviation of a uniform distribution.
                self.absence.jump = max(
                    jump, max(known.grid.view.values.shape) * known.grid.view.cell / math.sqrt(12.0)
                )
        else:
            if before.is_placed and (before.is_far or not before.has_drifted):
                if not before.has_drifted:
                    self.breaks.pop()
                first, is_dated, is_carried = before.since, before.is_dated, before.is_carried
                before.is_astray = first <= self.log.begin  # the steps at which it was lost are no longer kept
                if not before.is_astray:
                    self.log.put_before(first, before.believed)
            self.absence = replace(
                before, first=first, placed=None, rays=None, gone=[], has_drifted=False, renewed=None, decisions=[]
            )
        if own.jump > 0.0:
            self.losses.clear()
        self.absence.first = max(self.absence.first, self.log.begin + 1)
        self.absence.is_dated, self.absence.is_carried = is_dated, is_carried or self.absence.is_astray
        self.absence.sought = self.absence.moved + _LOST_FIRST - _LOST_SPACING
        self._copies, self._local_copies = [], []
        self._kidnapping.forget()
        self._note_event("lost", step=self.absence.first, reason=status.reason)

    def begin_anew(self) -> bool:
        """Whether a lost robot begins a new map where it believes to be, since it cannot be found in its earlier map.

        This is the case if the earlier map has too few walls. The new map then takes its place.
        """
        absence = self.absence
        if absence is None or absence.known is None or absence.known.walls_m >= LEAST_KNOWN:
            return False
        self._offset = self.added_covariance
        self._note_event("begun anew", step=absence.first)
        rays: FloatArray = np.empty((0, 6))
        self.absence, self._arrival = None, Absence(None, absence.first, BEGUN_ANEW, 0.0, None, placed=0.0, rays=rays)
        return True

    def is_elsewhere(self, own: StatusMonitor, slam: LineSlam) -> bool:
        """Whether the readings since a sudden change say that the robot was carried away, or that its place is wrong.

        A robot may be carried to a place that looks at first like the one before. If it then draws its own walls, no
        reading contradicts its present map. The readings are therefore compared with the map of that time.
        """
        if self._rechecked < _RECHECK:
            return False
        driven, self._rechecked = self._rechecked, 0.0
        if self.absence is not None:
            return self.is_placed and self._is_refuted(self.absence, slam.range_sensor)
        self._doubt = self._weigh(own, slam, driven)
        return self._doubt is not None and self._doubt.status.level == "lost"

    def _weigh(self, own: StatusMonitor, slam: LineSlam, driven: float = 0.0) -> Doubt | None:
        """The likeliest moment at which the robot was carried away."""
        last = self.log.end - 1
        changes = [(last - ago, each) for ago, each in own.changes(_WATCHED) if last - ago > self.log.begin]
        is_doubtful = bool(changes) or self._kidnapping.held is not None
        if is_doubtful and self.log.largest_correction > APART:  # a closed loop moves robot and map alike
            changes = []
            self._kidnapping.forget()
        return self._kidnapping.doubt(changes, self.log, slam.covariance, slam.range_sensor, driven)

    def _first_doubt(self, own: StatusMonitor, slam: LineSlam) -> _Loss:
        """Why the robot is lost, and since when."""
        is_own, was_carried = own.status.level == "lost", self.absence is not None and self.absence.is_carried
        if self.absence is not None and not is_own:
            return _Loss(WRONG_PLACE, self.absence.first, self.absence.is_dated, was_carried)
        change = own.carried if is_own else None
        first, is_dated = self.log.end - 1 - own.doubted, change is not None
        kept = max(first, self.log.begin)
        # What contradicts the map now has also spoken for an earlier change. Walls of a bent map do so where the robot
        # has drifted, and hardly a reading has changed.
        is_weak = change is not None and change.change < CLEAR
        if change is not None and (is_weak or self._kidnapping.is_refuted(kept, change, self.log, slam.range_sensor)):
            first, is_dated = self.log.end - 1 - own.contradicted, False
            change = None if is_weak else change
        if is_own and not is_dated and self.absence is None:
            self._doubt = self._weigh(own, slam)
        doubt, self._doubt = self._doubt, None
        if is_own and (doubt is None or doubt.evidence < SUSPECTED or is_dated):
            return _Loss(own.status, first, is_dated, change is not None or was_carried)
        assert doubt is not None  # noqa: S101 (the monitor or a doubt says that the robot is lost)
        status = own.status if is_own else doubt.status
        return _Loss(status, doubt.step, doubt.is_dated, is_carried=True, has_fitted=doubt.has_fitted)

    def _is_refuted(self, absence: Absence, sensor: RangeSensor) -> bool:
        """Whether the readings since the robot was placed contradict the map in which it was."""
        if absence.place is None or absence.rays is None:
            return False
        place = absence.renewed or absence.place
        if absence.is_unlikely and self._later_fit(absence, absence.place, sensor).is_on_map < -ON_MAP:
            return True
        rays = np.concatenate((absence.rays, rays_of(self.log.since(absence.first), self._robot, sensor)))
        (fit,) = place.weigh(np.zeros((1, 3)), rays)
        return fit.is_on_map < -ON_MAP

    def _later_fit(self, absence: Absence, place: KnownPlaces, sensor: RangeSensor) -> PlaceFit:
        """How well the readings since the robot found its place fit the map in which it was."""
        rays = rays_of(self.log.since(absence.returned), self._robot, sensor)
        return place.weigh(np.zeros((1, 3)), rays)[0]

    def is_due(self) -> bool:
        """Whether the known map is to be searched now, or a place to be confirmed.

        A search takes longer in a larger map, and searches are farther apart there.
        """
        absence = self.absence or self._arrival
        if absence is None:
            return False
        spacing = _LOST_SPACING if self.is_lost else SPACING
        size = 1.0 if absence.place is None else absence.place.size
        return absence.moved - absence.sought >= spacing * math.sqrt(size)

    def seek(self, sensor: RangeSensor) -> Placement | None:
        """Search the known map for the place. The placement if two searches in succession find the same place."""
        absence = self.absence
        assert absence is not None  # noqa: S101 (only lost robots seek)
        assert absence.place is not None  # noqa: S101 (it was lost from a frame)
        absence.sought = absence.moved
        absence.place.sensor = sensor
        rays = rays_of(self.log.since(absence.first), self._robot, sensor)
        earlier = absence.decisions[-1:]
        likely = [np.zeros(3), *(fit.pose for found in earlier for fit in found.open)]
        # A robot that was not carried away has drifted, and is near. If its readings fit near the believed pose,
        # nothing says any more that it was carried away: a robot that has drifted may also read sudden changes, and in
        # a large building, some other place fits nearly always.
        near = near_fit(absence.place, rays, absence.covariance)
        is_far_likely = absence.is_carried and not self._fits_near(near, rays, ON_MAP)
        far = 1.0 if is_far_likely else FAR_SHARE
        # A search of the whole map may miss the place near by.
        decision = localise(absence.place, rays, likely, far, [near.fit])
        absence.decisions.append(decision)
        if not earlier or not agree(earlier[-1], decision, may_be_bent=not is_far_likely):
            return None
        return self._placement(absence, rays, decision, sensor)

    def _fits_near(self, near: NearFit, rays: FloatArray, on_map: float) -> bool:
        """Whether rays (n, 6) fit the map at their likeliest place near the believed pose.

        Along a long wall, other places near by fit as well. So the covariance of the pose counts, too. ``on_map`` is
        the least logarithm of the likelihood ratio of the contradictions there.
        """
        fits = near.evidence >= LEAD and near.fit.is_on_map >= on_map  # without rays, they do not
        return fits and not is_far(near.fit.pose, rays[:, :2].mean(axis=0))

    def seek_near(self, sensor: RangeSensor) -> Placement | None:
        """The placement of a robot that was just lost, if its readings since then fit the map near the believed pose.

        Such a robot has drifted, and need not go on in a local frame. If something says that it was carried away, or if
        a place was found before and is wrong, the robot has to be sought.
        """
        absence = self.absence
        if absence is None or absence.place is None or absence.was_moved or absence.returned:
            return None
        if absence.known is not None and absence.first <= absence.known.step + 1:
            return None  # the doubtful readings may be in that map already, and would fit there in any case
        rays = rays_of(self.log.since(absence.first), self._robot, sensor)
        # Ground that the map does not have is unlikely beforehand, since nothing says that the robot was carried away.
        near = near_fit(absence.place, rays, absence.covariance)
        if not self._fits_near(near, rays, 0.0):
            return None
        found = Localisation(near.fit, 0.0, rays[:, :2].mean(axis=0), "")
        absence.decisions.append(found)
        return self._placement(absence, rays, found, sensor)

    @property
    def may_be_renewed(self) -> bool:
        """Whether a robot that was just lost may find its place by a renewal.

        Nothing says then that it was carried away, or its readings have clearly fitted since it may have been.
        """
        absence = self.absence
        return absence is not None and not absence.returned and (absence.has_fitted or not absence.was_moved)

    def has_been_renewed(self, poses: Sequence[FloatArray], slam: LineSlam, grid: OccupancyGrid) -> None:
        """A renewal has moved the latest steps of a lost robot to poses (3,), where its readings fit.

        So the robot has drifted, and was not carried away. Its place is to be confirmed. The frame from before the
        doubt is kept until then.
        """
        absence = self.absence
        assert absence is not None  # noqa: S101 (only lost robots are renewed)
        self.move(poses)
        absence.placed, absence.sought, absence.returned = absence.driven, absence.moved, self.log.end
        absence.rays, absence.has_drifted = np.empty((0, 6)), True
        absence.is_carried, absence.jump = False, 0.0
        absence.renewed = KnownPlaces(slam.segments, grid.view, slam.range_sensor)
        self._note_event("renewed", step=self.log.end - 1)

    def still_fits(self, own: StatusMonitor, sensor: RangeSensor) -> bool:
        """Whether all readings of a robot that has drifted still fit, although its monitor says that it is lost.

        The monitor judges by a few readings what the search for a place judges by hundreds. Both have to agree, or the
        robot would be lost and found in turns.
        """
        absence = self.absence
        if absence is None or not absence.has_drifted or own.carried is not None or own.jump > 0.0:
            return False
        if self._is_refuted(absence, sensor):
            return False
        absence.placed = absence.driven  # the distance without contradictions begins again
        return True

    def has_joined(self, placement: Placement, closed: KnownPlaces | None = None) -> None:
        """The robot goes on in the known frame. If this has closed a loop, the map of this frame is ``closed`` now."""
        assert self.absence is not None  # noqa: S101
        self.absence.placed, self.absence.sought = self.absence.driven, self.absence.moved
        self.absence.rays, self.absence.returned, self.absence.renewed = placement.rays, self.log.end, closed
        found = self.absence.decisions[-1]
        self.absence.is_far = found.fit is not None and is_far(found.fit.pose, found.middle)
        self.absence.has_drifted = placement.has_drifted
        if not placement.has_drifted:
            self.breaks.append(placement.carried_at)
        self._note_event("found", step=self.log.end - 1, carried_at=placement.carried_at)

    def arrive(self, rays: FloatArray) -> None:
        """The robot's place in the map of an earlier run was found by rays (n, 6), and has to be confirmed."""
        self._arrival = Absence(None, 0, "", 0.0, None, placed=0.0, rays=rays)

    def confirm(self, own: Status, slam: LineSlam, grid: GridView) -> None:
        """End an absence if nothing speaks against the place any more.

        If the place is unlikely, the readings since then must also fit the walls of the map from before, and not only
        those that the robot has drawn since then. They must have as much evidence as a far place needs.
        """
        absence = self.absence or self._arrival
        assert absence is not None  # noqa: S101 (a place is to be confirmed)
        absence.sought = absence.moved
        driven = absence.driven - (absence.placed or 0.0)
        is_closed = driven >= FAR_CONFIRMED or not frontier_cells(grid, self._agent.policy.min_frontier).any()
        if own.level != "ok" or driven < CONFIRMED or not (is_closed or absence.has_drifted):
            return
        if absence.has_drifted:
            self._end_absence()
            return
        if absence.is_unlikely and absence.place is not None:
            fit = self._later_fit(absence, absence.place, slam.range_sensor)
            if fit.evidence * FAR_SHARE < LEAD or fit.is_on_map < ON_MAP:
                return
        assert absence.rays is not None  # noqa: S101 (the robot has found its place)
        rays = rays_of(self.log.since(absence.first), self._robot, slam.range_sensor)
        rays = np.concatenate((absence.rays, rays))
        found = localise(KnownPlaces(slam.segments, grid, slam.range_sensor), rays, [np.zeros(3)])
        if found.is_accepted and found.likeness <= LARGEST_RUNNER_UP:
            self._end_absence()

    def _end_absence(self) -> None:
        self._note_event("confirmed", step=self.log.end - 1)
        self.absence = self._arrival = None

    def give_up(self) -> None:
        """The run is over, and the robot is still lost."""
        self._note_event("not found", step=self.log.end - 1)

    def _copy(self, slam: LineSlam, grid: OccupancyGrid) -> KnownFrame:
        return KnownFrame(self.log.end, slam.copied(), grid.copied())

    def _placement(self, absence: Absence, rays: FloatArray, decision: Localisation, sensor: RangeSensor) -> Placement:
        """Where the robot was before it was carried away, as far as its steps are kept."""
        assert decision.fit is not None  # noqa: S101 (an accepted decision has a fit)
        assert absence.place is not None  # noqa: S101 (it was lost from a frame)
        log, frame = self.log, decision.fit.pose
        last = max(absence.first - 1, log.begin)
        # A robot that was lost in its local frame, too, was carried away before it was lost for the first time.
        placed = log.driven_back(compose(frame, log[last].pose), last + 1)[: max(absence.since - log.begin, 1)]
        step = log.begin + len(placed)
        if absence.known is not None and log.begin == absence.known.step and not absence.is_dated:
            step = carried_at(log, placed, self._robot, sensor, absence.place)
        pose = placed[step - 1 - log.begin]
        before = next((copy for copy in self._local_copies if absence.gone and copy.step > log.begin), None)
        if before is not None:
            step, pose = before.step, compose(frame, log[before.step - 1].pose)
        # If the first steps are gone, there is none before the robot was carried away.
        lost = [*absence.gone, *(each.pose for each in log.steps[: step - log.begin])] if absence.gone else []
        poses = [pose, *(compose(frame, each) for each in lost)]
        middle = transform_points(frame, decision.middle[None])[0]
        covariances = [match_covariance(middle, each) for each in poses]
        gone = list(zip(poses[1:], covariances[1:], strict=True))
        placed_rays = moved(rays, frame)
        has_drifted = not is_far(frame, decision.middle, *(DRIFT if absence.was_moved else FAR))
        if not has_drifted and not absence.was_moved and absence.known is not None:
            has_drifted = absence.known.explains(frame, covariances[0], placed_rays)
        has_drifted &= not absence.is_astray
        return Placement(step, pose, covariances[0], placed_rays, gone, frame, before, has_drifted)

    def _note_event(self, event: str, **details: Any) -> None:
        decisions = [] if self.absence is None else self.absence.decisions
        matches: dict[str, Any] = {"refused": sum(not each.is_accepted for each in decisions)} if decisions else {}
        if decisions and event != "lost":
            matches["match"] = decisions[-1].record
        self.records.append({"event": event, **details, **matches})
