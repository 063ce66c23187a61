"""Finds from the name of a column what it holds: what was measured, its unit, and the direction of
a range.

Names are those of programs on robots (``millis``, ``encL``, ``tof_left_mm``), of the client of a
Crazyflie (``stabilizer.yaw``) and of bags that were written as text
(``field.pose.pose.position.x``). A name is taken apart into words. Case, spaces and underscores do
not matter. A unit stands in brackets or at the end of the name.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache

from limslam_agent.logs.directions import direction_of, is_vertical, words_in, words_of


class Role(StrEnum):
    """What a column holds. The value is its name in ``--columns``."""

    TIME = "t"
    LEFT = "left"
    RIGHT = "right"
    X = "x"
    Y = "y"
    HEADING = "theta"
    YAW = "yaw"
    YAW_RATE = "gyro_z"
    SPEED = "v"
    TURN_RATE = "omega"
    DISTANCE = "distance"
    ANGLE = "angle"
    QX = "qx"
    QY = "qy"
    QZ = "qz"
    QW = "qw"
    RANGE = "r"


class Dimension(StrEnum):
    """What a unit measures."""

    TIME = "time"
    LENGTH = "length"
    ANGLE = "angle"
    SPEED = "speed"
    TURN_RATE = "turn rate"
    TICKS = "ticks"
    TICK_RATE = "tick rate"


UNITS = {
    Dimension.TIME: {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    Dimension.LENGTH: {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254},
    Dimension.ANGLE: {"rad": 1.0, "deg": math.radians(1.0)},
    Dimension.SPEED: {"m/s": 1.0, "cm/s": 0.01, "mm/s": 0.001},
    Dimension.TURN_RATE: {
        "rad/s": 1.0,
        "deg/s": math.radians(1.0),
        "rpm": 2.0 * math.pi / 60.0,
    },
    Dimension.TICKS: {"ticks": 1.0},
    Dimension.TICK_RATE: {"ticks/s": 1.0},
}
"""Units of each dimension, in s, m, rad, m/s and rad/s."""

DIMENSION_OF = {unit: dimension for dimension, units in UNITS.items() for unit in units}
SCALE_OF = {unit: scale for units in UNITS.values() for unit, scale in units.items()}
"""How many s, m, rad, m/s or rad/s each unit is."""

MEASURED: dict[Role | None, Dimension] = {
    Role.TIME: Dimension.TIME,
    Role.SPEED: Dimension.SPEED,
    **dict.fromkeys((Role.X, Role.Y, Role.DISTANCE, Role.RANGE), Dimension.LENGTH),
    **dict.fromkeys((Role.HEADING, Role.YAW, Role.ANGLE), Dimension.ANGLE),
    **dict.fromkeys((Role.TURN_RATE, Role.YAW_RATE), Dimension.TURN_RATE),
}
"""What the columns of a role measure. Those of wheels hold ticks, a length or a speed, and those of
quaternions have no unit.
"""

_OF_WHEELS = {*Dimension} - {Dimension.TIME}
_SPELLINGS = {
    "s": "sec secs second seconds",
    "ms": "msec msecs millis millisecond milliseconds",
    "us": "usec usecs micros microsecond microseconds",
    "ns": "nsec nsecs nanos nanosec nanosecs nanosecond nanoseconds",
    "m": "metre metres meter meters",
    "cm": "centimetre centimetres centimeter centimeters",
    "mm": "millimetre millimetres millimeter millimeters",
    "in": "inch inches",
    "rad": "radian radians",
    "deg": "degs degree degrees",
    "m/s": "mps",
    "cm/s": "cmps",
    "mm/s": "mmps",
    "rad/s": "rads radps",
    "deg/s": "dps degs/s degps",
    "rpm": "rpm",
    "ticks": "tick count counts pulse pulses",
    "ticks/s": "tick/s counts/s pulses/s",
}
_UNIT_OF = {word: unit for unit in _SPELLINGS for word in (unit, *_SPELLINGS[unit].split())}


# Words of what the robot was told to do, of the truth, and of figures about a measurement.
_NOT_MEASURED = words_in(
    "pwm cmd command duty power current voltage volt volts battery bat batt target setpoint goal "
    "desired ref reference error err temp temperature status quality signal sigma ambient cov "
    "covariance std var seq id rssi true truth gt mocap vicon acc accel acceleration pitch roll "
    "mag dt loop period valid"
)
_TURNING = words_in("servo pan turret")
_CLOCK = words_in("t time stamp timestamp datetime clock uptime elapsed")
_SENSOR = words_in(
    "r range ranges dist distance tof flight us uss sonar ultrasonic ultrasound ir lidar laser "
    "prox proximity sharp sensor echo beam hcsr hc vl d s"
)
_SHORT_SENSOR = {"r", "d", "s", "us", "ir"}
_SHORT_LAST = {"us", "ir"}
_MINUS = {"m", "minus", "neg"}
_LEFT = {"left", "l", "lft"}
_RIGHT = {"right", "r", "rgt"}
_SPEED = words_in("speed vel velocity v")
_ROTATION = words_in("w omega angular rotational rpm")
_TICKS = words_in("enc encoder encoders counter") | words_in(_SPELLINGS["ticks"]) | {"ticks"}
_WHEEL = (
    words_in("wheel wheels motor travel odo odom odometry pos position joint rate delta total")
    | _SPEED
    | _ROTATION
    | _TICKS
)
_PLACE = words_in(
    "odom odometry pos pose position state estimate field robot base kalman est world global "
    "translation transform local p ekf msg data"
)
_FLIGHT_CONTROLLER = {"stabilizer", "estimate"}
_INERTIAL = words_in("imu bno mpu icm lsm gyro compass fused stabilizer attitude ahrs euler")
_COMPUTED_HEADING = words_in("theta th phi psi")
_HEADING = _COMPUTED_HEADING | words_in("yaw heading azimuth bearing")
_GYRO = words_in("gz gyro gyr")
_FORWARD = words_in("v vx vel velocity speed linear lin")
_QUATERNION = words_in("orientation quaternion quat q rotation")
_QUATERNION_PARTS = words_in("qx qy qz qw")
_NO_SENSOR = _TICKS | _INERTIAL | words_in("wheel motor")
# Names that have one of some words, and no other words than these and those beside them.
_MOTIONS = (
    (Role.DISTANCE, words_in("distance dist travel"), words_in("travelled delta")),
    (Role.ANGLE, words_in("angle"), words_in("turned delta")),
    (Role.X, words_in("x px"), _PLACE),
    (Role.Y, words_in("y py"), _PLACE),
    (Role.HEADING, _COMPUTED_HEADING, _PLACE | {"angle"}),
    (Role.ANGLE, words_in("theta"), words_in("delta")),
    (Role.YAW, _HEADING, _INERTIAL | {"angle"}),
    (Role.HEADING, _HEADING, _PLACE | _INERTIAL | {"angle"}),
    (Role.YAW, words_in("angle"), _INERTIAL | {"z"}),
    (Role.YAW_RATE, words_in("yaw heading"), words_in("rate imu")),
    (Role.YAW_RATE, _GYRO, _INERTIAL | words_in("z rate yaw")),
    (Role.YAW_RATE, words_in("imu"), words_in("angular vel velocity rate z w wz field")),
    (
        Role.TURN_RATE,
        words_in("omega w wz angular ang turn turning rot vth vtheta"),
        words_in("z vel velocity speed rate twist robot field odom base yaw"),
    ),
    (Role.SPEED, _FORWARD, words_in("x forward twist robot field odom base translational")),
)

# Words that are written together, as in "encoderleft" or "gyroz", are taken apart by these.
_VOCABULARY = sorted(
    {
        word
        for words in (_CLOCK, _SENSOR, _WHEEL, _PLACE, _HEADING, _GYRO, _FORWARD, _INERTIAL)
        for word in words
        if len(word) > 1
    }
    | words_in("left right front back rear yaw rate host linear angular")
    | words_in("fl fr bl br"),
    key=len,
    reverse=True,
)
_PART = re.compile("|".join(_VOCABULARY) + "|[a-z]")
_TOGETHER = re.compile(f"(?:{'|'.join(_VOCABULARY)})+[lrxyz]?")
_ABBREVIATED = re.compile(r"[vwd][lr]|[lr](?:enc|ticks?)")
_BRACKET = re.compile(r"^(.*?)\s*[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$")
_LAST_NUMBER = re.compile(r"(?<!\d)(?<!\d\.)([-+]?\d+(?:\.\d+)?)[\])\s]*$")
_MOST_KEPT = 10_000  # names whose columns are kept
_FEWEST_DEGREES = 10.0  # a smaller number after a word such as left counts sensors
_MOST_PLACES = 16  # more columns that are numbered one by one are directions in degrees


@dataclass(frozen=True)
class Column:
    """What a column holds.

    Attributes
    ----------
    name
        As it stands in the file.
    role
        What was measured. None for a column that means nothing here.
    unit
        Unit in the name, one of ``UNITS``. None if the name has none.
    usual
        Unit that columns of such a name have where nothing says another. None if there is none.
    sign
        -1 for a column that counts the other way than usual, otherwise 1.
    degrees
        Direction of a range, deg, left positive, or a number that counts the sensors. None if the
        name has none.
    is_word
        Whether a direction is a word like ``front_left``, which is approximate.
    is_bare
        Whether the name is a direction alone: a wheel or a range.
    is_turning
        Whether it is the direction of a sensor on a servo. The column has no role then.
    """

    name: str
    role: Role | None = None
    unit: str | None = None
    usual: str | None = None
    sign: float = 1.0
    degrees: float | None = None
    is_word: bool = False
    is_bare: bool = False
    is_turning: bool = False

    @property
    def dimension(self) -> Dimension | None:
        """What the unit measures. None without a unit."""
        unit = self.unit or self.usual
        return None if unit is None else DIMENSION_OF[unit]


@lru_cache(maxsize=_MOST_KEPT)
def column_of(name: str) -> Column:
    """What a column of this name holds. A ``-`` before the name says that it counts the other
    way.
    """
    text = name.strip().replace("µ", "u").replace("μ", "u").replace("°", "deg")
    sign = -1.0 if text.startswith("-") and len(text) > 1 else 1.0
    for rest, words, unit in _without_unit(text.removeprefix("-")):
        column = _meaning(Column(name, unit=unit, sign=sign), rest, words)
        if column.role is None and not column.is_turning:
            continue
        is_wheel = column.role in (Role.LEFT, Role.RIGHT)
        if column.dimension in {None, *(_OF_WHEELS if is_wheel else (MEASURED.get(column.role),))}:
            return column
    return Column(name)


def is_voltage(name: str) -> bool:
    """Whether a name is that of a range whose last word says that it is no length."""
    *words, last = words_of(name) or [""]
    is_length = last not in words_in("v mv volt volts adc raw")
    return not is_length and column_of("_".join(words)).role is Role.RANGE


def numbered(columns: Sequence[Column]) -> bool:
    """Whether the numbers in the names of ranges count the sensors: 0, 1, 2, ... or 1, 2, 3, ...,
    of a few sensors. Otherwise they are directions in degrees.
    """
    numbers = {None if each.is_word else each.degrees for each in columns}
    count = len(columns)
    are_counted = any(numbers == set(range(first, first + count)) for first in (0, 1))
    return are_counted and 2 <= count <= _MOST_PLACES


def _words(text: str) -> list[str]:
    """The words of a name in lower case; those that are written together are taken apart."""
    found: list[str] = []
    words = [word for word in words_of(text) if word != "per"]
    is_alone = len(words) == 1 or "/".join(words[1:]) in _UNIT_OF
    for word in words:
        if is_alone and _ABBREVIATED.fullmatch(word):
            side = word[0] if len(word) > 2 else word[-1]
            rest = word.strip("lr")
            found += ["delta" if rest == "d" else rest, side]
        elif word not in _VOCABULARY and word not in _UNIT_OF and _TOGETHER.fullmatch(word):
            found += _PART.findall(word)
        else:
            found.append(word)
    return found


def _without_unit(text: str) -> Iterator[tuple[str, list[str], str | None]]:
    """The ways to read a name as one without its unit, that one in words, and the unit."""
    bracket = _BRACKET.match(text)
    if bracket is not None and (unit := _UNIT_OF.get("/".join(words_of(bracket[2])))):
        yield bracket[1], _words(bracket[1]), unit
        return
    words = _words(text)
    for length in (2, 1):
        end = words[-length:]
        if len(end) == length and (unit := _UNIT_OF.get("/".join(end))):
            pattern = r"(?:[\W_]|per)*".join(["", *map(re.escape, end), "$"])
            yield re.sub(pattern, "", text, flags=re.IGNORECASE), words[:-length], unit
    yield text, words, None


def _meaning(column: Column, text: str, words: list[str]) -> Column:
    """The column with what its name without the unit says. It has no role if that is nothing."""
    known = set(words)
    if known & _NOT_MEASURED:
        return column
    if known & _TURNING:
        return replace(column, is_turning=True)
    if (pointing := _range(column, text, words)) is not None:
        return pointing
    side = _wheel(words)
    if side is not None:
        is_length = column.unit is None or column.dimension is Dimension.LENGTH
        implied = (("rpm", {"rpm"}), ("m/s", _SPEED), ("rad/s", _ROTATION), ("ticks", _TICKS))
        usual = next((unit for unit, implying in implied if known & implying), None)
        return replace(column, role=side, usual=usual, is_bare=len(words) == 1 and is_length)
    last = words[-1] if words else ""
    is_unit = len(words) == 1 and len(last) > 1 and _UNIT_OF.get(last) in UNITS[Dimension.TIME]
    is_clock = bool({last, *words[:1]} & _CLOCK)
    if is_unit or is_clock or (not words and column.unit in ("ms", "us", "ns")):
        return replace(column, role=Role.TIME, unit=column.unit or _UNIT_OF.get(last))
    role = _motion([word for word in words if not word.isdigit()])
    is_of_crazyflie = role in (Role.HEADING, Role.YAW) and bool(known & _FLIGHT_CONTROLLER)
    return replace(column, role=role, usual="deg" if is_of_crazyflie else None)


def _range(column: Column, text: str, words: list[str]) -> Column | None:
    """A range: the name has a word for a sensor, and a direction or a number, or is a direction
    alone.
    """
    if not words or is_vertical(text):
        return None
    known = set(words)
    is_short = words[0] in _SHORT_SENSOR or words[-1] in _SHORT_LAST
    has_sensor = len(words) > 1 and (is_short or bool(known & (_SENSOR - _SHORT_SENSOR)))
    if known & _NO_SENSOR if has_sensor else not _is_direction(words) or _wheel(words):
        return None
    # A log block of a Crazyflie is in mm.
    usual = "mm" if text.lower().startswith("range.") else None
    column = replace(column, role=Role.RANGE, usual=usual, is_bare=not has_sensor)
    if re.search(r"\d_?deg(?![a-z])", text.lower()):
        return replace(column, degrees=direction_of(text))
    beside = words[1:] if words[0] in _SHORT_SENSOR else words
    towards = direction_of("_".join(word for word in beside if not word[0].isdigit()))
    last = _LAST_NUMBER.search(text)
    if towards is not None:
        size = abs(float(last[1])) if last else 0.0
        is_exact = size >= _FEWEST_DEGREES and abs(towards) == 90.0
        degrees = math.copysign(size, towards) if is_exact else towards
        return replace(column, degrees=degrees, is_word=not is_exact)
    if last is None:
        return column if re.match(r"r(ange)?[_\[]", text.lower()) else None
    sign = -1.0 if words[-2:-1] and words[-2] in _MINUS else 1.0
    return replace(column, degrees=sign * float(last[1]))


def _is_direction(words: Sequence[str]) -> bool:
    """Whether all words are directions, beside a number of degrees or one that counts the
    sensors.
    """
    towards = [word for word in words if not word.isdigit()]
    are_directions = all(len(word) > 1 and direction_of(word) is not None for word in towards)
    return are_directions and direction_of("_".join(towards)) is not None


def _wheel(words: Sequence[str]) -> Role | None:
    """The wheel in a name whose other words are of wheels."""
    for role, sides in ((Role.LEFT, _LEFT), (Role.RIGHT, _RIGHT)):
        others = [word for word in words if word not in sides]
        if len(others) == len(words) - 1 and set(others) <= _WHEEL:
            return role
    return None


def _motion(words: list[str]) -> Role | None:
    """The part of a pose or of a motion that the words name."""
    known = frozenset(words)
    last = words[-1] if words else ""
    if last in _QUATERNION_PARTS or (last in {"x", "y", "z", "w"} and known & _QUATERNION):
        return Role(f"q{last[-1]}")
    return next(
        (role for role, some, beside in _MOTIONS if known & some and known <= some | beside), None
    )
