"""Readings that change so suddenly that the robot must have been carried away.

For each step, the readings are explained in two ways: the robot is still *here*, and each beam goes on along what it
saw before, or sweeps past an edge; or the robot is *elsewhere*, and each reading is that of a random place. The
evidence is the logarithm of the likelihood ratio of both. A step with some evidence begins a suspicion. From then on
the readings are compared with the map of that moment, which a wrong pose cannot change any more: walls that are not
there speak for the suspicion, and walls that are there against it (A. Wald, "Sequential tests of statistical
hypotheses", 1945).
"""

import math
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from limslam_agent.kernels.tables import NOTHING
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.contradictions import Comparison, ExpectedRanges, KnownMap, Sight, compared
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.interface import RobotSpec

LASTING = 4
"""Number of steps in succession in which a beam has to see nothing, so that it is no dropout of the sensor."""

_BEGIN = 1.0  # evidence of a step that begins a suspicion
_MOST = 3  # suspicions at the same time
LONGEST = 4.0
"""Distance after which a suspicion ends, m. Turns count as in :mod:`limslam_agent.status.monitor`."""
# Evidence of a place that contradicts the map of the time before the step, and loss of evidence by a wall of that map
# which a reading fits. Each wall, and each place of a size, m, counts once.
_CONTRADICTION, _FIT, _PLACE = 4.0, 1.0, 0.3
UNSURE, LOST = 8.0, 12.0
"""Evidence with which the estimate is unsure or lost."""
_LOST_CONTRADICTED = 10.0  # this suffices to be lost if a place contradicts the map
CLEAR = 6.0
"""With less evidence by the change itself, the next comparison must confirm that the robot is lost."""
_MAPS, _LATEST = 4, 8
_SHARP = 1.5  # a reading fits sharply if the map makes it so much likelier, as a logarithm


class Moment(NamedTuple):
    """What is believed when readings are compared.

    Attributes
    ----------
    place
        Where in the drive the robot is, m.
    covariance
        Covariance of the pose (3, 3).
    known, sensor
        The map, and how ranges are measured.
    usable
        The readings (n_beams,) of the last step that count.
    seen
        Steps at which the map was contradicted before, and the points (k, 2), m, where it was.
    """

    place: float
    covariance: FloatArray
    known: KnownMap
    sensor: RangeSensor
    usable: BoolArray
    seen: list[tuple[int, FloatArray]]


@dataclass(eq=False)
class Suspicion:
    """The suspicion that a robot was carried away before a step.

    Attributes
    ----------
    step
        The first step after that.
    known
        The map of that time.
    evidence
        Logarithm of the likelihood ratio so far.
    change
        The part of the evidence that is due to readings that changed in this step.
    changed
        Number of readings that changed.
    begin
        Where in the drive the suspicion began, m.
    places, walls
        Where the map has been contradicted so far, and the walls that have been confirmed. Each counts once.
    beams
        At how many places each beam has contradicted the map.
    """

    step: int
    known: KnownMap
    evidence: float
    change: float
    changed: int
    begin: float
    places: set[tuple[int, int]]
    walls: set[int] = field(default_factory=set)
    beams: Counter[int] = field(default_factory=Counter)

    @property
    def contradicted(self) -> int:
        """Number of places that contradict the map."""
        return self.beams.total()

    @property
    def words(self) -> str:
        """The evidence in words."""
        said, count = f"{_counted(self.changed, 'reading')} changed at once", self.contradicted
        return said if not count else f"{said}, and the map is wrong at {_counted(count, 'place')}"


