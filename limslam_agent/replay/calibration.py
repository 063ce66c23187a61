"""The constant bias of a log's odometry, estimated from known motions.

The odometry of a real robot has constant errors: one wheel is larger than the other, and the wheels
differ from their nominal size. The errors are estimated from a short run with known motions
(relations), and hold for later runs.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from limslam_agent.config.shared import OdometryConfig
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.logs.relations import Relations, read_relations
from limslam_env.geometry import FloatArray, se2
from limslam_env.messages import counted

LONGEST_DRIVE = 20.0
"""Relations over more driving (m) than this are left out: they overlap, and one slip would count in
many of them.
"""

# What a measured relation itself may be off by: m, rad.
_MEASURED_WITHIN = 0.02, math.radians(0.5)
# Residuals past this many standard deviations count linearly (Huber): a wheel that slipped is no
# bias.
_HUBER = 1.5
_LARGEST_SCALE = 2.0


@dataclass(frozen=True)
class OdometryBias:
    """The constant errors of odometry."""

    turn_per_metre: float  # True minus reported heading for each metre driven, rad per metre
    distance_scale: float  # True distance over reported distance
    # turn_std, scale_std: their standard deviations under the assumed noise
    turn_std: float
    scale_std: float
    relations: int  # number of relations that they were estimated from
    driven: float  # distance driven in these relations by odometry, m

    def applied_to(self, odometry: OdometryConfig) -> OdometryConfig:
        """Settings that correct the bias."""
        return replace(odometry, turn_bias=self.turn_per_metre, distance_scale=self.distance_scale)

    @property
    def figures(self) -> dict[str, float | int]:
        """For ``result.json``."""
        return {
            "calibration_turn_deg_per_m": math.degrees(self.turn_per_metre),
            "calibration_turn_std_deg_per_m": math.degrees(self.turn_std),
            "calibration_scale": self.distance_scale,
            "calibration_scale_std": self.scale_std,
            "calibration_relations": self.relations,
        }

    @property
    def words(self) -> str:
        """A line for the terminal."""
        turn = f"{math.degrees(self.turn_per_metre):.3f} +- {math.degrees(self.turn_std):.3f} deg/m"
        scale = f"scale {self.distance_scale:.4f} +- {self.scale_std:.4f}"
        return (
            f"{turn}, {scale}, from {counted(self.relations, 'relation')} over {self.driven:.1f} m"
        )


def estimate_bias(
    log: RecordedLog, relations: Relations, noise: OdometryConfig | None = None
) -> OdometryBias:
    """Fit turn per metre and distance scale to known motions, by least squares.

    Both are linear: the heading's error grows with the distance driven whatever the scale is, and
    lengths, once the turn is put right, grow with the scale. Each relation is weighted by the
    variance that odometry has gathered over it.

    Parameters
    ----------
    log
        A log with odometry poses.
    relations
        Known motions; those outside of the log's time or over a long drive are left out.
    noise
        The odometry's random errors, the defaults when None.

    Raises
    ------
    ValueError
        If the log has no odometry, nothing is driven in the relations, or they do not fit this log.
    """
    if log.odometry is None:
        raise ValueError("has wheel travel; a bias can be estimated for odometry poses only")
    noise = noise or OdometryConfig()
    path = _Path(log.time, log.odometry)
    inside = relations.within(log.time)
    near = inside & (np.abs(path.between(path.driven, relations)) <= LONGEST_DRIVE)
    known = Relations(
        relations.start_time[near], relations.end_time[near], relations.relative[near]
    )
    driven = np.abs(path.between(path.driven, known))
    if not driven.any():
        usable = (
            f"{len(driven)} of {len(inside)} relations lie in the log and are over less than "
            f"{LONGEST_DRIVE:g} m"
        )
        raise ValueError(f"nothing is driven in them: {usable}")
    heading_variance = (
        noise.turn_variance_per_metre * driven
        + noise.turn_variance_per_radian * np.abs(path.between(path.turned, known))
        + _MEASURED_WITHIN[1] ** 2
    )
    turn, turn_std = _fit(
        path.between(path.signed, known),
        known.relative[:, 2] - path.between(path.heading, known),
        heading_variance,
        angles=True,
    )
    # A heading that is off bends a way of length d aside by d / sqrt(3), rms.
    length_variance = (
        noise.distance_variance * driven
        + heading_variance * driven**2 / 3.0
        + _MEASURED_WITHIN[0] ** 2
    )
    lengths = np.hypot(*known.relative[:, :2].T)
    scale, scale_std = _fit(path.lengths(known, turn), lengths, length_variance, angles=False)
    if not 1.0 / _LARGEST_SCALE <= scale <= _LARGEST_SCALE:
        raise ValueError(
            f"the relations are {scale:.3g} times as long as odometry has them: they are of "
            "another run"
        )
    return OdometryBias(turn, scale, turn_std, scale_std, len(driven), float(driven.sum()))


def calibrated(path: Path, log: RecordedLog, noise: OdometryConfig) -> OdometryBias:
    """The bias by the relations in a file.

    Raises
    ------
    ValueError
        If the file cannot be used, or its motions are too few or those of another run.
    """
    try:
        return estimate_bias(log, read_relations(path), noise)
    except ValueError as error:
        raise ValueError(f"--calibrate {path}: {error}") from error


class _Path:
    """Sums of odometry over time, interpolated at any time."""

    def __init__(self, time: FloatArray, odometry: FloatArray) -> None:
        # Logs step back in time here and there.
        order = np.argsort(time, kind="stable")
        self.time = time[order]
        self._odometry = odometry[order]
        self._steps = se2.between(self._odometry[:-1], self._odometry[1:])
        length = np.hypot(self._steps[:, 0], self._steps[:, 1])
        self.driven = _sums(length)
        # As in motion_from_odometry: what the heading misses a metre unwinds when driving
        # backwards.
        self.signed = _sums(np.copysign(length, self._steps[:, 0]))
        self.turned = _sums(np.abs(self._steps[:, 2]))
        self.heading = _sums(self._steps[:, 2])

    def between(self, sums: FloatArray, relations: Relations) -> FloatArray:
        """What a sum (n,) has grown by (k,) over each relation."""
        return self._at(sums, relations.end_time) - self._at(sums, relations.start_time)

    def lengths(self, relations: Relations, turn_per_metre: float) -> FloatArray:
        """Straight distance (k,), m, between the two ends of each relation, with the turn put
        right.
        """
        heading = (self.heading + turn_per_metre * self.signed)[:-1]
        cos = np.cos(heading)
        sin = np.sin(heading)
        x = _sums(cos * self._steps[:, 0] - sin * self._steps[:, 1])
        y = _sums(sin * self._steps[:, 0] + cos * self._steps[:, 1])
        return np.hypot(self.between(x, relations), self.between(y, relations))

    def _at(self, values: FloatArray, when: FloatArray) -> FloatArray:
        return np.interp(when, self.time, values)


def _fit(
    reported: FloatArray, known: FloatArray, variance: FloatArray, *, angles: bool
) -> tuple[float, float]:
    """The factor f with known = f * reported (k,), and its standard deviation: least squares with
    Huber's weights.
    """

    def residuals(factor: FloatArray) -> FloatArray:
        rest = known - factor * reported
        return (se2.wrap_angle(rest) if angles else rest) / np.sqrt(variance)

    found = least_squares(residuals, 0.0, loss="huber", f_scale=_HUBER)
    far = np.maximum(np.abs(residuals(found.x)), _HUBER) / _HUBER
    information = float(np.sum(reported**2 / (far * variance)))
    return float(found.x[0]), 1.0 / math.sqrt(max(information, 1e-12))


def _sums(steps: FloatArray) -> FloatArray:
    return np.concatenate(([0.0], np.cumsum(steps)))
