"""Readings of range sensors and wheel encoders: noise, resolution and limits."""

import math

from limslam_env.compilation import merged
from limslam_env.kernels.rays import NOTHING


@merged
def noisy_reading(
    ideal: float,
    hit: int,
    shortest: float,
    longest: float,
    deviation: float,
    growth: float,
    dropout: float,
    resolution: float,
    fold_back: float,
    normal: float,
    uniform: float,
) -> float:
    """The reading (m) of a beam for a true distance ``ideal`` (m), with random numbers from N(0, 1) and U(0, 1).

    Noise: standard deviation (m), its growth (1/m, times the squared range), chance of a dropout,
    resolution (m) and fold-back (m per metre nearer than ``shortest``). A beam that hits nothing reads
    ``longest`` exactly.
    """
    if hit == NOTHING or uniform < dropout:
        return longest
    std = math.hypot(deviation, growth * ideal * ideal) if growth > 0.0 else deviation
    folds = fold_back > 0.0 and ideal < shortest
    reading = (shortest + fold_back * (shortest - ideal) if folds else ideal) + std * normal
    if resolution > 0.0:
        reading = math.floor(reading / resolution + 0.5) * resolution
    return min(max(reading, shortest), longest)


@merged
def reported_travel(
    travel: float, unreported: float, factor: float, variance: float, resolution: float, limit: float, normal: float
) -> tuple[float, float]:
    """The travel (m) that an encoder reports of a wheel's ``travel`` (m), and the remainder for later reports (m).

    It counts ``factor`` times the travel, with noise of ``variance`` per metre from the N(0, 1) number ``normal``,
    and what was ``unreported`` so far (m); no more than ``limit`` (m) at once. Its ticks are ``resolution`` (m; 0 for
    none) apart and stay where they are on the wheel: driving back over a tick takes it away again.
    """
    counted = travel * factor + math.sqrt(variance * abs(travel)) * normal + unreported
    reported = math.floor(counted / resolution) * resolution if resolution > 0.0 else counted
    reported = min(max(reported, -limit), limit)
    return reported, counted - reported
