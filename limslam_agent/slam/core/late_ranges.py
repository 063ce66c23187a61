"""Ranges that are later than the wheels: the wheels' travel waits for them, and the poses go ahead
again.

Each reading then belongs to the pose of its step, and nothing else need know of the delay.
"""

from collections.abc import Sequence

import numpy as np

from limslam_agent.readings import unsteadiness
from limslam_agent.slam.core.front_end import yaw_of
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose, inverse
from limslam_env.interface import Observation, RobotSpec

LONGEST = 10.0
"""Largest delay, in steps."""


def held_back(wheels: FloatArray, delay: float) -> FloatArray:
    """The travel (t, n, 2) of the wheels of n robots in each step, m, delayed by a number of
    steps.
    """
    totals = np.concatenate((np.zeros_like(wheels[:1]), np.cumsum(wheels, axis=0)))
    return np.diff(_totals_at(totals, np.arange(float(len(totals))) - delay), axis=0)


def headings_held_back(yaw: FloatArray, delay: float) -> FloatArray:
    """Headings (t, n) of n robots, rad, delayed by a number of steps; NaN where one of the two
    readings around a time is missing.
    """
    start = np.full_like(yaw[:1], np.nan)
    totals = np.exp(1j * np.concatenate((start, yaw)))
    return np.angle(_totals_at(totals, np.arange(1.0, len(totals)) - delay))


def ahead(poses: FloatArray, waiting: FloatArray, axle: float) -> FloatArray:
    """Poses (..., 3) after a travel (..., 2) of the wheels, m, as one arc on an axle, m."""
    return np.asarray(compose(poses, _arcs(waiting, axle)))


def behind(poses: FloatArray, waiting: FloatArray, axle: float) -> FloatArray:
    """Poses (..., 3) before a travel (..., 2) of the wheels; see :func:`ahead`."""
    return np.asarray(compose(poses, inverse(_arcs(waiting, axle))))


class WaitingTravel:
    """The travel of the wheels of n robots that waits for late ranges.

    How much the travel of a wheel changes from step to step is that of a ``robot``.

    Attributes
    ----------
    travel
        Travel (n, 2) that waits, m.
    """

    def __init__(self, robots: int, robot: RobotSpec | None = None) -> None:
        self._totals = [np.zeros((robots, 2))]
        self._last = self._totals[0]
        self._missing = np.zeros((robots, 2))
        self._unsteady = unsteadiness(robot or RobotSpec())
        self._given = self.travel = self._totals[0]
        self._yaw: list[FloatArray] = []

    def synchronous(
        self, observations: Sequence[Observation], delay: float
    ) -> Sequence[Observation]:
        """The observations of the next step, with travel that waits for ranges that are late by so
        many steps.

        The delay may change from step to step.
        """
        if not (observations and all("wheels" in seen for seen in observations)):
            return observations
        observations = self._driven(observations)
        total = self._totals[-1] + np.array([seen["wheels"] for seen in observations], dtype=float)
        self._totals = [*self._totals[-int(LONGEST) - 1 :], total]
        yaw = np.array([yaw_of(seen) for seen in observations])
        self._yaw = [*self._yaw[-int(LONGEST) - 1 :], yaw]
        if not (delay or self.travel.any()):
            self._given = total
            return observations
        before = self._given
        place = np.array([len(self._totals) - 1.0 - delay])
        self._given = _totals_at(np.array(self._totals), place)[0]
        self.travel = total - self._given
        headings = headings_held_back(np.array(self._yaw), delay)[-1].tolist()
        return [
            _waited(seen, travel, yaw)
            for seen, travel, yaw in zip(observations, self._given - before, headings, strict=True)
        ]

    def _driven(self, observations: Sequence[Observation]) -> Sequence[Observation]:
        """The observations with the travel of wheels whose travel is not known: they go on at their
        last speed.
        """
        wheels = np.array([seen["wheels"] for seen in observations], dtype=float)
        is_missing = np.isnan(wheels)
        self._last = np.where(is_missing, self._last, wheels)
        self._missing = np.where(is_missing, self._missing + 1.0, 0.0)
        variances = self._unsteady * self._missing**2
        return [
            Observation(**{**seen, "wheels": moved, "wheel_variances": more})
            if more.any()
            else seen
            for seen, moved, more in zip(observations, self._last, variances, strict=True)
        ]


def _waited(observation: Observation, travel: FloatArray, yaw: float) -> Observation:
    """An observation with travel, m, and a heading, rad, that have waited for its ranges."""
    waited = Observation(**{**observation, "wheels": travel})
    if "yaw" in observation:
        waited["yaw"] = yaw
    return waited


def _totals_at(totals: FloatArray, places: FloatArray) -> FloatArray:
    """Totals (m, ...) at places (m,) between those of totals (t, ...); the first one before
    them.
    """
    places = np.maximum(places, 0.0)
    first = places.astype(np.int64)
    second = np.minimum(first + 1, len(totals) - 1)
    shares = (places - first).reshape(-1, *(1,) * (totals.ndim - 1))
    return np.asarray(totals[first] + shares * (totals[second] - totals[first]))


def _arcs(travel: FloatArray, axle: float) -> FloatArray:
    """The poses (..., 3) to which travel (..., 2) of the wheels leads from the origin."""
    distance = 0.5 * travel.sum(axis=-1)
    turn = (travel[..., 1] - travel[..., 0]) / axle
    chord = distance * np.sinc(0.5 * turn / np.pi)
    return np.stack((chord * np.cos(0.5 * turn), chord * np.sin(0.5 * turn), turn), axis=-1)