class SuddenChanges:
    """Watches the readings of one robot, and follows the suspicions that it was carried away.

    Parameters
    ----------
    free_space_counts
        Whether a reading that ends in free space contradicts the map.

    Attributes
    ----------
    robot
        Body, and beams as they are taken to be mounted.
    suspicions
        The suspicions that the map has not refuted so far.
    latest
        The latest suspicions, also those that were given up.
    weighed
        Number of the latest step in which a sudden change would have been noticed; -1 before the first one.
    """

    def __init__(self, robot: RobotSpec, *, free_space_counts: bool = True) -> None:
        self.robot, self._free_space_counts = robot, free_space_counts
        self._sights: list[tuple[int, Sight]] = []
        self.weighed, self._was_found = -1, False
        # The map at the latest calls. A wrong pose soon changes it.
        self._known: deque[tuple[int, KnownMap]] = deque(maxlen=_MAPS)
        self.suspicions: list[Suspicion] = []
        self.latest: deque[Suspicion] = deque(maxlen=_LATEST)

    @property
    def strongest(self) -> Suspicion | None:
        """The suspicion with the most evidence; None if there is none."""
        return max(self.suspicions, key=lambda each: each.evidence, default=None)

    @property
    def certain(self) -> Suspicion | None:
        """The suspicion that is true, if there is enough evidence for one; None otherwise.

        If little of the evidence is due to the change, the latest steps, which wait for the next call, may have changed
        more.
        """
        found = self.probable
        return found if found is None or found.change >= CLEAR or self._was_found else None

    @property
    def probable(self) -> Suspicion | None:
        """The suspicion with the largest change, if there is enough evidence for one.

        What follows a change speaks for every suspicion of the last steps.
        """
        strongest = self.strongest
        if strongest is None:
            return None
        if strongest.evidence < (_LOST_CONTRADICTED if strongest.contradicted else LOST):
            return None
        return max((each for each in self.suspicions if each.evidence >= UNSURE), key=lambda each: each.change)

    def note(self, sights: list[tuple[int, Sight]], moment: Moment) -> None:
        """Follow the suspicions through the steps since the last call, with their numbers, and look for new ones."""
        self._was_found = self.probable is not None
        self.suspicions = [each for each in self.suspicions if self._is_open(each, moment.place)]
        for each in self.suspicions:
            self._weigh(each, sights[-1][1], moment)
        self._known.append((sights[-1][0], moment.known.frozen))
        self._look_for_new(sights, moment)
        self.suspicions = sorted(self.suspicions, key=lambda each: -each.evidence)[:_MOST]

    def forget(self) -> None:
        """Forget the steps so far, after which a step is missing."""
        self._sights.clear()

    def _is_open(self, suspicion: Suspicion, place: float) -> bool:
        return suspicion.evidence > 0.0 and place - suspicion.begin <= LONGEST

    def _look_for_new(self, sights: list[tuple[int, Sight]], moment: Moment) -> None:
        """Begin a suspicion at the steps in which the readings changed suddenly.

        The last steps wait for the next call: what follows a reading says whether it was a dropout.
        """
        if self._sights and sights[0][0] != self._sights[-1][0] + 1:
            self._sights.clear()
        steps = [*self._sights, *sights]
        self._sights = steps[-2 * LASTING :]
        if len(steps) <= LASTING + 1:
            return
        evidence, usable = self._evidence([sight for _, sight in steps], moment)
        for row in np.flatnonzero(evidence.sum(axis=1) > _BEGIN).tolist():
            number, sight = steps[row + 2]
            if number > self.weighed:
                self._suspect(number, sight, usable[row], evidence[row], moment)
        self.weighed = steps[-LASTING][0]

    def _evidence(self, sights: list[Sight], moment: Moment) -> tuple[FloatArray, BoolArray]:
        """The evidence of each beam in the steps but the first two and the last few, and the readings that count."""
        robot = self.robot
        ranges, measured = np.array([each.ranges for each in sights]), np.array([each.measured for each in sights])
        measured &= ~dropouts(ranges >= robot.too_far)
        last = 1 - LASTING
        motions = np.array([each.increment for each in sights])
        motions = np.column_stack((np.hypot(motions[:, 0], motions[:, 1]), np.abs(motions[:, 2])))
        found = change_evidence(ranges[:last], measured[:last], motions[:last], robot, moment.sensor)
        return found, measured[2:last]

    def _suspect(self, step: int, sight: Sight, usable: BoolArray, evidence: FloatArray, moment: Moment) -> None:
        """Begin a suspicion, unless the map explains how the readings changed."""
        earlier = [known for number, known in self._known if number <= step]
        known = earlier[-1] if earlier else self._known[0][1]
        outcome, expected = self._compared(sight, usable, known, moment)
        change = float(np.minimum(evidence, self._unexplained(sight, outcome, expected)).sum())
        if change <= _BEGIN:
            return
        places = {cell for number, points in moment.seen if number < step for cell in self._cells(points)}
        changed = int(np.count_nonzero(evidence > 1.0))
        suspicion = Suspicion(step, known, change, change, changed, moment.place, places)
        self._count(suspicion, sight, outcome, expected)
        self.suspicions.append(suspicion)
        self.latest.append(suspicion)

    def _unexplained(self, sight: Sight, outcome: Comparison, expected: ExpectedRanges) -> FloatArray:
        """The evidence (n_beams,) that the map alone would give for each reading, at least 0."""
        evidence = np.full(len(sight.ranges), np.inf)
        beams = np.flatnonzero(outcome.expected)
        stds, limits = expected.stds[0, beams], self.robot.max_ranges[beams]
        off = (np.minimum(sight.ranges[beams], limits) - expected.ranges[0, beams]) / stds
        evidence[beams] = np.maximum(0.5 * off**2 - _sharpness(stds, limits), 0.0)
        return evidence

    def _weigh(self, suspicion: Suspicion, sight: Sight, moment: Moment) -> None:
        """Compare readings with the map of a suspicion."""
        outcome, expected = self._compared(sight, moment.usable, suspicion.known, moment)
        self._count(suspicion, sight, outcome, expected)

    def _compared(
        self, sight: Sight, usable: BoolArray, known: KnownMap, moment: Moment
    ) -> tuple[Comparison, ExpectedRanges]:
        """The readings of a step that count (n_beams,) beside a map."""
        return compared(
            self.robot, sight, usable, known, moment.covariance, moment.sensor,
            free_space_counts=self._free_space_counts,
        )  # fmt: skip

    def _count(self, suspicion: Suspicion, sight: Sight, outcome: Comparison, expected: ExpectedRanges) -> None:
        """Count what readings say about the map: once for each wall that they fit, and each place that contradicts."""
        contradicts = outcome.through | outcome.in_free
        for beam in np.flatnonzero(contradicts).tolist():
            self._count_contradiction(suspicion, sight, beam, outcome, expected)
        for beam in np.flatnonzero(outcome.fits & ~contradicts).tolist():
            wall = int(expected.walls[0, beam])
            if wall not in suspicion.walls:
                suspicion.walls.add(wall)
                sharp = float(_sharpness(expected.stds[0, beam], self.robot.max_ranges[beam]))
                suspicion.evidence -= _FIT * min(max(sharp, 0.0), _SHARP) / _SHARP

    def _count_contradiction(
        self, suspicion: Suspicion, sight: Sight, beam: int, outcome: Comparison, expected: ExpectedRanges
    ) -> None:
        """Count a beam that contradicts the map, unless the map was contradicted there before."""
        robot = self.robot
        reach = float(sight.ranges[beam] if outcome.in_free[beam] else expected.ranges[0, beam])
        end = robot.beam_origins[beam] + min(reach, robot.max_ranges[beam]) * robot.beam_directions[beam]
        row, column = self._cells(transform_points(sight.pose, end[None]))[0]
        near = {(row + down, column + right) for down in (-1, 0, 1) for right in (-1, 0, 1)}
        if near & suspicion.places:
            return
        suspicion.places.add((row, column))
        # A beam alone may be broken: what it says again counts half as much each time.
        suspicion.evidence += _CONTRADICTION / 2.0 ** suspicion.beams[beam]
        suspicion.beams[beam] += 1

    def _cells(self, points: FloatArray) -> list[tuple[int, int]]:
        """The places of points (k, 2) on a coarse grid."""
        return [tuple(cell) for cell in np.floor(points / _PLACE).astype(int).tolist()]


