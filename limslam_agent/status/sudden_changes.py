"""Changes of the readings before which the robot may have been moved, and what all readings since
then say.

For each step, the readings are explained in two ways: the robot is still *here*, and each beam goes
on along what it saw before, or sweeps past an edge; or the robot is *elsewhere*, and each reading
is that of a random place. The evidence is the logarithm of the likelihood ratio of both, as far as
the map does not explain the readings. All readings since a change are weighed with the map of that
moment, which a wrong pose cannot change any more. It says whether the robot is still here, has
*slipped* and is near, or is elsewhere.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from limslam_agent.dropouts import short_series
from limslam_agent.kernels.tables import RAY_BEAM
from limslam_agent.record import Drive, Scan
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.known_map import (
    DECIDED,
    DOUBTED,
    UNLIKELY,
    Explained,
    KnownMap,
    contradiction_test,
    drift_fit,
    slip_fit,
)
from limslam_agent.status.rays import LASTING, moved, numbered_rays_of, step_rays
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec

WINDOW = 3.0
LONGEST_SPACING = 0.30
"""Length of the last part of the drive whose readings count, and way between two changes at most,
m.
"""

_SUPPORTED = 15.0  # evidence of readings that clearly fit
_EXPLAINED = (
    1.0  # evidence of a reading for the map: more than that of seeing nothing on free ground
)
_MAPS = 4
# Number of changes that are remembered. Driving makes fewer in a window, standing makes any number.
_CHANGES = 50


@dataclass(frozen=True, eq=False)
class Change:
    """A step before which a robot may have been carried away.

    Attributes
    ----------
    step, place
        Number of the step, and where in the drive it was noted, m.
    known
        The map of that time, which a wrong pose cannot change any more.
    by_beam
        Logarithm of the likelihood ratio by the change of each reading (n_beams,).
    """

    step: int
    place: float
    known: KnownMap
    by_beam: FloatArray

    @property
    def evidence(self) -> float:
        """Logarithm of the likelihood ratio by the changes of all readings."""
        return float(self.by_beam.sum())


class Suspicion(NamedTuple):
    """That the robot is not where it is believed to be since a change.

    Attributes
    ----------
    change, evidence
        The change, and the logarithm of the likelihood ratio of that and of the believed pose.
    is_certain
        Whether it is lost, even if the beam that says most is broken.
    is_slip
        Whether the robot has slipped, and is near; it is elsewhere otherwise.
    """

    change: Change
    evidence: float
    is_certain: bool = False
    is_slip: bool = False


class Now(NamedTuple):
    """Where a robot is when its readings are weighed."""

    first: int  # number of the first step that counts
    place: float  # where in the drive it is, m
    known: KnownMap  # the map as it is now
    covariance: FloatArray  # of the pose (3, 3)


class _Since(NamedTuple):
    """What the rays (n, 7) since a change say of the believed pose, and its covariance (3, 3)."""

    change: Change
    rays: FloatArray
    here: Explained
    covariance: FloatArray

    @property
    def evidence(self) -> float:
        """Their evidence for the believed pose."""
        return float(self.here.evidence.sum())


class SuddenChanges:
    """Finds the changes of one robot's readings, and weighs them by all readings since then.

    A change may be sudden, or the robot has slipped, or the place that it was carried to looked at
    first like its own. So the likeliest step of each ``LONGEST_SPACING`` is a change, too.

    Attributes
    ----------
    suspicion
        The likeliest one that makes the robot doubtful; None without it.
    """

    def __init__(self, robot: RobotSpec, drive: Drive) -> None:
        self._robot = robot
        self._drive = drive
        self._noted = -math.inf
        # The map at the latest calls. A wrong pose soon changes it.
        self._known: deque[tuple[int, KnownMap]] = deque(maxlen=_MAPS)
        self.forget()

    def look(self, now: Now) -> None:
        """Note the likeliest change since the last call, if it is sudden or the last one is some
        way back.

        All changes are weighed then.
        """
        found = self._likeliest(now)
        if found is None or (found.evidence <= 0.0 and now.place - self._noted < LONGEST_SPACING):
            return
        self._noted = now.place
        self._changes.append(found)
        self._weigh(now)

    def forget(self) -> None:
        """Forget all changes and maps until now, since the estimator has closed a loop, and moved
        the map.
        """
        self._weighed = self._drive.end - 1
        self._changes = list[Change]()
        self._known.clear()
        self.suspicion: Suspicion | None = None

    def _weigh(self, now: Now) -> None:
        """Weigh the changes by the readings since then, and find the likeliest one that makes the
        robot doubtful.

        The robot is still here, it has slipped, or it is elsewhere. A doubt ends when the readings
        refute it as clearly as they have to speak for it at first. Until then, its change is
        remembered.
        """
        begin = max(self._changes[0].step, now.first)
        rays, steps = numbered_rays_of(self._drive.since(begin), self._robot, now.known.sensor)
        doubted = None if self.suspicion is None else self.suspicion.change
        self.suspicion = None
        kept = list[Change]()
        least = DOUBTED
        # A pose near the believed one takes long to find, and only makes a change less likely. So
        # the likeliest change of the last time comes first, and less likely ones need no such pose.
        for change in sorted(self._changes, key=lambda each: each is not doubted):
            change.known.sensor = now.known.sensor
            later = change.known.counting(rays[steps + begin >= change.step])
            since = _Since(change, later, change.known.explained(later), now.covariance)
            found = self._carried(since, least)
            found = self._slipped(since, max(least, found.evidence)) or found
            is_doubted = found.evidence >= (-DOUBTED if change is doubted else DOUBTED)
            if is_doubted and (self.suspicion is None or found.evidence >= least):
                self.suspicion = found
                least = max(DOUBTED, found.evidence)
            if is_doubted or now.place - change.place <= WINDOW:
                kept.append(change)
        self._changes = sorted(kept, key=attrgetter("step"))[-_CHANGES:]

    def _carried(self, since: _Since, least: float) -> Suspicion:
        """That the robot is elsewhere since a change.

        The evidence of less than ``least`` is too large if the robot has drifted.
        """
        change = since.change
        evidence = change.evidence - since.evidence
        if evidence >= least:  # or it has drifted
            near = drift_fit(change.known, since.rays, since.covariance)
            test = contradiction_test(near.fit.contradictions, near.fit.tested)
            evidence = min(evidence, change.evidence + max(-near.evidence, test))
        others = self._without_the_worst(since.rays, -since.here.evidence, change.by_beam)
        return Suspicion(change, evidence, is_certain=evidence >= UNLIKELY and others >= DECIDED)

    def _slipped(self, since: _Since, least: float) -> Suspicion | None:
        """That the robot has slipped at a change; None if that is not certain, or has less evidence
        than ``least``.

        Readings on unknown ground may fit a turned map by chance. So one of them must contradict
        the believed pose, and those after it must not clearly fit there.
        """
        change, rays, here, covariance = since
        contradicting = np.flatnonzero(here.against)
        if not len(contradicting) or here.evidence[contradicting[-1] + 1 :].sum() > _SUPPORTED:
            return None
        slip = slip_fit(change.known, rays)
        least = max(least, DECIDED)
        evidence = slip.evidence - since.evidence
        if evidence < least:
            return None
        drifted = drift_fit(change.known, rays, covariance, slip.fit.pose[None])
        evidence = min(evidence, slip.evidence - drifted.evidence)
        there = change.known.explained(moved(rays, slip.fit.pose))
        others = self._without_the_worst(rays, there.evidence - here.evidence)
        return (
            Suspicion(change, evidence, is_certain=True, is_slip=True)
            if evidence >= least and others >= DECIDED
            else None
        )

    def _likeliest(self, now: Now) -> Change | None:
        """The step since the last call with the most sudden change, if there is a step."""
        known = now.known
        self._known.append((self._drive.end - 1, known.frozen))
        begin = max(self._weighed + 1 - LASTING, now.first)
        scans = self._drive.since(begin)
        if len(scans) <= LASTING + 1:
            return None
        evidence = change_evidence(scans, self._robot, known.sensor)[: 1 - LASTING]
        new = max(self._weighed - begin - 1, 0)
        self._weighed = begin + len(scans) - LASTING
        if new >= len(evidence):
            return None
        row = new + int(evidence[new:].sum(axis=1).argmax())
        number = begin + row + 2
        map_then = next(
            (each for at, each in reversed(self._known) if at <= number), self._known[0][1]
        )
        is_explained = self._are_explained(scans[row + 2], map_then, now.covariance)
        by_beam = np.where(is_explained, np.minimum(evidence[row], 0.0), evidence[row])
        return Change(number, now.place, map_then, by_beam)

    def _are_explained(self, scan: Scan, known: KnownMap, covariance: FloatArray) -> BoolArray:
        """Which readings (n_beams,) ended where the map has a wall, so that their change says
        nothing.
        """
        sensor = known.sensor
        robot = self._robot
        ranges = sensor.corrected(scan.ranges, robot)
        rays = moved(step_rays(ranges, sensor.mounted(robot)), scan.pose)
        found: BoolArray = np.zeros(len(scan.ranges), dtype=bool)
        evidence = known.explained(rays, covariance).evidence
        found[rays[:, RAY_BEAM].astype(int)] = evidence > _EXPLAINED
        return found

    def _without_the_worst(
        self, rays: FloatArray, evidence: FloatArray, more: FloatArray | float = 0.0
    ) -> float:
        """The evidence (n,) of rays (n, 7), and ``more`` (n_beams,), of all beams but the one that
        says most, which may be broken.
        """
        found = more + by_beam(rays, evidence, self._robot)
        return float(found.sum() - found.max())


def change_evidence(scans: Sequence[Scan], robot: RobotSpec, sensor: RangeSensor) -> FloatArray:
    """The evidence (m, n_beams) of each reading that the robot was carried away before its step.

    It is the logarithm of the likelihood of the reading at a random place, less that of the reading
    after the one before. The likelihoods are mixtures: a beam goes on along what it saw, within the
    slope of walls that the motion allows for, or it meets an edge. Their constants, in
    `limslam_agent.kernels.readings`, are those of recorded explorations.

    Parameters
    ----------
    scans
        m + 2 steps. Readings that saw nothing count if the beam does so in ``LASTING`` steps in
        succession.
    robot, sensor
        The beams, and how they measure.
    """
    from limslam_agent.kernels.readings import weigh_changes

    ranges = np.array([scan.ranges for scan in scans])
    motions = np.array([scan.motion for scan in scans])
    usable = np.isfinite(ranges) & ~short_series(ranges >= robot.too_far, LASTING)
    lengths = np.column_stack((np.hypot(*motions[:, :2].T), np.abs(motions[:, 2])))
    evidence = np.empty((max(len(ranges) - 2, 0), ranges.shape[1]))
    weigh_changes(
        ranges, usable, lengths, robot.beam_table, float(sensor.std), float(sensor.growth), evidence
    )
    return evidence


def by_beam(rays: FloatArray, evidence: FloatArray, robot: RobotSpec) -> FloatArray:
    """The evidence (n,) of rays (n, 7), summed for each beam (n_beams,)."""
    return np.asarray(
        np.bincount(rays[:, RAY_BEAM].astype(int), evidence, len(robot.beams)), dtype=float
    )
