"""Whether a robot was carried away, by all readings since its readings changed suddenly.

Each step at which readings changed suddenly is a possible beginning. The readings since then are weighed with the map
of that moment, which a wrong pose cannot change any more. Three explanations of them are compared:

- The robot is where it is believed to be, or as far from there as the covariance of its pose allows.
- The robot was carried to ground that the map does not have. Every reading is then that of a random place.
- The robot was carried to another place of the map, and the readings fit there.

The first two differ by the logarithm of a likelihood ratio: the evidence of the change, less that of the readings at
the believed pose. It must outweigh the prior probability that a robot is carried away in a step. The third explanation
is judged strictly, because rooms look alike: that a new room fits at the place of an earlier one is usual in an office
building, and that a robot is carried away is not.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from limslam_agent.config.places import PlaceConfig
from limslam_agent.places.history import LoggedStep, StepLog
from limslam_agent.places.localisation import KnownPlaces, is_far, localise
from limslam_agent.places.rays import rays_of
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.status import Status
from limslam_agent.status.sudden_changes import Suspicion
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose
from limslam_env.interface import RobotSpec

_NEAR, _NEAR_TURN = 0.5, math.radians(15.0)  # m, rad: a robot that is off by less than this may have drifted
_STARTS = (-0.3, 0.0, 0.3), (-math.radians(8.0), 0.0, math.radians(8.0))  # m, rad: where poses near by are looked for
_LEAST_STD, _LEAST_TURN = 0.05, math.radians(1.0)  # m, rad: least deviation of the pose with respect to the map
_OWN = 0.5  # share of the pose's standard deviation that the walls around it do not have
_FEWEST = 60  # number of rays for which the map is searched
_DATED = 3.0  # evidence of a change that says when the robot was carried away

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
        Logarithm of the likelihood ratio of ground without a map and of the believed pose.
    is_dated
        Whether the readings of this step itself say so.
    status
        What follows from it.
    """

    step: int
    evidence: float
    is_dated: bool
    status: Status


@dataclass(eq=False)
class Kidnapping:
    """Weighs the sudden changes of one robot.

    Attributes
    ----------
    robot, config
        Body and beams, and settings.
    """

    robot: RobotSpec
    config: PlaceConfig
    _unsearched: float = field(default=math.inf, init=False)
    _elsewhere: Status = field(default=Status(), init=False)

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
        found = [(*self._here(step, change, log, sensor), step, change) for step, change in changes]
        if not found:
            self._elsewhere = Status()
            return None
        evidence, place, rays, step, change = max(found, key=lambda each: each[0])
        if evidence >= self.config.suspected:
            evidence = min(evidence, change.change - near_evidence(place, rays, covariance))
        if evidence >= self.config.carried:
            evidence = min(evidence, self._without_a_beam(step, change, place, log, sensor))
        is_dated = change.change >= _DATED
        if evidence >= self.config.carried:
            return Doubt(step, evidence, is_dated, CARRIED)
        if driven and self._unsearched >= self.config.search and len(rays) >= _FEWEST:
            self._unsearched, self._elsewhere = 0.0, self._search(place, rays, change.change - evidence)
        status = MAYBE_CARRIED if evidence >= self.config.suspected else self._elsewhere
        return Doubt(step, evidence, is_dated, status)

    def _here(
        self, step: int, change: Suspicion, log: StepLog, sensor: RangeSensor
    ) -> tuple[float, KnownPlaces, FloatArray]:
        """The evidence of a change, the map before it, and the rays since then."""
        place = KnownPlaces(change.known.segments, change.known.grid, sensor)
        rays = rays_of(log.since(step), self.robot, sensor.bias)
        return change.change - place.weigh(np.zeros((1, 3)), rays)[0].evidence, place, rays

    def _without_a_beam(
        self, step: int, change: Suspicion, place: KnownPlaces, log: StepLog, sensor: RangeSensor
    ) -> float:
        """The least evidence without the rays of one beam, which may be broken."""
        least = math.inf
        for beam in range(len(self.robot.beams)):
            rays = rays_of([_without(each, beam) for each in log.since(step)], self.robot, sensor.bias)
            least = min(least, change.change - place.weigh(np.zeros((1, 3)), rays)[0].evidence)
        # One beam may carry a part of the evidence, but not most of it.
        return least + self.config.carried - self.config.suspected

    def _search(self, place: KnownPlaces, rays: FloatArray, here: float) -> Status:
        """What follows from a search of the whole map, if the evidence of the believed pose is given."""
        if here > self.config.supported:
            return Status()
        config, found = self.config, localise(place, rays, self.config, [np.zeros(3)])
        if found.fit is None or not found.is_accepted or not is_far(found.fit.pose, found.middle):
            return Status()
        is_clear = found.fit.evidence - max(here, 0.0) >= config.elsewhere and found.likeness <= config.runner_up
        return ELSEWHERE if is_clear else MAYBE_ELSEWHERE


def near_evidence(place: KnownPlaces, rays: FloatArray, covariance: FloatArray) -> float:
    """The largest evidence of rays (n, 6) near the believed pose, less the cost of being off by so much.

    ``covariance`` (3, 3) is that of the pose.
    """
    middle = rays[:, :2].mean(axis=0)
    shifts = np.array(list(product(_STARTS[0], _STARTS[0], _STARTS[1])))
    about = np.array([*middle, 0.0])
    starts = compose(compose(about, shifts), np.array([*-middle, 0.0]))
    poses = place.refined(starts, rays)
    off = compose(compose(np.array([*-middle, 0.0]), poses), about)
    is_near = (np.hypot(off[:, 0], off[:, 1]) < _NEAR) & (np.abs(off[:, 2]) < _NEAR_TURN)
    least = np.diag([_LEAST_STD**2, _LEAST_STD**2, _LEAST_TURN**2])
    precision = np.linalg.inv(_OWN**2 * covariance + least)
    costs = 0.5 * np.einsum("ni,ij,nj->n", off, precision, off)
    fits = place.weigh(np.concatenate((poses[is_near], np.zeros((1, 3)))), rays)
    return max(fit.evidence - cost for fit, cost in zip(fits, [*costs[is_near], 0.0], strict=True))


def _without(step: LoggedStep, beam: int) -> LoggedStep:
    ranges = step.ranges.copy()
    ranges[beam] = np.nan
    return replace(step, ranges=ranges)
