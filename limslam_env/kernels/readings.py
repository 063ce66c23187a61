"""The tables of beams and of noise that kernels read; readings of range sensors and wheel encoders;
slip of wheels.
"""

import math

from limslam_env.compilation import inlined, merged
from limslam_env.geometry import FloatArray

NOTHING = -1
ROBOT = -2
"""What a beam hits that hits no wall."""

FROM_X, FROM_Y, TOWARDS_X, TOWARDS_Y, _, _, ANGLE, LONGEST_RANGE = range(8)
OFFSET, SHORTEST_RANGE, PERIOD, PHASE = range(8, 12)
"""Columns of a table of beams (n_beams, 12), of which the first are those of
``RobotSpec.beam_table``: origin (m) and direction as a unit vector in the robot's frame, angle
(rad), longest reading (m), how far before its origin a ray starts (m), shortest reading (m), and
period and phase in steps.
"""

RANGE_STD, STD_GROWTH, DROPOUT, RANGE_RESOLUTION, FOLD_BACK, CONE = range(6)
"""Columns of a table of noise for the range sensors: what :func:`noisy_reading` needs,
and half the opening angle of the beams, rad."""

LEFT_WHEEL, RIGHT_WHEEL, WHEEL_VARIANCE, ENCODER_RESOLUTION, LARGEST_TRAVEL = range(6, 11)
"""Columns of the same table for the encoders: the factor of each wheel, and what follows it in
:func:`reported_travel`."""

SLIP_RATE, SLIP_SHARE, TRUE_AXLE = range(11, 14)
"""Further columns: slips per metre, the share of the travel that a slip takes, and the true
distance between the wheels, m.
"""

NUM_NOISES = 14
"""Number of columns of the table of noise."""


@inlined
def is_due(beams: FloatArray, number: int, step: int) -> bool:
    """Whether a beam measures in a step; 0 is the reset, in which all do."""
    period = beams[number, PERIOD]
    phase = beams[number, PHASE]
    return period == 1.0 or step == 0 or step % int(period) == int(phase)


@inlined
def way_over_ground(turn: float, rate: float, share: float, uniform: float) -> float:
    """How far a wheel moves over the ground, m, that turns by ``turn``, m: less when it slips.

    Slips are a Poisson process along the path: ``rate`` per metre, each of which takes a ``share``
    of the way. ``uniform`` is a random number from U(0, 1).
    """
    return turn * (1.0 - share) if uniform < -math.expm1(-rate * abs(turn)) else turn


@merged
def noisy_reading(
    ideal: float,
    hit: int,
    beams: FloatArray,
    number: int,
    noise: FloatArray,
    normal: float,
    uniform: float,
) -> float:
    """The reading (m) of a beam for a true distance ``ideal`` (m), with random numbers from N(0, 1)
    and U(0, 1).

    ``noise`` (14,) has the standard deviation (m), its growth (1/m, times the squared range), the
    chance of a dropout, resolution (m) and fold-back (m per metre nearer than the shortest
    reading). A beam that hits nothing has its longest reading exactly.
    """
    shortest: float = beams[number, SHORTEST_RANGE]
    longest: float = beams[number, LONGEST_RANGE]
    if hit == NOTHING or uniform < noise[DROPOUT]:
        return longest
    std = noise[RANGE_STD]
    if noise[STD_GROWTH] > 0.0:
        std = math.hypot(std, noise[STD_GROWTH] * ideal * ideal)
    folds = noise[FOLD_BACK] > 0.0 and ideal < shortest
    reading: float = (
        shortest + noise[FOLD_BACK] * (shortest - ideal) if folds else ideal
    ) + std * normal
    resolution: float = noise[RANGE_RESOLUTION]
    if resolution > 0.0:
        reading = math.floor(reading / resolution + 0.5) * resolution
    return min(max(reading, shortest), longest)


@merged
def reported_travel(
    travel: float,
    unreported: float,
    factor: float,
    variance: float,
    resolution: float,
    limit: float,
    normal: float,
) -> tuple[float, float]:
    """The travel (m) that an encoder reports of a wheel's ``travel`` (m), and the remainder for
    later reports (m).

    It counts ``factor`` times the travel, with noise of ``variance`` per metre from the N(0, 1)
    number ``normal``, and what was ``unreported`` so far (m); no more than ``limit`` (m) at once.
    Its ticks are ``resolution`` (m; 0 for none) apart and stay where they are on the wheel: driving
    back over a tick takes it away again.
    """
    counted = travel * factor + math.sqrt(variance * abs(travel)) * normal + unreported
    reported = math.floor(counted / resolution) * resolution if resolution > 0.0 else counted
    reported = min(max(reported, -limit), limit)
    return reported, counted - reported
