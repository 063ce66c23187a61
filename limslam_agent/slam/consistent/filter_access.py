"""What the decisions of a step ask of the filter.

These functions ask a ``CloneEKF``. The batch compiles the decisions with its own functions of the same names in their
place (``slam.batch.compiled_steps``).
"""

import numpy as np

from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.core.wall_faces import NEGATIVE, POSITIVE
from limslam_env.geometry import FloatArray, IntArray


def num_lines(ekf: CloneEKF) -> int:
    """How many lines the filter holds."""
    return ekf.num_lines


def line_of(ekf: CloneEKF, index: int) -> tuple[float, float]:
    """A line as (d, theta) about its anchor, m and rad."""
    d, theta = ekf.line(index).tolist()
    return d, theta


def anchor_of(ekf: CloneEKF, index: int) -> tuple[float, float]:
    """The anchor of a line, m."""
    x, y = ekf.anchors[index].tolist()
    return x, y


def lines_near(ekf: CloneEKF, theta: float, x: float, y: float, angle: float, offset: float) -> IntArray:
    """Lines (k,) with a direction within ``angle``, rad, that pass a point at less than ``offset``, m."""
    from limslam_agent.kernels import nearness

    found, lines = np.empty(ekf.num_lines, dtype=np.int64), ekf.x[ekf.lines_from : ekf.clones_from].reshape(-1, 2)
    count = nearness.lines_near(lines, ekf.anchors, float(theta), (x, y), float(angle), float(offset), found)
    return found[:count]


def places_of(ekf: CloneEKF, clones: FloatArray) -> IntArray:
    """Places (n,) of clones (n,) in the state."""
    return ekf.places(clones.astype(np.int64))


def keep_clones(ekf: CloneEKF, wanted: FloatArray) -> None:
    """Marginalise all clones but the wanted ones."""
    ekf.keep_clones(set(wanted.astype(int).tolist()))


def end_points(ekf: CloneEKF, places: IntArray, readings: FloatArray, theta: float) -> FloatArray:
    """End points (n, 2), m, of readings on a wall with its normal at ``theta``, rad; on the middle of beams if NaN."""
    from limslam_agent.kernels.measurement import ends_of_beams

    return ends_of_beams(ekf.x, ekf.clones_from, places, readings, theta)


def straight_segments(
    ekf: CloneEKF, places: IntArray, readings: FloatArray, points: FloatArray, members: IntArray, line: FloatArray,
    std: float, variances: FloatArray,
) -> tuple[FloatArray, IntArray, FloatArray]:  # fmt: skip
    """Cut readings near one line into straight segments: ``kernels.segments.cut_at_bends``."""
    from limslam_agent.kernels import segments

    found = segments.straight_segments(
        ekf.x, ekf.P, ekf.clones_from, places, readings, points, members, line, std, variances
    )
    if np.isnan(found[2]).any():
        raise np.linalg.LinAlgError("the covariance of the readings is not positive")
    return found


def compare(
    ekf: CloneEKF, places: IntArray, readings: FloatArray, index: int, variances: FloatArray
) -> tuple[float, float, int, float, float]:
    """How badly readings fit a line: ``kernels.updates.compare``; no reading is used if too few can be compared."""
    from limslam_agent.kernels.updates import compare_readings

    start = ekf.lines_from + 2 * index
    return compare_readings(
        ekf.x, ekf.P, ekf.clones_from, places, readings, start, anchor_of(ekf, index), variances
    )  # fmt: skip


def side_of(ekf: CloneEKF, places: IntArray, readings: FloatArray, index: int) -> int:
    """From which side readings hit a line: ``POSITIVE`` or ``NEGATIVE``."""
    headings = ekf.x[ekf.clones_from + 3 * places + 2] + readings[:, 2]
    return POSITIVE if np.cos(headings - line_of(ekf, index)[1]).sum() < 0.0 else NEGATIVE


def add_line(ekf: CloneEKF, theta: float, x: float, y: float) -> int:
    """Add a line with an uninformative prior, and return its index."""
    return ekf.add_line(theta, np.array([x, y]))


def observe(
    ekf: CloneEKF, places: IntArray, readings: FloatArray, index: int, variances: FloatArray, iterations: int
) -> None:
    """Update by readings of one line."""
    ekf.observe(places, readings, index, variances, iterations)


def difference(ekf: CloneEKF, older: int, younger: int) -> tuple[FloatArray, FloatArray]:
    """Difference (2,) of two lines about the younger's anchor, m and rad, and its covariance (2, 2)."""
    return ekf.difference(older, younger)


def merge(ekf: CloneEKF, older: int, younger: int, iterations: int) -> None:
    """Make two lines equal, and marginalise the younger one."""
    ekf.merge(older, younger, iterations)
