"""Whether readings fit a map: the one likelihood of readings given a map, and the test of their
contradictions.

Each ray (:mod:`~limslam_agent.status.rays`) is compared with what the map predicts for it: a wall
at a distance, free ground, or unknown ground, of which a reading says nothing. The *evidence* of
rays is the logarithm of their likelihood, less that of readings at a random place. A ray
*contradicts* the map if it passes through a wall, or ends where the map is known to be free. Hardly
a ray does so at the right place, and many do at a wrong one, so that the number of contradictions
is tested by a sequential test of their rate (A. Wald, "Sequential tests of statistical hypotheses",
1945).
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_agent.kernels.tables import RAY_LENGTH, RAY_REACH, RAY_TO_X, RAY_X, UNRELATED
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.chance import rate_evidence
from limslam_agent.status.rays import have_ended
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import compose

_MAP_STD = 0.045  # m: standard deviation of a wall's place in the map as seen from a refined pose
# shares of rays that contradict a map at the right place, and at a wrong one
_RIGHT = 0.005
_WRONG = 0.12
_PLACE = 0.3  # m: contradictions less far apart may have one cause
_SHORTEST = 1e-9  # m: a shorter wall has no direction
_SLIPS = np.radians(np.arange(-28.0, 29.0, 4.0))  # turns that the wheels may miss, rad
_DEVIATIONS = (
    -2.0,
    -1.0,
    0.0,
    1.0,
    2.0,
)  # and along each axis of the covariance, in standard deviations
_OWN = 0.5  # part of the pose's standard deviation that the walls near by do not share

DRIFT = 0.5, math.radians(15.0)
"""A robot that is off by less than this, m and rad, may have drifted, whatever its readings say of
its motion.

Two poses that are farther apart are different places.
"""

DOUBTED = math.log(100.0)
DECIDED = math.log(1000.0)
"""Logarithms of likelihood ratios that raise a doubt, and that decide.

By Wald's bound, a test that stops there is wrong in at most one of 100, or of 1000 cases.
"""


MATCH_COVARIANCE = np.diag([0.05, 0.05, math.radians(2.0)]) ** 2
"""Covariance (3, 3) of a pose with respect to the walls around that its readings fit, m^2 and
rad^2.
"""

UNLIKELY = 10.0
"""How unlikely it is beforehand that a robot slips or is carried away just here, or is in one of
all places of a map.

