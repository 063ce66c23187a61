"""Readings that change at once although the robot hardly moves, as when it is carried away."""

import numpy as np

from limslam_agent.config.status import SuddenChangeConfig
from limslam_env.geometry import BoolArray, FloatArray


def changed_at_once(
    ranges: FloatArray, measured: BoolArray, motions: FloatArray, range_std: float, config: SuddenChangeConfig
) -> tuple[int, int, int]:
    """The largest number of readings that changed suddenly in one step, the number of readings, and the step after.

    Parameters
    ----------
    ranges, measured
        Readings of m + 1 steps (m + 1, n_beams), m, and a mask of the new readings.
    motions
        Length and angle of the motion between two steps (m, 2), m and rad, without signs.
    range_std
        Standard deviation of a range, m.
    """
    both = measured[1:] & measured[:-1]
    is_still = (motions[:, 0] <= config.max_distance) & (motions[:, 1] <= config.max_turn)
    has_changed = both & (np.abs(np.diff(ranges, axis=0)) > config.change + config.sigmas * range_std)
    counts = np.where(is_still, np.count_nonzero(has_changed, axis=1), 0)
    most = int(counts.argmax())
    return int(counts[most]), int(np.count_nonzero(both[most])), most + 1


def passing(nothing: BoolArray) -> BoolArray:
    """Which of the readings (m, n_beams) saw nothing in one step only, as when the sensor misses what is there.

    Parameters
    ----------
    nothing
        Whether each beam saw nothing in each of successive steps (m, n_beams).
    """
    around = np.pad(nothing, ((1, 1), (0, 0)))
    return np.asarray(nothing & ~(around[:-2] | around[2:]))
