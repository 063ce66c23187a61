"""What a range reading means. Live observations and all readers of logs use this one definition.

- ``+inf``, the beam's maximum or more become the maximum: nothing was seen, and the beam is free up
  to its maximum. Examples are the 8190 mm of a time-of-flight chip and the 81.91 m of a CARMEN log.
- Between minimum and maximum a reading stays as it is: a surface at this distance.
- 0 up to the beam's minimum become the minimum: something may be too near to be measured.
- ``NaN`` stays: there is no reading. It is skipped and counted.
- Negative numbers and ``-inf`` become ``NaN``. They are skipped and counted.

Some drivers report 0 where no echo came back, and other drivers report 0 where an object is too
near. A reading of 0 therefore shows neither a wall nor free space: the map does not use it, and the
robot keeps its distance. A program whose sensor reports 0 only where nothing was seen replaces the
0 by infinity before it hands the reading over.
"""

import numpy as np
from numpy.typing import ArrayLike

from limslam_env.geometry import FloatArray


def as_readings(ranges: ArrayLike, min_ranges: ArrayLike, max_ranges: ArrayLike) -> FloatArray:
    """Ranges from a sensor or a log as readings of the table above.

    Parameters
    ----------
    ranges
        Whatever the sensor reports (..., n_beams), m.
    min_ranges, max_ranges
        Shortest and longest reading of each beam (n_beams,), m.

    Returns
    -------
    FloatArray
        Readings (..., n_beams), m, from the minimum to the maximum, or NaN. A reading at the
        maximum means that nothing was seen, a reading at the minimum that something may be nearer,
        and NaN that there is no reading.
    """
    values = np.asarray(ranges, dtype=np.float64)
    # A comparison with NaN is false, and np.clip keeps NaN.
    return np.asarray(np.where(values >= 0.0, np.clip(values, min_ranges, max_ranges), np.nan))
