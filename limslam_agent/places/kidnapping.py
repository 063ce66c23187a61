"""Whether a robot was carried away, by all readings since its readings changed suddenly.

Each step at which readings changed suddenly is a possible beginning. The readings since then are weighed with the map
of that moment, which a wrong pose cannot change any more. Three explanations of them are compared:

- The robot is where it is believed to be, or as far from there as the covariance of its pose allows.
- The robot was carried to ground that the map does not have. Every reading is then that of a random place.
- The robot was carried to another place of the map, and the readings fit there.

The first two differ by the logarithm of a likelihood ratio: the evidence of the change, less that of the readings at
the believed pose. It must outweigh the prior probability that a robot is carried away in a step. The third explanation
only makes the robot unsure, because rooms look alike: that a new room fits at the place of an earlier one is usual in
an office building, and that a robot is carried away is not. It makes the robot lost if the readings also say that it is
not where it is believed to be, and fit nowhere near by.

A change that makes the robot unsure is held until the readings since then clearly fit the believed pose, and not only
as long as changes are watched: time alone says nothing for the pose. If they have clearly fitted at any time since a
change, and do so no more, the robot has probably drifted later. It may also be at a place that looked at first like the
one before. So a renewal of the estimate is tried, and otherwise the robot is sought as one that was carried away.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from limslam_agent.places.history import LoggedStep, StepLog
from limslam_agent.places.localisation import KnownPlaces, Localisation, NearFit, agree, is_far, localise, near_fit
from limslam_agent.places.rays import rays_of
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.status import Status
from limslam_agent.status.sudden_changes import Suspicion
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec

_FEWEST = 60  # number of rays for which the map is searched
_MANY_BEAMS = 24  # one of more beams than this decides nothing
_HELD, _LATEST = 1500, 300  # largest number of steps for which a doubtful change is held, and that weigh each beam
_CHANGED, _MISFITS = 2, 0.05  # beams that changed, and largest share of rays of a sound beam that contradict the map
_SEARCH = 1.0  # m: distance between two searches of the whole map
# It is lost if the evidence that it was carried away is at least this. Another place of the map makes it unsure only if
# its readings have at most the second evidence at the believed pose, and lost only if near it, too.
_LOST, _SUPPORTED = 10.0, 15.0
_DATED = 3.0  # evidence of a change that says when the robot was carried away

SUSPECTED = 6.0
"""A robot is unsure if the evidence that it was carried away is at least this: a logarithm of a likelihood ratio that
outweighs the prior.
"""

CARRIED = Status("lost", "readings changed at once, and those since then do not fit the place")
MAYBE_CARRIED = Status("unsure", CARRIED.reason)
ELSEWHERE = Status("lost", "the latest readings fit another place of the map")
MAYBE_ELSEWHERE = Status("unsure", ELSEWHERE.reason)


@dataclass(frozen=True, eq=False)
class Doubt:
    """That a robot may have been carried away.

    Attributes
    ----------
    step
        Number of the first step after that.
    evidence
        Logarithm of the likelihood ratio of ground without a map, and of the believed pose or one near by.
    is_dated
        Whether the readings of this step itself say so.
    status
        What follows from it.
    has_fitted
        Whether the readings after that step have clearly fitted the believed pose at any time. The robot may then have
        drifted since, and need not have been carried away in that step.
    """

    step: int
    evidence: float
    is_dated: bool
    status: Status
    has_fitted: bool = False


class _Weighed(NamedTuple):
    """A sudden change of the readings, the rays (n, 6) since then, and the map before it.

    ``here`` is the evidence of the rays at the believed pose.
    """

    step: int
    change: Suspicion
    rays: FloatArray
    place: KnownPlaces
    here: float

    @property
    def evidence(self) -> float:
        """Logarithm of the likelihood ratio of ground without a map and of the believed pose."""
        return self.change.change - self.here


class _Held(NamedTuple):
    """A change that makes the robot unsure, and the step (number of the log) at which it began."""

    step: int
    change: Suspicion
    status: Status


@dataclass(eq=False)
class Kidnapping:
    """Weighs the sudden changes of one robot.

    Attributes
    ----------
    robot
        Body and beams as specified.
    """

    robot: RobotSpec
    _unsearched: float = field(default=math.inf, init=False)
    _spacing: float = field(default=0.0, init=False)
    _elsewhere: Status = field(default=Status(), init=False)
    _searched: Localisation | None = field(default=None, init=False)
    _held: _Held | None = field(default=None, init=False)
    _fitted_after: list[Suspicion] = field(default_factory=list, init=False)  # changes after which readings fitted

    @property
    def held(self) -> int | None:
        """The step at which a change that makes the robot unsure began; None without one."""
        return None if self._held is None else self._held.step

    def forget(self) -> None:
        """Hold nothing any more: the frame of the poses has changed."""
        self._held, self._elsewhere, self._searched, self._fitted_after = None, Status(), None, []

    def doubt(
        self,
        changes: Sequence[tuple[int, Suspicion]],
        log: StepLog,
        covariance: FloatArray,
        sensor: RangeSensor,
        driven: float = 0.0,
    ) -> Doubt | None:
        """The likeliest of the changes, with the steps (numbers of the log) at which they began; None without a change.

        Parameters
        ----------
        covariance
            Covariance (3, 3) of the pose.
        driven
            Distance since the last call, m. The whole map is searched now and then, and never if this is 0.
        """
        self._unsearched += driven
        changes = self._with_held(changes, log)
        if not changes:
            self.forget()
            return None
        found = [self._weigh(step, change, log.since(step), sensor) for step, change in changes]
        fitted = [each.change for each in found if each.change in self._fitted_after or each.here > _SUPPORTED]
        self._fitted_after = fitted
        likeliest = max(found, key=lambda each: each.evidence)
        near, evidence, status = None, likeliest.evidence, Status()
        if evidence >= SUSPECTED:
            near, status = near_fit(likeliest.place, likeliest.rays, covariance), MAYBE_CARRIED  # or it has drifted
            evidence = min(evidence, likeliest.change.change - near.evidence)
        if evidence >= _LOST and self._needs_no_beam(likeliest, log, sensor):
            status = CARRIED
        if driven and status.level != "lost" and self._unsearched >= max(_SEARCH, self._spacing):
            self._unsearched, self._elsewhere = 0.0, self._by_search(likeliest, near, log)
        if status.level == "ok" or self._elsewhere.level == "lost":
            status = self._elsewhere
        status = self._held_status(likeliest, status)
        has_fitted = likeliest.change in self._fitted_after
        is_dated = likeliest.change.change >= _DATED and not has_fitted
        return Doubt(likeliest.step, evidence, is_dated, status, has_fitted)

    def _with_held(self, changes: Sequence[tuple[int, Suspicion]], log: StepLog) -> list[tuple[int, Suspicion]]:
        """The changes, and the one that is held."""
        held = self._held
        if held is None or not log.begin < held.step or log.end - held.step > _HELD:
            self._held = None
            return list(changes)
        others = [(step, change) for step, change in changes if change is not held.change]
        return [*others, (held.step, held.change)]

    def _held_status(self, likeliest: _Weighed, status: Status) -> Status:
        """The status, or that of the change that is held until the readings since then clearly fit."""
        if status.level != "ok":
            self._held = _Held(likeliest.step, likeliest.change, status)
        elif likeliest.here > _SUPPORTED:
            self._held = None
        return status if self._held is None else self._held.status

    def _weigh(self, step: int, change: Suspicion, steps: Sequence[LoggedStep], sensor: RangeSensor) -> _Weighed:
        """Weigh a change by the steps since then."""
        place = KnownPlaces(change.known.segments, change.known.grid, sensor)
        rays = rays_of(steps, self.robot, sensor)
        return _Weighed(step, change, rays, place, place.weigh(np.zeros((1, 3)), rays)[0].evidence)

    def is_refuted(self, step: int, change: Suspicion, log: StepLog, sensor: RangeSensor) -> bool:
        """Whether the readings since a sudden change fit the believed pose, so that it was none."""
        return self._weigh(step, change, log.since(step), sensor).evidence < 0.0

    def _needs_no_beam(self, found: _Weighed, log: StepLog, sensor: RangeSensor) -> bool:
        """Whether a change has enough evidence without any one of the beams, which may be broken.

        A beam whose readings fitted before the change is not broken if others changed with it.
        """
        if len(self.robot.beams) > _MANY_BEAMS:
            return True
        beams = np.arange(len(self.robot.beams))
        for beam in range(len(beams)):
            steps = [_without(step, beams == beam) for step in log.since(found.step)[-_LATEST:]]
            is_needed = self._weigh(found.step, found.change, steps, sensor).evidence < SUSPECTED
            if is_needed and not (found.change.changed >= _CHANGED and self._fitted(beam, found, log, sensor)):
                return False
        return True

    def _fitted(self, beam: int, found: _Weighed, log: StepLog, sensor: RangeSensor) -> bool:
        """Whether the readings of a beam fitted the map before a change."""
        others = np.arange(len(self.robot.beams)) != beam
        rays = rays_of([_without(step, others) for step in log.steps[: found.step - log.begin]], self.robot, sensor)
        fit = found.place.weigh(np.zeros((1, 3)), rays)[0]
        return fit.evidence >= SUSPECTED and fit.contradictions <= _MISFITS * len(rays)

    def _by_search(self, found: _Weighed, near: NearFit | None, log: StepLog) -> Status:
        """What follows from a search of the whole map before a change.

        ``near`` is the likeliest pose near the believed one if the readings say that the robot is not at this one.
        """
        before, self._searched = self._searched, None
        if found.here > _SUPPORTED or len(found.rays) < _FEWEST:
            return Status()
        self._spacing = _SEARCH * found.place.size  # the time of a search grows with the map
        self._searched = other = localise(found.place, found.rays, [np.zeros(3)])
        if other.fit is None or not other.is_accepted or not is_far(other.fit.pose, other.middle):
            return Status()
        # If the robot has drifted, a pose near by explains what contradicts the believed one, and a new room may look
        # like an earlier one.
        if near is None or near.evidence > _SUPPORTED or not self._needs_no_beam(found, log, found.place.sensor):
            return MAYBE_ELSEWHERE
        is_found = before is not None and agree(before, other)  # as the place of a lost robot
        return ELSEWHERE if is_found else MAYBE_ELSEWHERE


def _without(step: LoggedStep, beams: BoolArray) -> LoggedStep:
    """The step without the readings of some beams (n_beams,)."""
    return replace(step, ranges=np.where(beams, np.nan, step.ranges))
