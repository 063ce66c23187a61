"""What an agent may know: the robot's specification, its nominal noise, and the form of an
observation.

Besides ``geometry`` and ``compilation`` this is the only module of the simulator that an agent may
import. Nothing in it gives access to the ground truth.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from typing import Any, Literal, NotRequired, Self, TypedDict

import numpy as np
from numpy.typing import NDArray

from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.numbers import check_count, check_number
from limslam_env.geometry.se2 import wrap_angle

Side = Literal["left", "right", "none"]

SMALLEST_SIDE_ANGLE = math.radians(20.0)
LARGEST_SIDE_ANGLE = math.radians(160.0)

# Readings are float32: a beam's limits need not survive the rounding exactly.
_ROUNDING = 1e-6


LARGEST_BODY = 5.0
"""Largest radius of a robot, and largest coordinate of a beam on it, m. A larger number is in
another unit.
"""

LARGEST_CONE = 0.25 * math.pi
"""Largest half opening angle of a beam, rad. A wider one says too little about where a wall is."""

LARGEST_RANGE = 1000.0
"""Longest range of a beam, m. A larger number is in another unit."""

MOST_BEAMS = 4096
"""Most beams of a ring or a laser scanner."""

MOST_STEPS = 1_000_000
"""Largest number of steps between two measurements of a beam."""

_BEAM_LIMITS = {
    "x": (-LARGEST_BODY, LARGEST_BODY, "m"),
    "y": (-LARGEST_BODY, LARGEST_BODY, "m"),
    "angle": (-4.0 * math.pi, 4.0 * math.pi, "rad"),
    "min_range": (0.0, LARGEST_RANGE, "m"),
    "max_range": (0.0, LARGEST_RANGE, "m"),
}

_LIMITS = {
    "radius": (1e-3, LARGEST_BODY, "m"),
    "axle": (1e-3, 2.0 * LARGEST_BODY, "m"),
    "max_wheel_speed": (1e-4, 100.0, "m/s"),
    "control_period": (1e-4, 1000.0, "s"),
    "cone": (0.0, LARGEST_CONE, "rad"),
}

# Directions in degrees that are written in radians are this close to a whole number of degrees.
_NEAR_WHOLE = 0.05


LARGEST_NOISE = 1e3
"""Largest standard deviation of a range, m, and largest variance of a wheel, m^2 per metre."""


class Observation(TypedDict):
    """One step's readings, float32 as the environments give them.

    ``ranges`` (n_beams,) in metres, a beam's maximum where it sees nothing; ``wheels`` (2,),
    left and right wheel travel in metres since the last observation, NaN where that is not known:
    the wheels are then taken to go on at their last speed, with a wide variance.
    ``wheel_variances`` (2,), m^2, says by how much travel is less certain than the noise of
    encoders. Without ``ranges`` nothing was measured. An agent also takes what other sensors
    report: infinity and anything at or beyond the maximum mean that nothing was seen, 0 up to the
    minimum means that something may be near, and NaN and negative numbers are skipped and
    counted. Recorded logs that hold poses instead of wheel
    travel give ``odometry`` (3,), the motion since the last observation in the robot's frame at
    that time (m, m, rad), and leave ``wheels`` out. ``yaw`` is the heading by an inertial
    measurement unit, rad, counter-clockwise in a frame of its own, NaN where it has no reading.

    Examples
    --------
    >>> import numpy as np
    >>> from limslam_env import Observation
    >>> observation: Observation = {"ranges": np.full(6, 1.5), "wheels": np.array([0.02, 0.03])}
    """

    ranges: NotRequired[NDArray[np.floating[Any]]]
    wheels: NotRequired[NDArray[np.floating[Any]]]
    wheel_variances: NotRequired[NDArray[np.floating[Any]]]
    odometry: NotRequired[NDArray[np.floating[Any]]]
    yaw: NotRequired[float]


def side_of(angle: float) -> Side:
    """The buffer that a beam at ``angle`` (rad, 0 is ahead) fills: walls beside the robot, not
    ahead or behind.
    """
    # A beam exactly at a limit is on no side. Otherwise rounding could give two mirrored beams
    # different sides.
    if SMALLEST_SIDE_ANGLE + _ROUNDING < abs(wrap_angle(angle)) < LARGEST_SIDE_ANGLE - _ROUNDING:
        return "left" if wrap_angle(angle) > 0.0 else "right"
    return "none"


@dataclass(frozen=True)
class SensorSpec:
    """One beam: where it starts on the body, where it points, and what it can see.

    Attributes
    ----------
    x, y
        Origin of the beam in the robot's frame, m (x ahead, y left).
    angle
        Direction of the beam in the robot's frame, rad, counter-clockwise from ahead.
    min_range, max_range
        Shortest and longest reading, m. A reading at ``max_range`` means that nothing was
        seen, one at ``min_range`` that something may be nearer.
    side
        The scan buffer that its points go to; ``"none"`` for beams that only avoid collisions. By
        its angle (:func:`side_of`) if left out.
    period, phase
        Steps between two measurements, and the first step after the reset in which the beam
        measures, below ``period``: it measures in the steps of which the remainder by ``period``
        is ``phase``. The last reading is repeated in between. At the reset, all beams measure.

    Examples
    --------
    >>> import math
    >>> from limslam_env import RobotSpec, SensorSpec
    >>> robot = RobotSpec(beams=(SensorSpec(0.08, 0.03, math.radians(45.0), max_range=0.8),))
    >>> robot.beams[0].side
    'left'
    """

    x: float
    y: float
    angle: float
    min_range: float = 0.05
    max_range: float = 1.5
    side: Side | None = None
    period: int = 1
    phase: int = 0

    def __post_init__(self) -> None:
        for name, (low, high, unit) in _BEAM_LIMITS.items():
            check_number(f"a beam's {name}", getattr(self, name), low, high, unit)
        if self.min_range >= self.max_range:
            raise ValueError(
                f"a beam needs min_range < max_range, not {self.min_range} and {self.max_range}"
            )
        if self.side is None:
            object.__setattr__(self, "side", side_of(self.angle))
        if self.side not in {"left", "right", "none"}:
            raise ValueError(f"a beam's side is left, right or none, not {self.side!r}")
        check_count("a beam's period, in steps,", self.period, MOST_STEPS)
        check_count("a beam's phase, in steps,", self.phase, self.period - 1, least=0)


def beams_on_rim(
    degrees: tuple[float, ...], radius: float, *, min_range: float = 0.05, max_range: float = 1.5
) -> tuple[SensorSpec, ...]:
    """Beams that start on a circle of ``radius`` (m) and point straight out, at the given angles in
    degrees.

    Raises
    ------
    ValueError
        If the angles are in radians: all lie between -2 pi and 2 pi, and all are whole numbers of
        degrees in radians.
    """
    given = [math.degrees(degree) for degree in degrees if degree]
    if given and all(
        abs(turn) <= 360.1 and abs(turn - round(turn)) < _NEAR_WHOLE for turn in given
    ):
        raise ValueError(
            f"the angles of beams_on_rim are degrees, but {tuple(degrees)} look like radians"
        )
    angles = [math.radians(degree) for degree in degrees]
    return tuple(
        SensorSpec(radius * math.cos(a), radius * math.sin(a), a, min_range, max_range)
        for a in angles
    )


def degrees_around(count: int) -> tuple[float, ...]:
    """Directions of ``count`` beams all around a robot, deg: the first ahead, counter-clockwise.

    Raises
    ------
    ValueError
        If there are fewer than 1 or more than 4096 beams.
    """
    check_count("the number of beams all around a robot", count, MOST_BEAMS)
    return tuple(360.0 * number / count for number in range(count))


PAPER_BEAMS_DEG = (90.0, 45.0, 15.0, -15.0, -45.0, -90.0)
"""The paper's six beams. The front pair fills no buffer and only avoids collisions."""


