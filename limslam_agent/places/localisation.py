"""The place of a drive in a map, by the likelihood of its readings.

Each ray of the drive (:mod:`~limslam_agent.places.rays`) is compared with what the map predicts for it: a wall at a
distance, free ground, or unknown ground, of which a reading says nothing. The evidence of a pose of the drive is the
logarithm of the likelihood of all readings there, less that at a random place. Poses on a grid are weighed roughly, the
best of them are refined, and these are weighed exactly.

A place counts by two likelihood ratios. Against all other places of the map, its evidence must lead. Against ground
that the map does not have, and that may look alike, hardly a ray may contradict the map: a sequential test of their
rate (A. Wald, "Sequential tests of statistical hypotheses", 1945). Rays on unknown ground take part in neither.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from limslam_agent.grid.occupancy import GridView
from limslam_agent.kernels.tables import RAY_REACH, RAY_TO_X, RAY_X
from limslam_agent.places.matching import are_apart
from limslam_agent.places.rays import have_ended
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.contradictions import log_likelihood_ratio
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import compose, transform_points, wrap_angle
from limslam_env.geometry.segment import sample

_CELL = 0.05  # m: of the rough search
_GROUND = 100.0  # m^2: the following numbers of poses are those of a map with so much ground, and grow with it
_EVERY, _TURNS = 2, 72  # every second row and column is tried, and this number of turns
_MARGIN = 1.0  # m: the middle of a drive may lie so far outside of free ground
_LATEST, _EARLIER, _POSES = 60, 60, 2000  # number of rays in the rough search, and of its best poses
_REFINED, _FEWEST = 60, 150  # number of poses that are refined: by the ground, and in a small map
_SPREAD = 0.25, math.radians(12.0)  # how far these poses are apart
_KEPT = 20  # number of places that are tried again in the next search
_WALL, _HIT, _MISS = 0.20, (2.5, 1.3), -8.0  # m, and evidence of a ray's end at a wall, and in free ground
_CROSSED, _FREE = -6.0, 0.2  # evidence of a ray's way through a wall, and through free ground
_MAP_STD = 0.045  # m: standard deviation of a wall's place in the map as seen from a refined pose
_LIKENESS = 0.85  # largest share that the evidence of another place has of that of the best one
_ALIKE = 2.0  # a place is a rival if its test of contradictions speaks less for it by less than this
_UNLIKELY = 12.0  # logarithm of the number of places that a map has
_NEAR, _NEAR_TURN = 0.5, math.radians(15.0)  # m, rad: a robot that is off by less than this may have drifted
_STARTS = (-0.3, 0.0, 0.3), (-math.radians(8.0), 0.0, math.radians(8.0))  # m, rad: where poses near by are looked for
_DEVIATIONS = -2.0, -1.0, 0.0, 1.0, 2.0  # and along each axis of the covariance, in standard deviations
_LIKELY = 4.5  # a pose with at most this cost is near, however far it is: 3 standard deviations
_LEAST_STD, _LEAST_TURN = 0.05, math.radians(1.0)  # m, rad: least deviation of the pose with respect to the map
_OWN = 0.5  # part of the pose's standard deviation that the walls near by do not share
_RIGHT, _WRONG = 0.02, 0.12  # shares of rays that contradict the map at the right place, and on ground that it lacks
# The first share for a robot that was carried away. It is 0.0004 in simulated buildings. Ground that looks alike may
# pass the test with the larger share, which bent maps need.
_RIGHT_IF_CARRIED = 0.005
_FOUND = 7.0  # least logarithm of the likelihood ratio of the contradictions at the place of a lost robot

LEAD = 25.0
"""Least difference between the evidence of a place and that of every other place."""

ON_MAP = 6.0
"""Least logarithm of the likelihood ratio of the contradictions at a place: of the right place, and of ground that the
map does not have.
"""

FAR_SHARE = 0.3
"""For what share of its evidence a place counts that is far from the believed one, if nothing says that the robot was
carried away.
"""

FAR = 1.5, math.radians(30.0)
"""A robot that is off by more than this, m and rad, has not drifted, but was carried."""

DRIFT = 0.5, math.radians(15.0)
"""A robot that is off by less than this, m and rad, has drifted, whatever its readings say of its motion."""


class KnownPlaces:
    """A map as it is searched for the place of a drive.

    Parameters
    ----------
    segments, grid
        Walls (k, 4), m, and occupancy grid, which must not change any more.
    sensor
        How the ranges are measured. It may be assigned anew. Their bias is that of the rays.
    """

    def __init__(self, segments: FloatArray, grid: GridView, sensor: RangeSensor) -> None:
        self.segments, self.grid, self.sensor = np.ascontiguousarray(segments), grid, sensor

    @cached_property
    def size(self) -> float:
        """Ground of the map in units of a small map's, at least 1. The time of a search grows with it.

        A large map has so many places that are alike along their walls that the true place may be far behind the best
        ones of a rough search. So the number of places that are weighed exactly grows with the map.
        """
        return max(1.0, np.count_nonzero(self._rough[2]) * (_EVERY * _CELL) ** 2 / _GROUND)

    def weigh(self, poses: FloatArray, rays: FloatArray) -> list["PlaceFit"]:
        """How well rays (n, 6) fit the map, for poses (m, 3) of their frame."""
        from limslam_agent.kernels.rays import weigh_poses

        evidence, counts = np.empty(len(poses)), np.empty((len(poses), 2), dtype=np.int64)
        std = math.hypot(_MAP_STD, self.sensor.usual_std(float(rays[:, RAY_REACH].max(initial=0.0))))
        weigh_poses(
            np.ascontiguousarray(poses), rays, self.segments, np.empty((len(self.segments), 5)), self.grid.values,
            np.asarray(self.grid.low), self.grid.cell, std, float(self.sensor.cone), evidence, counts,
        )  # fmt: skip
        return [PlaceFit(*each) for each in zip(poses, evidence.tolist(), *counts.T.tolist(), strict=True)]

    def refined(self, poses: FloatArray, rays: FloatArray) -> FloatArray:
        """Poses (m, 3), moved so that the ends of the rays (n, 6) lie on walls."""
        from limslam_agent.kernels.rays import refine_poses

        ended, walls = rays[have_ended(rays)], np.empty((len(self.segments), 5))
        # Poses of the middle of the rays, which a turn leaves where it is.
        middle = np.array([*rays[:, RAY_X:RAY_TO_X].mean(axis=0), 0.0])
        ended[:, RAY_X:RAY_TO_X] -= middle[:2]
        placed = compose(poses, middle)
        refine_poses(placed, ended, self.segments, float(self.sensor.cone), walls, np.empty((3, 3)), np.empty(3))
        return np.asarray(compose(placed, -middle))

    def likely(self, rays: FloatArray) -> FloatArray:
        """Poses (m, 3) at which the rays (n, 6) may fit, by a rough search of the whole map.

        The latest rays take part, and some of the earlier ones: the robot may have left the ground of the map again.
        Contradictions cost much, because the right place of a robot that has seen little of this ground has fewer
        fitting rays than many wrong places.
        """
        from limslam_agent.kernels.rays import choose_apart, scan_poses

        low, fields, is_tried = self._rough
        some = _sample(rays)
        middle, turns = some[:, :2].mean(axis=0), np.linspace(0.0, 2.0 * np.pi, _TURNS, endpoint=False)
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
        """The map of the rough search: its corner, the evidence of ends and ways as :func:`scan_poses` takes it, and
        the places to try.
        """
        low: FloatArray = np.asarray(self.grid.low - _MARGIN, dtype=np.float64)
        size = np.array(self.grid.values.shape) * self.grid.cell + 2.0 * _MARGIN
        rows, columns = (_EVERY * np.ceil(size / (_EVERY * _CELL))).astype(int)
        cells = np.indices((rows, columns)).reshape(2, -1).T
        centres = low + (cells[:, ::-1] + 0.5) * _CELL
        free: BoolArray = (self.grid.values_at(centres) > 0).reshape(rows, columns)
        is_open = np.ones(free.shape, dtype=bool)
        walls = np.floor((sample(self.segments, 0.7 * _CELL)[0] - low) / _CELL).astype(np.int64)[:, ::-1]
        walls = walls[np.all((walls >= 0) & (walls < free.shape), axis=1)]
        is_open[walls[:, 0], walls[:, 1]] = False
        away = distance_transform_edt(is_open) * _CELL
        at_wall = _HIT[0] - (_HIT[0] - _HIT[1]) * (away / _WALL) ** 2
        ends = np.where(away < _WALL, at_wall, np.where(free & (away > 0.25), _MISS, 0.0))
        ways = np.where(away < 0.8 * _CELL, _CROSSED, np.where(free, _FREE, 0.0))
        fields = np.stack((ends, ways)).astype(np.float32).reshape(2, rows // _EVERY, _EVERY, columns // _EVERY, _EVERY)
        is_tried = distance_transform_edt(~free)[::_EVERY, ::_EVERY] * _CELL < _MARGIN
        return low, np.ascontiguousarray(fields.transpose(0, 2, 4, 1, 3)), is_tried


@dataclass(frozen=True, eq=False)
class PlaceFit:
    """A pose of a drive's frame in a map, and how well its rays agree with the map there.

    Attributes
    ----------
    pose
        The pose (3,), m and rad.
    evidence
        Logarithm of the likelihood of the readings, less that at a random place.
    contradictions, tested
        Number of rays that contradict the map, and of those that could have done so.
    """

    pose: FloatArray
    evidence: float
    contradictions: int
    tested: int

    @property
    def is_on_map(self) -> float:
        """Logarithm of the likelihood ratio of the contradictions: of the right place, and of ground like it."""
        return self._on_map_if(_RIGHT)

    @property
    def is_clearly_on_map(self) -> bool:
        """Whether so few rays contradict the map that a robot that was carried away may be placed here."""
        return min(self.is_on_map, self._on_map_if(_RIGHT_IF_CARRIED)) >= _FOUND

    def _on_map_if(self, right: float) -> float:
        """The logarithm of the likelihood ratio if a share ``right`` of the rays contradicts the map at its place."""
        return log_likelihood_ratio(self.contradictions, self.tested, right, _WRONG)

    @property
    def log_odds(self) -> float:
        """Logarithm of the ratio of the probabilities of this place, and of ground that the map does not have.

        Many places are possible, and each is as unlikely beforehand. The evidence is that of a random place, and that
        of ground that looks alike is larger.
        """
        return min(self.evidence - _UNLIKELY, self.is_on_map)


@dataclass(frozen=True, eq=False)
class Localisation:
    """The best place of a drive in a map, and whether it counts.

    Attributes
    ----------
    fit
        The best place; None if there is none.
    runner_up
        The largest evidence of another place, at least 0, which is that of a random place. It is larger by so much as
        the best place counts for less.
    middle
        Middle (2,) of the drive, m, in its own frame.
    refusal
        Why the place does not count, in words. Empty if it counts.
    open
        The best places that the readings have not refuted. With more readings, each of them may be the right one.
    is_near
        Whether the best place is near the believed pose, and the robot has probably drifted. Ground that the map does
        not have is unlikely then, and the contradictions need only not speak against the place.
    """

    fit: PlaceFit | None
    runner_up: float
    middle: FloatArray
    refusal: str
    open: Sequence[PlaceFit] = ()
    is_near: bool = False

    @property
    def is_accepted(self) -> bool:
        """Whether the place counts."""
        return not self.refusal

    @property
    def likeness(self) -> float:
        """The evidence of the best other place, as a share of the largest evidence."""
        return 1.0 if self.fit is None or self.fit.evidence <= 0.0 else self.runner_up / self.fit.evidence

    @property
    def record(self) -> dict[str, Any]:
        """The place as it stands in ``result.json``."""
        fit = self.fit
        figures = {} if fit is None else {
            "pose": fit.pose.tolist(), "evidence": fit.evidence, "runner_up": self.runner_up,
            "contradictions": fit.contradictions, "tested": fit.tested,
        }  # fmt: skip
        return {**figures, "accepted": self.is_accepted, "reason": self.refusal or "the readings fit in one place only"}


def localise(
    known: KnownPlaces,
    rays: FloatArray,
    before: Sequence[FloatArray] = (),
    far: float = 1.0,
    near: Sequence["PlaceFit"] = (),
) -> Localisation:
    """Search a map for the place of a drive, and decide whether it counts.

    Parameters
    ----------
    rays
        Rays (n, 6) of the drive.
    before
        Poses (3,) that were likely before.
    far
        For what share of its evidence a place counts that is far from the pose that was believed, the origin. It is
        less than 1 for a robot that has probably drifted, and was not carried away.
    near
        Places near the believed pose, which are compared with the others as they are. A search of the whole map may
        miss them.
    """
    if not len(rays) or not len(known.segments):
        return Localisation(None, 0.0, np.zeros(2), "there is nothing to compare")
    middle = rays[:, :2].mean(axis=0)
    likely = np.concatenate((known.likely(rays), np.array(before).reshape(-1, 3)))
    fits = [*known.weigh(known.refined(likely, rays), rays), *near]
    if not fits:
        return Localisation(None, 0.0, middle, "the readings fit nowhere")
    shares = {id(fit): far if is_far(fit.pose, middle) else 1.0 for fit in fits}
    # Where the test of contradictions has said that the drive is not there, chance fits count no more.
    fits.sort(key=lambda fit: (fit.is_on_map < -ON_MAP, -fit.evidence * shares[id(fit)]))
    places = _places(fits, middle)
    best, share = places[0], shares[id(places[0])]
    is_near = far < 1.0 and share == 1.0
    # A far place is compared with others that count in full, and a near one with far ones that do not.
    rivals = [fit.evidence * (1.0 if share < 1.0 else shares[id(fit)]) for fit in places[1:]]
    runner_up = max([0.0, *rivals]) / share if share > 0.0 else math.inf
    refusal = _refusal(best, runner_up, 0.0 if is_near else ON_MAP)
    # The readings of a drive that has left the ground of the map say little there, and may fit where rooms look alike.
    alike = [fit for fit in places[1:] if shares[id(fit)] >= share and fit.is_on_map > best.is_on_map - _ALIKE]
    if alike and not refusal:
        refusal = f"ambiguous: {alike[0].contradictions} of {alike[0].tested} readings contradict another place"
    return Localisation(best, runner_up, middle, refusal, places[:_KEPT], is_near)


class NearFit(NamedTuple):
    """The likeliest pose of a drive near the believed pose: how its rays fit there, and the cost of being off so far.

    The cost is half the squared Mahalanobis distance.
    """

    fit: PlaceFit
    cost: float

    @property
    def evidence(self) -> float:
        """Evidence of the rays, less the cost."""
        return self.fit.evidence - self.cost


def near_fit(known: KnownPlaces, rays: FloatArray, covariance: FloatArray) -> NearFit:
    """The likeliest pose of rays (n, 6) near the believed pose, the origin, whose covariance (3, 3) is given.

    A pose is near within 0.5 m and 15 degrees, or within 3 standard deviations of the part of the pose's error that the
    walls near by do not share. Without rays, the believed pose is as likely as any.
    """
    if not len(rays):
        return NearFit(known.weigh(np.zeros((1, 3)), rays)[0], 0.0)
    middle = rays[:, :2].mean(axis=0)
    about, back = np.array([*middle, 0.0]), np.array([*-middle, 0.0])
    spread = _OWN**2 * covariance + np.diag([_LEAST_STD**2, _LEAST_STD**2, _LEAST_TURN**2])
    variances, axes = np.linalg.eigh(spread)
    likely = np.array(list(product(_DEVIATIONS, repeat=3))) * np.sqrt(variances) @ axes.T
    grid = np.array(list(product(_STARTS[0], _STARTS[0], _STARTS[1])))
    starts = compose(compose(about, np.concatenate((likely, grid))), back)
    # With few rays, a refinement may lead away from the right pose.
    poses = np.concatenate((starts[: len(likely)], known.refined(starts, rays)))
    off = compose(compose(back, poses), about)
    costs = 0.5 * np.einsum("ni,ij,nj->n", off, np.linalg.inv(spread), off)
    is_near = ((np.hypot(off[:, 0], off[:, 1]) < _NEAR) & (np.abs(off[:, 2]) < _NEAR_TURN)) | (costs < _LIKELY)
    found = map(NearFit, known.weigh(poses[is_near], rays), costs[is_near].tolist())
    return max(found, key=lambda each: each.evidence)


def _sample(rays: FloatArray) -> FloatArray:
    """The latest of the rays (n, 6), and some of the earlier ones, which lie evenly in time."""
    earlier, latest = rays[:-_LATEST], rays[-_LATEST:]
    chosen = np.linspace(0, max(len(earlier) - 1, 0), min(_EARLIER, len(earlier))).astype(int)
    return np.ascontiguousarray(np.concatenate((earlier[chosen], latest)))


def _places(fits: Sequence[PlaceFit], middle: FloatArray) -> list[PlaceFit]:
    """The fit of each place, the best ones first, without places that the readings have refuted."""
    places = [fits[0]]
    for fit in fits[1:]:
        if fit.is_on_map < -ON_MAP:
            break
        if all(are_apart(fit.pose, place.pose, middle) for place in places):
            places.append(fit)
    return places


def is_far(pose: FloatArray, middle: FloatArray, most: float = FAR[0], turn: float = FAR[1]) -> bool:
    """Whether a pose (3,) of a drive places its middle (2,) so far from where it was believed to be, or turns it so.

    That is by more than a distance ``most``, m, or an angle ``turn``, rad.
    """
    shift = transform_points(pose, middle[None])[0] - middle
    return float(np.hypot(*shift)) > most or abs(wrap_angle(float(pose[2]))) > turn


def agree(first: Localisation, second: Localisation, *, may_be_bent: bool = False) -> bool:
    """Whether two searches in succession find the same place.

    The place must count in the later search, where the test of contradictions is stricter than in a single search. It
    is less strict if the map may be bent: that of a robot that has probably drifted, and that of an earlier run, whose
    furniture may have been moved. In the earlier search, the place only has to be the best one: nearly all readings of
    the two are the same.
    """
    if first.fit is None or second.fit is None or not second.is_accepted:
        return False
    is_on_map = second.fit.is_on_map >= _FOUND if may_be_bent else second.fit.is_clearly_on_map
    if not second.is_near and not is_on_map:
        return False
    return not are_apart(first.fit.pose, second.fit.pose, second.middle)


def _refusal(best: PlaceFit, runner_up: float, on_map: float) -> str:
    """Why a place does not count, in words; empty if it counts. The test of contradictions must give ``on_map``."""
    if best.is_on_map < on_map:
        return f"{best.contradictions} of {best.tested} readings contradict the map there"
    if runner_up > min(best.evidence - LEAD, _LIKENESS * best.evidence):
        return f"ambiguous: another place has an evidence of {runner_up:.0f}, and the best one {best.evidence:.0f}"
    return ""