def change_evidence(
    ranges: FloatArray, usable: BoolArray, motions: FloatArray, robot: RobotSpec, sensor: RangeSensor
) -> FloatArray:
    """The evidence (m, n_beams) of each reading that the robot was carried away before its step.

    It is the logarithm of the likelihood of the reading at a random place, less that of the reading after the one
    before. The likelihoods are mixtures: a beam goes on along what it saw, within the slope of walls that the motion
    allows for, or it meets an edge. Their constants, in `limslam_agent.kernels.readings`, are those of recorded
    explorations.

    Parameters
    ----------
    ranges, usable
        Readings of m + 2 steps (m + 2, n_beams), m, and a mask of those that count.
    motions
        Length and angle of the motion before each of the steps (m + 2, 2), m and rad, without signs.
    robot, sensor
        The beams, and how they measure.
    """
    from limslam_agent.kernels.readings import weigh_changes

    evidence = np.empty((len(ranges) - 2, ranges.shape[1]))
    weigh_changes(ranges, usable, motions, robot.beam_table, float(sensor.std), float(sensor.growth), evidence)
    return evidence


def dropouts(nothing: BoolArray) -> BoolArray:
    """Which of the readings (m, n_beams) may have seen nothing only because the sensor missed what was there.

    Parameters
    ----------
    nothing
        Whether each beam saw nothing in each of successive steps (m, n_beams).
    """
    from limslam_agent.kernels.readings import mark_dropouts

    found = np.empty(nothing.shape, dtype=bool)
    mark_dropouts(nothing, LASTING, found)
    return found


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"


def _sharpness(stds: FloatArray, limits: FloatArray) -> FloatArray:
    """How much more likely a reading is where the map expects it than at a random place, as a logarithm."""
    return np.asarray(-np.log(NOTHING / limits * stds * math.sqrt(2.0 * math.pi)))