@dataclass(frozen=True)
class RobotSpec:
    """A round differential-drive robot, as its builder would measure it.

    Attributes
    ----------
    radius
        Radius of the body, m.
    axle
        Distance between the wheels, m.
    max_wheel_speed
        Wheel speed at an action of 1, m/s.
    control_period
        Time between two observations, s.
    beams
        The range sensors, in the order of the observation.
    cone
        Half the opening angle of the beams, rad, as the data sheet gives it: a beam reads the
        nearest of what lies inside it. 0 is a ray, as the beams of laser sensors nearly are.

    Examples
    --------
    >>> from limslam_env import RobotSpec
    >>> from limslam_env.interface import beams_on_rim
    >>> beams = beams_on_rim((90, 0, -90), 0.07, max_range=1.2)
    >>> robot = RobotSpec(radius=0.07, axle=0.12, max_wheel_speed=0.2, beams=beams)
    >>> robot == RobotSpec.from_json(robot.to_json())
    True
    """

    radius: float = 0.10
    axle: float = 0.16
    max_wheel_speed: float = 0.30
    control_period: float = 0.1
    beams: tuple[SensorSpec, ...] = beams_on_rim(PAPER_BEAMS_DEG, 0.10)
    cone: float = 0.0

    def __post_init__(self) -> None:
        for name, (low, high, unit) in _LIMITS.items():
            check_number(f"a robot's {name}", getattr(self, name), low, high, unit)
        object.__setattr__(self, "beams", tuple(map(_beam, self.beams)))
        if not self.beams:
            raise ValueError("a robot needs at least one beam")

    @cached_property
    def beam_origins(self) -> FloatArray:
        """Origins of the beams in the robot's frame, (n_beams, 2), m."""
        return _read_only([(beam.x, beam.y) for beam in self.beams])

    @cached_property
    def beam_angles(self) -> FloatArray:
        """Directions of the beams in the robot's frame, (n_beams,), rad."""
        return _read_only([beam.angle for beam in self.beams])

    @cached_property
    def beam_directions(self) -> FloatArray:
        """Directions of the beams as unit vectors in the robot's frame, (n_beams, 2)."""
        return _read_only([(math.cos(beam.angle), math.sin(beam.angle)) for beam in self.beams])

    @cached_property
    def min_ranges(self) -> FloatArray:
        """Shortest readings, (n_beams,), m."""
        return _read_only([beam.min_range for beam in self.beams])

    @cached_property
    def max_ranges(self) -> FloatArray:
        """Longest readings, (n_beams,), m."""
        return _read_only([beam.max_range for beam in self.beams])

    @cached_property
    def too_near(self) -> FloatArray:
        """Readings (n_beams,), m, up to which something is near, but not measured: the shortest,
        rounding allowed.
        """
        return _read_only(list(self.min_ranges * (1.0 + _ROUNDING)))

    @cached_property
    def too_far(self) -> FloatArray:
        """Readings (n_beams,), m, from which on nothing was seen: the longest, rounding allowed."""
        return _read_only(list(self.max_ranges * (1.0 - _ROUNDING)))

    @cached_property
    def beam_table(self) -> FloatArray:
        """The beams as compiled functions read them, (n_beams, 8).

        The columns are the origin's x and y, m, the direction's x and y, ``too_near``, ``too_far``,
        the angle, rad, and the longest reading, m.
        """
        columns = (
            self.beam_origins,
            self.beam_directions,
            self.too_near,
            self.too_far,
            self.beam_angles,
        )
        return _read_only(list(np.column_stack((*columns, self.max_ranges))))

    @cached_property
    def reach(self) -> float:
        """Farthest that a beam sees from the robot's centre, m."""
        return float((np.linalg.norm(self.beam_origins, axis=1) + self.max_ranges).max())

    @property
    def max_wheel_travel(self) -> float:
        """Largest wheel travel that an observation reports, m: twice what the motors can do in a
        step.
        """
        return 2.0 * self.max_wheel_speed * self.control_period

    def measures(self, step: int | IntArray) -> BoolArray:
        """Which beams (n_beams,) take a new measurement at a step; the first observation is step
        0, in which all do. For steps (t, 1), an array (t, n_beams).
        """
        periods, phases = self.schedule
        return np.asarray((step % periods == phases) | (step == 0))

    @cached_property
    def schedule(self) -> IntArray:
        """Period and phase of each beam (2, n_beams), steps. Read-only."""
        schedule = np.array([(beam.period, beam.phase) for beam in self.beams]).T
        schedule.setflags(write=False)
        return schedule

    def __reduce__(self) -> tuple[type[Self], tuple[Any, ...]]:
        # A copy makes its own arrays: unpickled ones could be written to.
        return type(self), tuple(getattr(self, part.name) for part in fields(self))

    @classmethod
    def lidar(cls, beams: int = 360, max_range: float = 1.5, **others: Any) -> Self:
        """A robot with a turning laser scanner: ``beams`` that start at its middle and look all
        around, the first ahead, counter-clockwise, up to ``max_range``, m.

        ``others`` are further settings of the robot, such as its radius.

        Raises
        ------
        ValueError
            If there are fewer than 1 or more than 4096 beams, or a number is out of bounds.

        Examples
        --------
        >>> from limslam_env import RobotSpec
        >>> robot = RobotSpec.lidar(beams=360, max_range=4.0, radius=0.08)
        >>> len(robot.beams), robot.reach
        (360, 4.0)
        """
        return cls(beams=beams_on_rim(degrees_around(beams), 0.0, max_range=max_range), **others)

    def to_json(self) -> str:
        """The robot as JSON, for files."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Self:
        """The robot that :meth:`to_json` wrote.

        Raises
        ------
        ValueError
            If the text is not such a robot.
        """
        try:
            values = json.loads(text)
            return cls(**{**values, "beams": values["beams"]})
        except (TypeError, KeyError, json.JSONDecodeError, RecursionError) as error:
            raise ValueError(f"not a robot: {error}") from error


def _beam(beam: object) -> SensorSpec:
    """A beam, or the one in a table of its settings."""
    if isinstance(beam, SensorSpec):
        return beam
    known = {part.name for part in fields(SensorSpec)}
    if isinstance(beam, Mapping) and {"x", "y", "angle"} <= set(beam) <= known:
        return SensorSpec(**beam)
    raise TypeError(
        "each beam of a robot must be a SensorSpec, as beams_on_rim makes them, not of type "
        f"{type(beam).__name__}"
    )


def _read_only(values: list[Any]) -> FloatArray:
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


@dataclass(frozen=True)
class NominalNoise:
    """The noise that a builder would read off the data sheets; the true one may differ.

    Attributes
    ----------
    range_std
        Standard deviation of a range, m.
    wheel_variance
        Variance of a wheel's reported travel, m^2 per metre of travel.
    yaw_std
        Standard deviation of the turn by an inertial measurement unit, rad per square root of a
        second: its angle random walk.

    Examples
    --------
    >>> from limslam_env import NominalNoise
    >>> NominalNoise(range_std=0.02).wheel_variance
    2e-05
    """

    range_std: float = 0.0
    wheel_variance: float = 2e-5
    yaw_std: float = math.radians(0.05)

    def __post_init__(self) -> None:
        for name in ("range_std", "wheel_variance", "yaw_std"):
            check_number(f"noise ({name})", getattr(self, name), 0.0, LARGEST_NOISE)


def largest_noise(noises: Sequence[NominalNoise]) -> NominalNoise:
    """The noise that one filter for several robots is told: the largest of each kind."""
    return NominalNoise(
        max(one.range_std for one in noises),
        max(one.wheel_variance for one in noises),
        max(one.yaw_std for one in noises),
    )
