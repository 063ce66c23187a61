"""The place of a drive in a map, by the likelihood of its readings: a search of the whole map, now
and then.

Poses on a grid are weighed roughly, the best of them are refined, and these are weighed exactly
(:mod:`~limslam_agent.status.known_map`).

A place counts by two likelihood ratios. Against all other places of the map, its evidence must
lead. Against ground that the map does not have, and that may look alike, hardly a ray may
contradict the map. Rays on unknown ground take part in neither.

The same search serves a robot that is lost from a map, one that begins in the map of an earlier
run, and two robots that do not know where they are relative to each other. Its answer is a pose of
the drive's frame in the map.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from limslam_agent.grid.occupancy import GridView
from limslam_agent.readings import TURN_LENGTH
from limslam_agent.slam.core.estimator import Estimator
from limslam_agent.status.known_map import DECIDED, DRIFT, MATCH_COVARIANCE, KnownMap, PlaceFit
from limslam_agent.status.sudden_changes import WINDOW
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import compose, transform_points, wrap_angle
from limslam_env.geometry.segment import sample

_CELL = 0.05  # m: of the rough search
# m^2: the following numbers of poses are those of a map with so much ground, and grow with it
_GROUND = 100.0
# every second row and column is tried, and this number of turns
_EVERY = 2
_TURNS = 72
_MARGIN = 1.0  # m: the middle of a drive may lie so far outside of free ground
# number of rays in the rough search, and of its best poses
_LATEST = 60
_EARLIER = 60
_POSES = 2000
# number of poses that are refined: by the ground, and in a small map
_REFINED = 60
_FEWEST = 150
_SPREAD = 0.25, math.radians(12.0)  # how far these poses are apart
_LIKENESS = 0.85  # largest share that the evidence of another place has of that of the best one
_KEPT = 20  # number of places that are tried again in the next search
# m, and evidence of a ray's end at a wall, and in free ground
_WALL = 0.20
_HIT = (2.5, 1.3)
_MISS = -8.0
# evidence of a ray's way through a wall, and through free ground
_CROSSED = -6.0
_FREE = 0.2
_ALIKE = (
    2.0  # a place is a rival if its test of contradictions speaks less for it by less than this
)

LEAD = 25.0
"""Least difference between the evidence of a place and that of every other place."""

FAR_SHARE = 0.3
"""For what share of its evidence a place counts that is far from the believed one, if nothing says
that the robot was carried away.
"""

FAR = 1.5, math.radians(30.0)
"""A robot that is off by more than this, m and rad, has not drifted, but was carried."""

# m: way to the first search, and between two of them
_FIRST = 0.8
_SPACING = 0.35

LARGEST_RUNNER_UP = 0.70
"""Largest evidence of another place, as a share of the best one, at which a place is confirmed."""

CONFIRMED = WINDOW
FAR_CONFIRMED = 30.0
"""A place is confirmed after so much driving without contradictions, m: in a map without a
frontier, and in any map.
"""


class KnownPlaces(KnownMap):
    """A map as it is searched for the place of a drive. Its grid must not change any more."""

    @classmethod
    def of(cls, slam: Estimator, grid: GridView) -> Self:
        """The map of a SLAM, with its grid."""
        return cls(slam.segments, grid, slam.sensor)

    @cached_property
    def size(self) -> float:
        """Ground of the map in units of a small map's, at least 1. The time of a search grows with
        it.

        A large map has so many places that are alike along their walls that the true place may be
        far behind the best ones of a rough search. So the number of places that are weighed exactly
        grows with the map.
        """
        if not len(self.segments):
            return 1.0
        return max(1.0, np.count_nonzero(self._rough[2]) * (_EVERY * _CELL) ** 2 / _GROUND)

    def likely(self, rays: FloatArray) -> FloatArray:
        """Poses (m, 3) at which the rays (n, 7) may fit, by a rough search of the whole map.

        The latest rays take part, and some of the earlier ones: the robot may have left the ground
        of the map again. Contradictions cost much, because the right place of a robot that has seen
        little of this ground has fewer fitting rays than many wrong places.
        """
        from limslam_agent.kernels.rays import choose_apart, scan_poses

        low, fields, is_tried = self._rough
        some = _sample(rays)
        middle = some[:, :2].mean(axis=0)
        turns = np.linspace(0.0, 2.0 * np.pi, _TURNS, endpoint=False)
        scores = np.empty((len(turns), *is_tried.shape), dtype=np.float32)
        scan_poses(turns, some, middle, fields, _CELL, np.empty(some.shape, dtype=np.int64), scores)
        good = np.flatnonzero((scores > 0.0) & is_tried)
        values = scores.ravel()[good]
        count = min(round(self.size * _POSES), len(good))
        best = np.argpartition(values, len(good) - count)[len(good) - count :]
        best = best[np.argsort(-values[best], kind="stable")]
        turn, row, column = np.unravel_index(good[best], scores.shape)
        places = np.column_stack((column, row))
        centred = np.column_stack((low + (_EVERY * places + 0.5) * _CELL, turns[turn]))
        chosen = np.zeros(len(centred), dtype=bool)
        choose_apart(centred, *_SPREAD, chosen, max(_FEWEST, round(self.size * _REFINED)))
        return np.asarray(compose(centred[chosen], np.array([*-middle, 0.0])))

    @cached_property
    def _rough(self) -> tuple[FloatArray, NDArray[np.float32], BoolArray]:
        """The map of the rough search: its corner, the evidence of ends and ways as
        :func:`scan_poses` takes it, and the places to try.
        """
        low: FloatArray = np.asarray(self.grid.low - _MARGIN, dtype=np.float64)
        size = np.array(self.grid.values.shape) * self.grid.cell + 2.0 * _MARGIN
        rows, columns = (_EVERY * np.ceil(size / (_EVERY * _CELL))).astype(int)
        cells = np.indices((rows, columns)).reshape(2, -1).T
        centres = low + (cells[:, ::-1] + 0.5) * _CELL
        free: BoolArray = (self.grid.values_at(centres) > 0).reshape(rows, columns)
        is_open = np.ones(free.shape, dtype=bool)
        walls = np.floor((sample(self.segments, 0.7 * _CELL)[0] - low) / _CELL).astype(np.int64)[
            :, ::-1
        ]
        walls = walls[np.all((walls >= 0) & (walls < free.shape), axis=1)]
        is_open[walls[:, 0], walls[:, 1]] = False
        away = distance_transform_edt(is_open) * _CELL
        at_wall = _HIT[0] - (_HIT[0] - _HIT[1]) * (away / _WALL) ** 2
        ends = np.where(away < _WALL, at_wall, np.where(free & (away > 0.25), _MISS, 0.0))
        ways = np.where(away < 0.8 * _CELL, _CROSSED, np.where(free, _FREE, 0.0))
        fields = (
            np.stack((ends, ways))
            .astype(np.float32)
            .reshape(2, rows // _EVERY, _EVERY, columns // _EVERY, _EVERY)
        )
        is_tried = distance_transform_edt(~free)[::_EVERY, ::_EVERY] * _CELL < _MARGIN
        return low, np.ascontiguousarray(fields.transpose(0, 2, 4, 1, 3)), is_tried


@dataclass(frozen=True, eq=False)
class Localisation:
    """The best place of a drive in a map, and whether it counts."""

    fit: PlaceFit | None  # the best place; None if there is none
    # The largest evidence of another place, at least 0, which is that of a random place. It is
    # larger by so much as the best place counts for less.
    runner_up: float
    middle: FloatArray  # middle (2,) of the drive, m, in its own frame
    refusal: str  # why the place does not count, in words. Empty if it counts.
    # The best places that the readings have not refuted. With more readings, each of them may be
    # the right one.
    open: Sequence[PlaceFit] = ()
    # Whether the best place is near the believed pose, and the robot has probably drifted. Ground
    # that the map does not have is unlikely then, and the contradictions need only not speak
    # against the place.
    is_near: bool = False

    @property
    def is_accepted(self) -> bool:
        """Whether the place counts."""
        return not self.refusal

    @property
    def likeness(self) -> float:
        """The evidence of the best other place, as a share of the largest evidence."""
        return (
            1.0
            if self.fit is None or self.fit.evidence <= 0.0
            else self.runner_up / self.fit.evidence
        )

    @property
    def record(self) -> dict[str, Any]:
        """The place as it stands in ``result.json``."""
        fit = self.fit
        figures = (
            {}
            if fit is None
            else {
                "pose": fit.pose.tolist(),
                "evidence": fit.evidence,
                "runner_up": self.runner_up,
                "contradictions": fit.contradictions,
                "tested": fit.tested,
            }
        )
        return {
            **figures,
            "accepted": self.is_accepted,
            "reason": self.refusal or "the readings fit in one place only",
        }


def localise(
    known: KnownPlaces,
    rays: FloatArray,
    before: Sequence[FloatArray] = (),
    far: float = 1.0,
    near: Sequence[PlaceFit] = (),
) -> Localisation:
    """Search a map for the place of a drive, and decide whether it counts.

    Parameters
    ----------
    rays
        Rays (n, 7) of the drive.
    before
        Poses (3,) that were likely before.
    far
        For what share of its evidence a place counts that is far from the pose that was believed,
        the origin. It is less than 1 for a robot that has probably drifted, and was not carried
        away.
    near
        Places near the believed pose, which are compared with the others as they are. A search of
        the whole map may miss them.
    """
    if not len(rays) or not len(known.segments):
        return Localisation(None, 0.0, np.zeros(2), "there is nothing to compare")
    middle = rays[:, :2].mean(axis=0)
    likely = np.concatenate((known.likely(rays), np.array(before).reshape(-1, 3)))
    fits = [*known.weigh(known.refined(likely, rays), rays), *near]
    if not fits:
        return Localisation(None, 0.0, middle, "the readings fit nowhere")
    shares = {id(fit): far if is_far(fit.pose, middle) else 1.0 for fit in fits}
    # Where the test of contradictions has said that the drive is not there, chance fits count no
    # more.
    fits.sort(key=lambda fit: (fit.log_ratio_on_map < -DECIDED, -fit.evidence * shares[id(fit)]))
    places = _places(fits, middle)
    best = places[0]
    share = shares[id(places[0])]
    is_near = far < 1.0 and share == 1.0
    # A far place is compared with others that count in full, and a near one with far ones that do
    # not.
    rivals = [fit.evidence * (1.0 if share < 1.0 else shares[id(fit)]) for fit in places[1:]]
    runner_up = max([0.0, *rivals]) / share if share > 0.0 else math.inf
    refusal = _refusal(best, runner_up, 0.0 if is_near else DECIDED)
    # The readings of a drive that has left the ground of the map say little there, and may fit
    # where rooms look alike.
    alike = [
        fit
        for fit in places[1:]
        if shares[id(fit)] >= share and fit.log_ratio_on_map > best.log_ratio_on_map - _ALIKE
    ]
    if alike and not refusal:
        refusal = (
            f"ambiguous: {alike[0].contradictions} of {alike[0].tested} readings contradict "
            "another place"
        )
    return Localisation(best, runner_up, middle, refusal, places[:_KEPT], is_near)


def _sample(rays: FloatArray) -> FloatArray:
    """The latest of the rays (n, 7), and some of the earlier ones, which lie evenly in time."""
    earlier = rays[:-_LATEST]
    latest = rays[-_LATEST:]
    chosen = np.linspace(0, max(len(earlier) - 1, 0), min(_EARLIER, len(earlier))).astype(int)
    return np.ascontiguousarray(np.concatenate((earlier[chosen], latest)))


def _places(fits: Sequence[PlaceFit], middle: FloatArray) -> list[PlaceFit]:
    """The fit of each place, the best ones first, without places that the readings have refuted."""
    places = [fits[0]]
    for fit in fits[1:]:
        if fit.log_ratio_on_map < -DECIDED:
            break
        if all(are_apart(fit.pose, place.pose, middle) for place in places):
            places.append(fit)
    return places


def are_apart(
    first: FloatArray,
    second: FloatArray,
    middle: FloatArray,
    limits: tuple[float, float] = DRIFT,
) -> bool:
    """Whether two poses (3,) of a drive place its middle (2,), or turn it, differently: by more
    than a distance, m, and an angle, rad.
    """
    shift = transform_points(first, middle[None]) - transform_points(second, middle[None])
    turn = abs(wrap_angle(float(first[2] - second[2])))
    return float(np.hypot(*shift[0])) > limits[0] or turn > limits[1]


def match_covariance(middle: FloatArray, pose: FloatArray) -> FloatArray:
    """Covariance (3, 3) of a pose (3,) that follows from the place of a drive with a middle (2,) in
    the map.

    An error of its turn moves poses that are far from there.
    """
    lever = np.eye(3)
    lever[:2, 2] = middle[1] - pose[1], pose[0] - middle[0]
    return np.asarray(lever @ MATCH_COVARIANCE @ lever.T)


def is_far(pose: FloatArray, middle: FloatArray) -> bool:
    """Whether a pose (3,) of a drive places its middle (2,) so far from where it was believed to
    be, or turns it so, that the robot has not drifted.
    """
    return are_apart(pose, np.zeros(3), middle, FAR)


def agree(first: Localisation, second: Localisation, *, may_be_bent: bool = False) -> bool:
    """Whether two searches in succession find the same place.

    The place must count in the later search, where the test of contradictions is stricter than in a
    single search. It is less strict if the map may be bent: that of a robot that has probably
    drifted, and that of an earlier run, whose furniture may have been moved. In the earlier search,
    the place only has to be the best one: nearly all readings of the two are the same.
    """
    if first.fit is None or second.fit is None or not second.is_accepted:
        return False
    if not (may_be_bent or second.is_near or second.fit.log_ratio_on_unbent_map >= DECIDED):
        return False
    return not are_apart(first.fit.pose, second.fit.pose, second.middle)


def _refusal(best: PlaceFit, runner_up: float, on_map: float) -> str:
    """Why a place does not count, in words; empty if it counts. The test of contradictions must
    give ``on_map``.
    """
    if best.log_ratio_on_map < on_map:
        return f"{best.contradictions} of {best.tested} readings contradict the map there"
    if runner_up > min(best.evidence - LEAD, _LIKENESS * best.evidence):
        return (
            f"ambiguous: another place has an evidence of {runner_up:.0f}, and the best one "
            f"{best.evidence:.0f}"
        )
    return ""


class PlaceSearch:
    """Searches one map.

    Attributes
    ----------
    place
        The map.
    latest
        The latest search; None before the first one.
    """

    def __init__(self, place: KnownPlaces) -> None:
        self.place = place
        self.latest: Localisation | None = None
        self._way = 0.0
        self._refused = 0
        self.begin_anew()

    def begin_anew(self) -> None:
        """The frame of the drive is another one, in which the searches so far mean nothing."""
        self.latest, self._sought = None, self._way + _FIRST - _SPACING

    def drive(self, motion: FloatArray) -> None:
        """Note the motion (3,) of a step."""
        x, y, turn = motion.tolist()
        self._way += math.hypot(x, y) + TURN_LENGTH * abs(turn)

    @property
    def is_due(self) -> bool:
        """Whether the map is to be searched now: less often in a larger map, in which a search
        takes longer.
        """
        return self._way - self._sought >= _SPACING * math.sqrt(self.place.size)

    def wait(self) -> None:
        """Make the next search after the usual way."""
        self._sought = self._way

    def seek(
        self,
        rays: FloatArray,
        far: float = 1.0,
        near: Sequence[PlaceFit] = (),
        *,
        may_be_bent: bool,
    ) -> Localisation | None:
        """Search the map for the place of rays (n, 7); the place if two searches in succession find
        the same one.

        ``far`` and ``near`` are those of :func:`localise`, and ``may_be_bent`` is that of
        :func:`agree`.
        """
        self.wait()
        before = self.latest
        likely = (
            [np.zeros(3), *(fit.pose for fit in before.open)]
            if before is not None
            else [np.zeros(3)]
        )
        self.latest = localise(self.place, rays, likely, far, near)
        self._refused += not self.latest.is_accepted
        is_found = before is not None and agree(before, self.latest, may_be_bent=may_be_bent)
        return self.latest if is_found else None

    @property
    def record(self) -> dict[str, Any]:
        """The latest search as it stands in ``result.json``, and how many searches did not
        count.
        """
        return (
            {} if self.latest is None else {"refused": self._refused, "match": self.latest.record}
        )


def other_place(place: KnownPlaces, rays: FloatArray) -> str:
    """Why rays (n, 7) in the frame of a map may also be elsewhere in it, in words; empty if they
    fit in one place.
    """
    found = localise(place, rays, [np.zeros(3)])
    if found.is_accepted and found.likeness > LARGEST_RUNNER_UP:
        return f"ambiguous: another place has {found.likeness:.0%} of the evidence"
    return found.refusal
