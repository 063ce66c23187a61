"""Ticks of encoders: what a wheel has travelled beyond its last tick is reported later.

A pose that is the sum of all reports is off by parts of ticks, which do not add up from step to
step. So this jitter is no noise of the motion, but is added to the covariance of each pose that
readings were taken from, and of each that is reported. The tick need not be known beforehand, since
all reported travels are multiples of it.

The functions are plain, and a batch compiles them.
"""

import functools

import numpy as np

from limslam_env.geometry import FloatArray

_FINEST = 1e-5  # m: travels are multiples of a tick if they are so to within this


def tick_by(tick: float, travel: float) -> float:
    """The tick of an encoder, m: the greatest length of which all travels are multiples.

    ``tick`` is the result for the travels before, at first 0, and ``travel`` is the next one, m.
    The tick is negative while all travels were the same, since one travel says nothing of it. Nor
    does a wheel that stands: it may as well drive at one exact speed in between.
    """
    known = abs(travel)
    rest = abs(tick)
    if known <= _FINEST:
        return tick
    if rest <= _FINEST or abs(known + tick) <= _FINEST:
        return -known
    while rest > _FINEST:
        known, rest = rest, abs(known - round(known / rest) * rest)
    return known


def ticks_of(wheels: FloatArray) -> FloatArray:
    """The ticks (n, 2) of the encoders of n robots, m, by all their travels (t, n, 2), m."""
    ticks = np.zeros(wheels.shape[1:])
    for place in np.ndindex(ticks.shape):
        for travel in np.unique(wheels[(slice(None), *place)]).tolist():
            ticks[place] = tick_by(float(ticks[place]), travel)
    return ticks


def tick_variances(ticks: FloatArray) -> FloatArray:
    """Variances (...) of what wheels have travelled beyond their last ticks (...), m^2."""
    return np.maximum(ticks, 0.0) ** 2 / 12.0


def jitter_of(ticks: FloatArray, axle: float) -> FloatArray:
    """Covariance (3, 3) of a pose, in its frame, about the sum of what encoders with ticks (2,), m,
    have reported.
    """
    by_wheels = np.array([[0.5, 0.0, -1.0 / axle], [0.5, 0.0, 1.0 / axle]])
    return np.asarray(by_wheels.T @ (tick_variances(ticks).reshape(2, 1) * by_wheels))


@functools.lru_cache
def known_jitter(left: float, right: float, axle: float) -> FloatArray:
    """:func:`jitter_of` the encoders' ticks, m, which seldom change: read-only."""
    jitter = jitter_of(np.array([left, right]), axle)
    jitter.setflags(write=False)
    return jitter


def first_jitter(before: FloatArray, ticks: FloatArray, axle: float) -> FloatArray:
    """Covariance (3, 3) to add to that of the motion in which ticks (2,) are found that were not
    ``before`` (2,).

    At its start, a robot does not know how far its wheels have been beyond a tick.
    """
    return jitter_of(np.where(before > 0.0, 0.0, ticks), axle)
