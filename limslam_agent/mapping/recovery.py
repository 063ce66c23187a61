"""Recovery of one robot: it is here, lost, or placed again without being sure of it.

A robot that is lost goes on in a new local frame, with a map of its own. The earlier map is kept as
it was before the first doubt about the estimate. The readings since then are compared with it again
and again, until two searches in succession find the same place. The robot then goes on there, until
its place is confirmed or refuted.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from limslam_agent.belief import Guess
from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.mapping.frames import Frames
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
from limslam_agent.places.lost import (
    LEAST_KNOWN,
    Checkpoints,
    Here,
    KnownFrame,
    Lost,
    Placed,
    Placement,
    placed_until_carried,
)
from limslam_agent.places.revisions import (
    BEGUN_ANEW,
    GIVEN_UP,
    NOT_CONFIRMED,
    Event,
    PlaceHistory,
    Revision,
    Unplaced,
)
from limslam_agent.slam.slam import is_renewable
from limslam_agent.status.known_map import DECIDED, UNLIKELY, KnownMap, drift_fit, slip_fit
from limslam_agent.status.monitor import Loss, StatusMonitor
from limslam_agent.status.rays import STEPS, moved, rays_of, wall_points
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import transform_points

# Least number of steps by which a copy of the estimate must be older than the first doubt about it
_MARGIN = 100

LONGEST_ABSENCE = 18_000
"""Number of steps after which the frame from before a doubt is given up: half an hour with steps of
0.1 s. All steps since the doubt are kept until then, since they would have to be processed again in
that frame.
"""

WRONG_PLACE = Status("lost", "the readings contradict the map at the place that was found")


class Recovery:
    """Follows the estimate of one robot, and finds its place again when it is lost.

    Attributes
    ----------
    state
        Whether the robot is here, lost, or placed.
    events
        What has happened.
    begin
        Number of the first step that may have to be processed again.
    """

    def __init__(self, frames: Frames) -> None:
        self._frames = frames
        self._drive = frames.drives[0]
        self.begin = 0
        self._copies = Checkpoints()
        self.state: Here | Lost | Placed = Here()
        self.events: tuple[Event, ...] = ()
        self._offset = np.zeros((3, 3))  # covariance of a map that was begun anew
        # since when a robot may have been carried away, and the search for where it is then
        self._doubt: tuple[int, PlaceSearch] | None = None

    @property
    def guesses(self) -> list[Guess]:
        """Where the robot may be while it is lost, by the latest search."""
        if not isinstance(self.state, Lost) or self.state.search.latest is None:
            return []
        grid = self.state.search.place.grid
        return [
            Guess(fit.pose, min(fit.evidence - UNLIKELY, fit.log_ratio_on_map), grid)
            for fit in self.state.search.latest.open
        ]

    def status(self, own: Status) -> Status:
        """The status of the robot, whose own status in its frame is given."""
        if isinstance(self.state, Lost):
            return self.state.loss.status
        if isinstance(self.state, Placed) and own.level == "ok":
            return Status("unsure", self.state.reason)
        return own

    @property
    def added_covariance(self) -> FloatArray:
        """What has to be added to the covariance (3, 3) of the pose; zero if the robot is not lost.

        The pose at which a new map was begun stays uncertain, and all poses in this map with it.
        """
        if not isinstance(self.state, Lost):
            return self._offset
        return self._offset + self.state.covariance_at(self._drive.scans[-1].pose)

    def follow(self) -> None:
        """Keep the latest step, and see to it that a lost robot goes on in a local frame and finds
        its place again.
        """
        own = self._frames.monitors[0]
        self._note(own)
        if self._origin is not None and self._drive.end - self.begin > LONGEST_ABSENCE:
            self._stay()
        if own.loss is not None and self._still_fits(own):
            self._frames.reset_monitors()
        elif own.loss is not None:
            self._lose(own.loss, own.jump)
        elif found := self._seek_elsewhere(own):
            self._go_on_at(found)
        elif isinstance(self.state, Here) or not self.state.search.is_due:
            return
        elif isinstance(self.state, Lost):
            if found := self._seek(self.state):
                self._go_on_at(found)
        elif self._is_refuted(self.state):
            self._lose(Loss(WRONG_PLACE, self._drive.end - 1), 0.0)
        else:
            self.confirm()

    def move(self) -> None:
        """A renewal has moved the latest steps: copies from before and searches mean nothing any
        more.
        """
        self._copies = Checkpoints()
        self._doubt = None
        if not isinstance(self.state, Here):
            self.state.search.latest = None

    def arrive(self, place: KnownPlaces, rays: FloatArray) -> None:
        """The robot's place in the map of an earlier run was found by rays (n, 7), and has to be
        confirmed.
        """
        self.state = Placed(NOT_CONFIRMED, PlaceSearch(place), None, 0, rays)

    def confirm(self) -> None:
        """End the search for a place that was found if nothing speaks against it any more."""
        placed = self.state
        if not isinstance(placed, Placed):
            return
        placed.search.wait()
        frames = self._frames
        driven = placed.driven - placed.at
        if frames.monitors[0].by_readings.level != "ok" or driven < CONFIRMED:
            return
        if not placed.has_drifted:
            grid = frames.grid.view
            least = frames.config.policy.min_frontier
            if driven < FAR_CONFIRMED and frontier_cells(grid, least).any():
                return
            if other_place(KnownPlaces.of(frames.slam, grid), self._rays_of(placed)):
                return
        self._tell("confirmed")
        self.state = Here()

    def give_up(self) -> Unplaced | None:
        """Take back the map that a robot was lost from which is still lost, and return the local
        one.
        """
        if not isinstance(self.state, Lost):
            return None
        slam = self._frames.slam
        local = self._frames.grid.copied().view
        known = self.state.known
        self._frames.use(known.slam.copied(), known.grid.copied())
        self._frames.followed.relocate(slam.pose, slam.covariance)
        self._tell("not found")
        return Unplaced(known.step, slam.segments, slam.landmarks, local)

    @property
    def _origin(self) -> Lost | None:
        """What the robot is or was since it has left a frame that it may go back to."""
        if isinstance(self.state, Here):
            return None
        return self.state if isinstance(self.state, Lost) else self.state.lost

    def _note(self, own: StatusMonitor) -> None:
        """Count the latest step, and now and then copy the estimate after it."""
        end = self._drive.end
        motion = self._drive.scans[-1].motion
        if not isinstance(self.state, Here):
            driven = self.state.driven + math.hypot(*motion[:2].tolist())
            self.state = replace(self.state, driven=driven)
            self.state.search.drive(motion)
            if isinstance(self.state, Lost):
                return
        elif self._doubt is not None:
            self._doubt[1].drive(motion)
        if self._copies.is_due(end):
            self._copies.add(self._copy(), LONGEST_ABSENCE, keeps_old=own.is_suspicious)
            oldest = self._copies.oldest
            if isinstance(self.state, Here):
                self._forget_before(oldest)
            elif self.state.lost is None:
                self._forget_before(min(oldest, end - STEPS))

    def _forget_before(self, number: int) -> None:
        """Need the steps before a number no more, but for the last two of all steps."""
        # A local frame begins at the pose after the first one kept, with the step after.
        self.begin = max(self.begin, min(number, self._drive.end - 2))

    def _copy(self) -> KnownFrame:
        frames = self._frames
        return KnownFrame(self._drive.end, frames.followed.copied(), frames.grid.copied())

    def _lose(self, loss: Loss, jump: float) -> None:
        """See to it that a lost robot goes on: in a renewed map, near by, or in a local frame."""
        # The map of a local frame does not say where the robot is in the frame that it was lost
        # from.
        known = None if isinstance(self.state, Lost) else loss.known
        lost = self._note_loss(loss, jump)
        found = None
        if not lost.has_returned and not lost.was_moved:
            found = self._seek_near(lost, known)
            if found is None and self._go_on_renewed(lost):
                return
        if found is None:
            self._go_on_locally(lost)
        else:
            self._go_on_at(found)

    def _note_loss(self, loss: Loss, jump: float) -> Lost:
        """The robot is lost, and the odometry has jumped by a distance, m."""
        # A robot whose place was found and is wrong goes back to the frame as it was before, and to
        # what it believed and knew when it was lost from there: what it has read at a wrong place
        # says nothing of the earlier map. If it has slipped since then, its place was right.
        before = self.state
        first = max(loss.step, self.begin + 1)
        is_wrong = False
        if isinstance(before, Lost):
            # The step in which it was carried remains unknown if it was so.
            lost = replace(before, is_carried=before.is_carried or loss.is_carried)
        elif isinstance(before, Placed) and before.lost is not None and loss.known is None:
            is_wrong = True
            lost = replace(before.lost, driven=before.driven, has_returned=True)
            first = lost.since
            self._drive.replace(self.begin, lost.scans)
        else:
            lost = self._lost_from(first, loss, jump)
        self.state = lost = replace(lost, first=max(first, self.begin + 1))
        lost.search.begin_anew()
        self._copies = Checkpoints()
        details = {"step": lost.first, "reason": loss.status.reason}
        self._tell("lost", details, refutes=is_wrong)
        return lost

    def _lost_from(self, first: int, loss: Loss, jump: float) -> Lost:
        """A robot that was lost at a step, from the latest frame before it.

        If the readings have said in which step it was carried away, the map until then is good.
        """
        margin = 1 if loss.is_dated else _MARGIN
        known = self._copies.before(first, margin) or self._copy()
        self._forget_before(known.step)
        since = max(first, self.begin + 1)
        slam = self._frames.slam
        return Lost(
            loss=loss,
            known=known,
            since=since,
            scans=self._drive.between(self.begin, since),
            jump=max(jump, known.spread) if loss.is_carried else jump,
            covariance=slam.covariance,
            left=slam.pose,
            search=PlaceSearch(known.places),
            first=since,
            is_carried=loss.is_carried,
        )

    def _stay(self) -> None:
        """Give up the frame from which the robot was lost for its present map."""
        self._frames.own_map = self._frames.map_number
        lost = self.state
        if isinstance(lost, Lost):
            self._offset = self.added_covariance
            self._tell("given up", {"step": lost.first})
            self.state = Placed(
                GIVEN_UP, lost.search, None, lost.first, driven=lost.driven, at=lost.driven
            )
        elif isinstance(lost, Placed):
            self.state = replace(lost, lost=None, reason=NOT_CONFIRMED)

    def _is_refuted(self, placed: Placed) -> bool:
        """Whether the readings since the robot was placed contradict the map in which it was."""
        place = placed.place
        return (
            place is not None and place.fit_here(self._rays_of(placed)).log_ratio_on_map < -DECIDED
        )

    def _still_fits(self, own: StatusMonitor) -> bool:
        """Whether all readings of a robot that has drifted still fit, although its monitor says
        that it is lost.
        """
        # The monitor judges by a few readings what the search for a place judges by hundreds. Both
        # have to agree, or the robot would be lost and found in turns.
        placed = self.state
        if not isinstance(placed, Placed) or not placed.has_drifted or own.loss is None:
            return False
        if own.loss.is_carried or own.jump > 0.0 or self._is_refuted(placed):
            return False
        # The distance without contradictions begins again.
        self.state = replace(placed, at=placed.driven)
        return True

    def _seek(self, lost: Lost) -> Placement | None:
        """Search the known map for the place. The placement if two searches in succession find the
        same place.
        """
        place = lost.search.place
        rays = self._rays_since(lost.first)
        place.sensor = self._frames.slam.sensor
        if lost.is_carried:
            found = lost.search.seek(rays, may_be_bent=False)
        else:  # it has drifted, and is near, where a search of the whole map may miss its place
            near = drift_fit(place, rays, lost.covariance).fit
            found = lost.search.seek(rays, FAR_SHARE, [near], may_be_bent=True)
        return None if found is None else self._placement(lost, rays, found)

    def _seek_elsewhere(self, own: StatusMonitor) -> Placement | None:
        """The placement of a robot that may have been carried away, if its readings since then fit
        at another place than the believed one, and there only.

        Where the map of that time ends, readings near the believed pose decide nothing.
        """
        doubt = own.doubt
        if not isinstance(self.state, Here) or doubt is None or not doubt.is_carried:
            self._doubt = None
            return None
        if self._doubt is None or self._doubt[0] != doubt.step:
            known = self._copies.before(doubt.step)
            if known is None:
                return None
            self._doubt = doubt.step, PlaceSearch(known.places)
        search = self._doubt[1]
        if not search.is_due:
            return None
        rays = self._rays_since(doubt.step)
        found = search.seek(rays, may_be_bent=False)
        if found is None or found.fit is None or not is_far(found.fit.pose, found.middle):
            return None
        return self._placement(self._note_loss(doubt, own.jump), rays, found)

    def _seek_near(self, lost: Lost, known: KnownMap | None) -> Placement | None:
        """The placement of a robot that may have drifted, if its readings since then fit near the
        believed pose.

        Such a robot need not go on in a local frame. If it has slipped, ``known`` is the map of
        that moment.
        """
        if known is None and lost.first <= lost.known.step + 1:
            # the doubtful readings may be in that map already, and would fit there in any case
            return None
        rays = self._rays_since(lost.first)
        # Ground that the map does not have is unlikely beforehand, since nothing says that the
        # robot was carried away.
        near = (
            slip_fit(known, rays) if known else drift_fit(lost.search.place, rays, lost.covariance)
        )
        if (
            near.evidence < LEAD or near.fit.log_ratio_on_map < 0.0
        ):  # without rays, the evidence is 0
            return None
        middle = rays[:, :2].mean(axis=0)
        if is_far(near.fit.pose, middle):  # along a long wall, other places near by fit as well
            return None
        lost.search.latest = found = Localisation(near.fit, 0.0, middle, "")
        return self._placement(lost, rays, found)

    def _placement(self, lost: Lost, rays: FloatArray, found: Localisation) -> Placement:
        """Where the robot was before it was carried away."""
        assert found.fit is not None  # noqa: S101 (a place was found)
        frame = found.fit.pose
        scans = self._drive.since(self.begin)
        sensor = self._frames.slam.sensor
        placed = placed_until_carried(lost, scans, self.begin, frame, self._frames.robot, sensor)
        pose = placed[-1]
        covariance = match_covariance(transform_points(frame, found.middle[None])[0], pose)
        has_drifted = not is_far(frame, found.middle)
        rays_there = moved(rays, frame)
        return Placement(self.begin + len(placed), pose, covariance, rays_there, has_drifted)

    def _go_on_locally(self, lost: Lost) -> None:
        """Begin a new map in a local frame, with the steps since the robot was lost."""
        frames = self._frames
        # It takes the place of an earlier one in which the robot can't be found.
        is_anew = lost.known.walls_m < LEAST_KNOWN
        if is_anew:
            self._offset = self.added_covariance
        slam = frames.slam_at(self._drive[lost.first - 1].pose)
        calibration = lost.known.slam.odometry_calibrations[0]
        if is_renewable(slam) and calibration is not None:
            slam.calibrate(calibration)
        slam.robots[0].step = lost.first - 1
        scans = self._drive.cut(lost.first)
        frames.use(slam, OccupancyGrid(frames.config.grid))
        frames.number_map(is_own=is_anew)
        # The first step may be a jump of the odometry, which the local frame begins with and need
        # not doubt again.
        frames.process_again(scans[:1])
        frames.begin_anew()
        frames.process_again(scans[1:])
        if is_anew:
            self._tell("begun anew", {"step": lost.first}, revision=self._revision(lost.first))
            self.state = Placed(BEGUN_ANEW, PlaceSearch(lost.search.place), None, lost.first)

    def _go_on_renewed(self, lost: Lost) -> bool:
        """Renew the estimate, if that explains the readings, since the robot has only drifted;
        whether it was done.
        """
        frames = self._frames
        first = frames.renewal.first + 1
        if not frames.renew_lost():
            return False
        self.move()
        self._tell("renewed", revision=self._revision(first))
        self._return(lost, KnownPlaces.of(frames.slam, frames.grid.view), has_drifted=True)
        return True

    def _go_on_at(self, found: Placement) -> None:
        """Go on in the frame that the robot was lost from, at the place that was found."""
        frames = self._frames
        lost = self.state
        assert isinstance(lost, Lost)  # noqa: S101 (the robot was lost from a frame)
        scans = self._drive.cut(self.begin)
        slam = lost.known.slam.copied()
        slam.robots[0].step = self.begin - 1
        frames.use(slam, lost.known.grid.copied())
        count = found.step - self.begin
        frames.process_again(scans[:count])
        slam.relocate(found.pose, found.covariance, ends=wall_points(found.rays))
        # The comparisons until now have seen how the robot was carried away, and no stretch with
        # that motion can be smoothed.
        frames.begin_anew()
        frames.process_again(scans[count:])
        # The search has weighed the readings of these steps together. While they are processed
        # again, a bent map may contradict a few of them, and the robot would be lost and found in
        # turns.
        frames.reset_monitors()
        known: dict[str, Any] = {"revision": self._revision(self.begin)}
        if found.has_drifted:
            past = PlaceHistory(self.events)
            first = max([0, *past.breaks, *(last for _, last in past.slips)])
            known["slipped"] = (first, found.step)
        else:
            known["carried_at"] = found.step
        self._tell("found", {"carried_at": found.step}, **known)
        self._return(lost, lost.search.place, rays=found.rays, has_drifted=found.has_drifted)

    def _return(self, lost: Lost, place: KnownPlaces, **placed: Any) -> None:
        """The robot goes on at a place that is to be confirmed in a map."""
        lost.search.wait()
        self.state = Placed(
            NOT_CONFIRMED,
            lost.search,
            lost,
            lost.first,
            place=place,
            driven=lost.driven,
            at=lost.driven,
            **placed,
        )

    def _rays_since(self, first: int) -> FloatArray:
        """The rays (n, 7) of the robot from a step on."""
        sensor = self._frames.slam.sensor
        return rays_of(self._drive.since(first), self._frames.robot, sensor)

    def _rays_of(self, placed: Placed) -> FloatArray:
        """The rays (n, 7) of a robot since it was lost, after those by which it was placed."""
        return np.concatenate((placed.rays, self._rays_since(placed.first)))

    def _revision(self, first: int) -> Revision:
        """The poses from a step on, which are known better now."""
        scans = self._drive.since(first)
        poses = np.array([scan.pose for scan in scans])
        return Revision(first, poses, np.array([scan.covariance for scan in scans]))

    def _tell(self, event: str, details: dict[str, Any] | None = None, **known: Any) -> None:
        """Add an event, with how the latest search stands, and what is ``known`` by it."""
        record = {"event": event, "step": self._drive.end - 1, **(details or {})}
        if not isinstance(self.state, Here):
            record |= self.state.search.record
        self.events += (Event(record, **known),)