This is a logarithm, without its sign.
"""


def contradiction_test(contradicting: int, tested: int, *, may_be_bent: bool = False) -> float:
    """Logarithm of the likelihood ratio of a wrong place and of the right one, by the number of
    contradictions.

    ``tested`` is the number of rays that could have contradicted the map. A map may be bent, or its
    furniture may have been moved.
    """
    right = UNRELATED if may_be_bent else _RIGHT
    return rate_evidence(contradicting, tested, right, _WRONG)


class Explained(NamedTuple):
    """What a map says of n rays in its frame, each (n,).

    Attributes
    ----------
    evidence
        Logarithm of the likelihood of the reading, less that at a random place.
    against
        Distance along the ray at which it contradicts the map, m; 0 if it does not. It is less than
        the reading if the ray has passed through a wall.
    tested
        Whether it could have contradicted the map.
    """

    evidence: FloatArray
    against: FloatArray
    tested: BoolArray

    def by_place(self, rays: FloatArray) -> FloatArray:
        """What each of the rays (n, 7) contributes (n,) to :func:`contradiction_test`.

        Rays that contradict the map at one place, at a wall that they pass or where they end, count
        once: they may have one cause, as a short wall that is missing.
        """
        test = np.where(self.tested, contradiction_test(0, 1), 0.0)
        against = np.flatnonzero(self.against)
        directions = rays[against, RAY_TO_X:RAY_LENGTH]
        points = rays[against, RAY_X:RAY_TO_X] + self.against[against, None] * directions
        _, first = np.unique(np.floor(points / _PLACE), axis=0, return_index=True)
        test[against] = 0.0
        test[against[first]] = contradiction_test(1, 1)
        return test


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
    def log_ratio_on_map(self) -> float:
        """Logarithm of the likelihood ratio of the contradictions: of the right place in a map that
        may be bent, and of ground like it.
        """
        return -contradiction_test(self.contradictions, self.tested, may_be_bent=True)

    @property
    def log_ratio_on_unbent_map(self) -> float:
        """The same in a map that is not bent."""
        return -contradiction_test(self.contradictions, self.tested)


class KnownMap:
    """A map with which readings are compared.

    Parameters
    ----------
    segments, grid
        Walls (k, 4), m, and occupancy grid, which must not change as long as the map is used.
    sensor
        How the ranges are measured. It may be assigned anew. Their bias is that of the rays.
    free_space_counts
        Whether a reading that ends in free space says something; it does not if a body may be
        anywhere.
    """

    def __init__(
        self,
        segments: FloatArray,
        grid: GridView,
        sensor: RangeSensor,
        *,
        free_space_counts: bool = True,
    ) -> None:
        self.segments = np.ascontiguousarray(segments)
        self.grid = grid
        self.sensor = sensor
        self._free_space_counts = free_space_counts

    @property
    def frozen(self) -> "KnownMap":
        """The map as it is now, which later steps do not change. The values of a grid's view change
        with the grid.
        """
        grid = replace(self.grid, values=self.grid.values.copy())
        return KnownMap(self.segments, grid, self.sensor, free_space_counts=self._free_space_counts)

    def counting(self, rays: FloatArray, covariance: FloatArray | None = None) -> FloatArray:
        """Those of the rays (n, 7) that say something about the pose, whose covariance (3, 3) is
        given.
        """
        if self._free_space_counts:
            return rays
        return rays[self.explained(rays, covariance).against < rays[:, RAY_LENGTH]]

    def weigh(self, poses: FloatArray, rays: FloatArray) -> list[PlaceFit]:
        """How well rays (n, 7) fit the map, for poses (m, 3) of their frame."""
        weights = self._weights(poses, rays)
        evidence = weights[..., 0].sum(axis=1)
        counts = np.count_nonzero(weights[..., 1:], axis=1)
        return [
            PlaceFit(*each)
            for each in zip(poses, evidence.tolist(), *counts.T.tolist(), strict=True)
        ]

    def explained(self, rays: FloatArray, covariance: FloatArray | None = None) -> Explained:
        """What the map says of rays (n, 7) in its frame.

        ``covariance`` (3, 3) is that of the poses of the robot relative to the map; zero without
        it.
        """
        weights = self._weights(np.zeros((1, 3)), rays, covariance)[0]
        return Explained(weights[:, 0], weights[:, 1], weights[:, 2] > 0.0)

    def refined(self, poses: FloatArray, rays: FloatArray) -> FloatArray:
        """Poses (m, 3), moved so that the ends of the rays (n, 7) lie on walls."""
        from limslam_agent.kernels.rays import refine_poses

        ended = rays[have_ended(rays)]
        # Poses of the middle of the rays, which a turn leaves where it is.
        middle = np.array([*rays[:, RAY_X:RAY_TO_X].mean(axis=0), 0.0])
        ended[:, RAY_X:RAY_TO_X] -= middle[:2]
        placed = compose(poses, middle)
        cone = float(self.sensor.cone)
        refine_poses(placed, ended, self._walls, cone, np.empty((3, 3)), np.empty(3))
        return np.asarray(compose(placed, -middle))

    def fit_here(self, rays: FloatArray) -> PlaceFit:
        """How well rays (n, 7) fit the map where they are."""
        return self.weigh(np.zeros((1, 3)), rays)[0]

    @cached_property
    def _walls(self) -> FloatArray:
        """The walls (k, 6) as the kernels take them."""
        starts = self.segments[:, :2]
        along = self.segments[:, 2:] - starts
        lengths = np.hypot(*along.T)
        x, y = along.T / np.maximum(lengths, _SHORTEST)
        return np.column_stack((np.zeros(len(starts)), y, -x, starts, lengths))

    def _weights(
        self, poses: FloatArray, rays: FloatArray, covariance: FloatArray | None = None
    ) -> FloatArray:
        """What the map says of rays (n, 7) at poses (m, 3) of their frame: rows (m, n, 3) of
        ``kernels.rays.weigh_ray``.
        """
        from limslam_agent.kernels.rays import Known, weigh_rays

        grid = self.grid
        variance = _MAP_STD**2
        variance += self.sensor.usual_std(float(rays[:, RAY_REACH].max(initial=0.0))) ** 2
        turning = 0.0
        if covariance is not None:
            variance += float(covariance[0, 0] + covariance[1, 1])
            turning = float(covariance[2, 2])
        known = Known(
            self._walls,
            # One kind of array, or the kernels would be compiled for each kind.
            np.require(grid.values, requirements="W"),
            np.asarray(grid.low),
            float(grid.cell),
            variance,
            turning,
            float(self.sensor.cone),
        )
        weights = np.empty((len(poses), len(rays), 3))
        weigh_rays(np.ascontiguousarray(poses), rays, known, weights)
        return weights


class NearFit(NamedTuple):
    """The likeliest pose of a drive near the believed pose: how its rays fit there, and the cost of
    being off so far.

    The cost is half the squared Mahalanobis distance.
    """

    fit: PlaceFit
    cost: float

    @property
    def evidence(self) -> float:
        """Evidence of the rays, less the cost."""
        return self.fit.evidence - self.cost


def drift_fit(
    known: KnownMap, rays: FloatArray, covariance: FloatArray, others: FloatArray | None = None
) -> NearFit:
    """The likeliest pose of rays (n, 7) by the covariance (3, 3) of the believed pose, the origin.

    Of this covariance, only the part counts that the walls near by do not share. Without rays, the
    believed pose is as likely as any. ``others`` (m, 3) are further poses that may be the likeliest
    one.
    """
    if not len(rays):
        return NearFit(known.fit_here(rays), 0.0)
    middle = rays[:, :2].mean(axis=0)
    about = np.array([*middle, 0.0])
    back = np.array([*-middle, 0.0])
    spread = _OWN**2 * covariance + MATCH_COVARIANCE
    variances, axes = np.linalg.eigh(spread)
    likely = np.array(list(product(_DEVIATIONS, repeat=3))) * np.sqrt(variances) @ axes.T
    starts = compose(compose(about, likely), back)
    # With few rays, a refinement may lead away from the right pose.
    poses = np.concatenate(
        (starts, known.refined(starts, rays), np.empty((0, 3)) if others is None else others)
    )
    off = compose(compose(back, poses), about)
    costs = 0.5 * np.einsum("ni,ij,nj->n", off, np.linalg.inv(spread), off)
    found = map(NearFit, known.weigh(poses, rays), costs.tolist())
    return max(found, key=lambda each: each.evidence)


def slip_fit(known: KnownMap, rays: FloatArray) -> NearFit:
    """The likeliest pose of rays (n, 7), at least one, if the robot has turned where the first of
    them begins, and its wheels have not reported that.
    """
    about = np.array([*rays[0, :2], 0.0])
    turned = np.column_stack((np.zeros((len(_SLIPS), 2)), _SLIPS))
    fits = known.weigh(compose(compose(about, turned), -about), rays)
    best = max(fits, key=lambda fit: fit.evidence)
    (refined,) = known.weigh(known.refined(best.pose[None], rays), rays)
    return NearFit(max(best, refined, key=lambda fit: fit.evidence), UNLIKELY)
