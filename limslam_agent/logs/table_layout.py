"""Decides what the columns of a table are used for: which of them are the odometry, which are the
heading of an inertial measurement unit, and where each range points.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from limslam_agent.logs.columns import Column, Dimension, Role, column_of, is_voltage, numbered
from limslam_agent.logs.directions import apart
from limslam_agent.logs.pose_log import WORST_BEAM_MISMATCH_DEG
from limslam_agent.logs.recorded_log import MOST_BEAMS
from limslam_env.interface import RobotSpec
from limslam_env.messages import counted

NOT_USED = "-"
"""Name of a column that is not used."""

DOTS = "..."
"""Stands in a header for directions in equal steps."""

WHEELS = (Role.LEFT, Role.RIGHT)
QUATERNION = (Role.QX, Role.QY, Role.QZ, Role.QW)

_EXAMPLE = "t,left,right,r_90,r_0,... or t,x,y,theta,r_90,r_0,..."
_TIME = "the time of each row (t)"
_MOST_COLUMNS = MOST_BEAMS + 4  # a time and a pose, or as many others
_MOST_NAMED = 12  # columns in a message
_WORD_PRECISION_DEG = 45.0  # "front_left" is any direction between front and left
_ROUNDING_DEG = 1e-6


@dataclass(frozen=True)
class Header:
    """The names of the columns of a table.

    Attributes
    ----------
    columns
        What each column holds.
    separator
        What separates the columns. None for spaces.
    text
        The line itself, which is skipped where it is repeated. Empty without such a line.
    skipped
        How many lines of text stand before it.
    is_chosen
        Whether the columns are those of ``--columns``.
    endings
        The unit after each number of a column, as in ``936 mm``, where there is one. Empty where
        no column has one.
    """

    columns: tuple[Column, ...]
    separator: bytes | None
    text: bytes = b""
    skipped: int = 0
    is_chosen: bool = False
    endings: tuple[bytes, ...] = ()

    @property
    def source(self) -> str:
        """What names the columns, in messages."""
        return "--columns" if self.is_chosen else "the header"


@dataclass(frozen=True)
class Layout:
    """What each column of a table is used for.

    Attributes
    ----------
    columns
        All columns in the order of the file.
    motion
        Places of the columns of the odometry by their roles, after that of the time: of both
        wheels, of poses, or of a distance or speed and a turn. They need a number in each row.
    inertial
        Places of the columns of the heading by an inertial measurement unit, which may be empty.
    ranges
        Places of the columns of ranges.
    """

    columns: tuple[Column, ...]
    motion: dict[Role, int]
    inertial: dict[Role, int]
    ranges: tuple[int, ...]

    @property
    def places(self) -> dict[Role, int]:
        """Places of the columns of the odometry and of the inertial measurement unit."""
        return {**self.motion, **self.inertial}

    def column(self, role: Role) -> Column:
        """The column that is used for a role."""
        return self.columns[self.places[role]]

    @property
    def is_speed(self) -> bool:
        """Whether the odometry is calculated from speeds."""
        rates = (Dimension.SPEED, Dimension.TURN_RATE, Dimension.TICK_RATE)
        of_wheels = Role.LEFT in self.motion and self.column(Role.LEFT).dimension in rates
        return Role.SPEED in self.motion or of_wheels

    @property
    def counts_ticks(self) -> bool:
        """Whether the odometry is the speeds of wheels in ticks."""
        return Role.LEFT in self.motion and self.column(Role.LEFT).unit == "ticks/s"

    @property
    def fraction(self) -> int | None:
        """The place of a fraction of a second, such as ``nsecs`` beside ``secs``."""
        time = self.motion[Role.TIME]
        after = self.columns[time + 1 : time + 2]
        is_there = self.columns[time].unit == "s" and after and after[0].role is Role.TIME
        return time + 1 if is_there and after[0].unit not in (None, "s") else None

    @property
    def unused(self) -> list[str]:
        """Names of the columns that are not used."""
        used = {*self.places.values(), *self.ranges, self.fraction}
        return [
            each.name
            for place, each in enumerate(self.columns)
            if place not in used and each.name not in ("", NOT_USED)
        ]

    def header(self, directions: Sequence[float]) -> tuple[str, ...]:
        """The names that ``--columns`` has for the columns, of which the ranges have these
        directions, deg.
        """
        names = [NOT_USED] * len(self.columns)
        for place in self.places.values():
            names[place] = _canonical(self.columns[place])
        for place, degrees in zip(self.ranges, directions, strict=True):
            names[place] = _canonical(replace(self.columns[place], degrees=round(degrees, 1)))
        return tuple(names)


def columns_of(names: Sequence[str]) -> tuple[Column, ...]:
    """What the columns of these names hold. ``...`` stands for directions in equal steps."""
    if len(names) > _MOST_COLUMNS:
        raise ValueError(f"there are {len(names)} columns, more than {_MOST_COLUMNS}")
    columns: list[Column] = []
    for place, name in enumerate(names):
        if name == DOTS:
            after = [column_of(each) for each in names[place + 1 :]]
            columns += [column_of(f"r_{each:g}") for each in _between(columns, after)]
        else:
            columns.append(Column(name) if name == NOT_USED else column_of(name))
    return tuple(columns)


def layout_of(header: Header, *, has_robot: bool) -> Layout:
    """What the columns are used for. Where the robot is described, the travel of its wheels goes
    before its poses. Raises a ValueError if the time, the odometry or the ranges are missing, or a
    name of ``--columns`` is not known.
    """
    columns = header.columns
    unknown = [each.name for each in columns if each.role is None and each.name != NOT_USED]
    if header.is_chosen and unknown:
        raise ValueError(
            f"--columns: {unknown[0][:40]!r} is no name of a column; it names {_EXAMPLE}, and - "
            "for a column that is not used"
        )
    columns = _with_ranges(columns)
    places = _first_places(columns)
    ranges = tuple(place for place, each in enumerate(columns) if each.role is Role.RANGE)
    motion = _odometry(places, has_robot=has_robot)
    missing = [] if Role.TIME in places else [_TIME]
    if not motion:
        missing.append(_missing_odometry({each.role for each in columns}))
    if not ranges:
        missing.append("a range (r_90, range_front)")
        voltages = [each.name for each in columns if is_voltage(each.name)]
        if voltages:
            raise ValueError(
                f"{voltages[0][:40]} is a voltage by its name: the table needs distances, by the "
                "curve in the data sheet of the sensor"
            )
    if missing:
        raise ValueError(_missing(missing, columns, is_chosen=header.is_chosen))
    if turning := _turning(columns, motion, ranges):
        raise ValueError(
            f"the column {turning[:40]} turns a sensor: the table needs a column of ranges for "
            "each of its directions, as in r_90,r_0,r_-90, which is empty where the sensor looks "
            "elsewhere; --columns with - in its place says that it does not"
        )
    inertial = _inertial(places) if Role.LEFT in motion else {}
    return Layout(columns, {Role.TIME: places[Role.TIME], **motion}, inertial, ranges)


def completeness(columns: Iterable[Column]) -> int:
    """How many kinds of columns a header names out of the three that a table needs: the time, an
    odometry and ranges.
    """
    places = _first_places(columns)
    has_odometry = bool(_odometry(places, has_robot=True))
    return (Role.TIME in places) + has_odometry + (Role.RANGE in places)


def range_directions(
    layout: Layout, robot: RobotSpec | None, source: str
) -> tuple[list[float], tuple[str, ...]]:
    """Directions of the ranges, deg, and what the reader has assumed about them, in words.

    Names like ``r_45`` say the direction. Names like ``tof_fl2`` or ``sonar3`` do not, or not
    exactly: they are the beams of a robot that has as many, in its order, if no word in them says
    otherwise. Raises a ValueError if the directions cannot be found, or two are the same.
    """
    ranges = [layout.columns[place] for place in layout.ranges]
    beams = [] if robot is None else np.degrees(robot.beam_angles).tolist()
    directions = [each.degrees for each in ranges if each.degrees is not None]
    if numbered(ranges) or len(directions) < len(ranges):
        if len(beams) != len(ranges):
            raise ValueError(_without_directions(ranges, robot, source))
        return _assigned(ranges, beams)
    if any(each.is_word for each in ranges) and len(directions) == len(beams):
        order = beams
        if len(set(directions)) == len(beams):
            rank = np.argsort(np.argsort(directions))
            order = np.sort(beams)[rank].tolist()
        off = max(float(apart(*pair)) for pair in zip(order, directions, strict=True))
        if WORST_BEAM_MISMATCH_DEG < off - _ROUNDING_DEG <= _WORD_PRECISION_DEG:
            return _assigned(ranges, order)
    far = next((each for each in directions if abs(each) > 360.0), None)
    if far is not None:
        raise ValueError(f"{source} names a beam at {far:g} deg, which is not within 360 deg")
    turns = [round(degrees % 360.0, 6) for degrees in directions]
    for degrees, turn in zip(directions, turns, strict=True):
        if turns.count(turn) > 1:
            raise ValueError(f"{source} names the beam at {degrees:g} deg twice")
    return directions, ()


def _first_places(columns: Iterable[Column]) -> dict[Role, int]:
    """The first place of each role; of the wheels, the first two that hold the same: travel or
    ticks, or else speeds. An angle beside x and y is a heading.
    """
    places: dict[Role, int] = {}
    order = (Dimension.TICKS, Dimension.LENGTH, Dimension.SPEED, Dimension.TURN_RATE)
    sides: dict[Dimension, dict[Role, int]] = {
        dimension: {} for dimension in (*order, Dimension.TICK_RATE, Dimension.ANGLE)
    }
    for place, column in enumerate(columns):
        if column.role in WHEELS:
            sides[column.dimension or Dimension.TICKS].setdefault(column.role, place)
        elif column.role is not None:
            places.setdefault(column.role, place)
    if Role.ANGLE in places and _picked(places, Role.X, Role.Y):
        places.setdefault(Role.HEADING, places.pop(Role.ANGLE))
    return {**places, **next((pair for pair in sides.values() if len(pair) == len(WHEELS)), {})}


def _with_ranges(columns: tuple[Column, ...]) -> tuple[Column, ...]:
    """The columns, where a name that may be a part of the odometry is a range if the odometry is
    complete without it: ``left`` and ``right`` alone, if the table has other wheels, or has a
    ``front`` beside them; and a ``distance``, if it has no other range.
    """
    sides = {Role.LEFT: 90.0, Role.RIGHT: -90.0}
    others = _first_places(
        replace(each, role=None) if each.is_bare and each.role in sides else each
        for each in columns
    )
    has_front = any(each.is_bare and each.role is Role.RANGE for each in columns)
    has_odometry = bool(_odometry(others, has_robot=True))
    if Role.LEFT in others or (has_front and has_odometry):
        columns = tuple(
            replace(each, role=Role.RANGE, degrees=sides[each.role], is_word=True)
            if each.is_bare and each.role in sides
            else each
            for each in columns
        )
    places = _first_places(columns)
    if Role.RANGE in places or Role.DISTANCE in _odometry(places, has_robot=True):
        return columns
    return tuple(
        replace(each, role=Role.RANGE) if each.role is Role.DISTANCE else each for each in columns
    )


def _turning(
    columns: Sequence[Column], motion: Mapping[Role, int], ranges: Sequence[int]
) -> str | None:
    """The name of a column with the direction of the only sensor, such as ``servo``; an angle
    beside other odometry is one.
    """
    if len(ranges) > 1:
        return None
    return next(
        (
            each.name
            for place, each in enumerate(columns)
            if each.is_turning or (each.role is Role.ANGLE and place not in motion.values())
        ),
        None,
    )


def _odometry(places: dict[Role, int], *, has_robot: bool) -> dict[Role, int]:
    """Places of the columns of the odometry, which are none where it is incomplete."""
    wheels = _picked(places, *WHEELS)
    position = _picked(places, Role.X, Role.Y)
    heading = _first_of(places, (Role.HEADING,), (Role.YAW,), QUATERNION)
    poses = {**position, **heading} if position and heading else {}
    if poses or wheels:
        return wheels if wheels and (has_robot or not poses) else poses
    forward = _first_of(places, (Role.DISTANCE,), (Role.SPEED,))
    turns = [(Role.TURN_RATE,), (Role.YAW_RATE,)]
    turns.insert(0 if Role.DISTANCE in forward else 2, (Role.ANGLE,))
    turn = _first_of(places, *turns) or heading
    return {**forward, **turn} if forward and turn else {}


def _inertial(places: dict[Role, int]) -> dict[Role, int]:
    """Places of a heading beside wheels. That of a pose is no measurement of its own, nor is a
    ``theta``, which programs calculate from the wheels.
    """
    headings: list[tuple[Role, ...]] = [(Role.YAW,), QUATERNION, (Role.YAW_RATE,)]
    if _picked(places, Role.X, Role.Y):
        del headings[1 if Role.HEADING in places else slice(2)]
    return _first_of(places, *headings)


def _picked(places: dict[Role, int], *roles: Role) -> dict[Role, int]:
    """Places of all of these roles, or none."""
    return {role: places[role] for role in roles} if all(role in places for role in roles) else {}


def _first_of(places: dict[Role, int], *choices: tuple[Role, ...]) -> dict[Role, int]:
    """Places of the first choice of which all roles have one, or none."""
    return next((found for roles in choices if (found := _picked(places, *roles))), {})


def _missing_odometry(roles: set[Role | None]) -> str:
    """What a table with columns of some roles lacks in its odometry, in words."""
    for pair in (WHEELS, (Role.X, Role.Y)):
        for there, lacking in (pair, pair[::-1]):
            if there in roles and lacking not in roles:
                return f"{lacking} beside {there}"
    if Role.LEFT in roles:
        return "both wheels in one unit"
    if Role.X in roles:
        return "the heading (theta, yaw)"
    if roles & {Role.SPEED, Role.DISTANCE}:
        return "the turn (omega, angle, yaw)"
    return "the odometry (left and right, or x, y and theta, or v and omega)"


def _missing(missing: list[str], columns: Sequence[Column], *, is_chosen: bool) -> str:
    """Names what is missing and what was found, with the names that stand in ``--columns``."""
    what = " and no column with ".join(missing)
    found = ",".join(each.name for each in columns[:_MOST_NAMED])
    more = ",..." if len(columns) > _MOST_NAMED else ""
    if is_chosen:
        return f"--columns has no column with {what}: it must name {_EXAMPLE}, not {found!r}"
    names = [_canonical(each) for each in columns[:_MOST_NAMED]]
    rate = "; --rate says how many rows there are in a second" if _TIME in missing else ""
    if NOT_USED not in names:
        return f"no column with {what}: found {found}{more}{rate}"
    first = names.index(NOT_USED)
    advice = "with its name in place of a - says which it is"
    if len(missing) > 1:
        advice = f"names them, with {_EXAMPLE} in place of each -"
    elif missing[0] == _TIME:
        names[first] = str(Role.TIME)
        advice = f"says that {columns[first].name} is the time"
    columns_named = f"--columns {','.join(names)}{more} {advice}"
    return f"no column with {what}: found {found}{more}; {columns_named}{rate}"


def _canonical(column: Column) -> str:
    """The name of a column in ``--columns``."""
    if column.role is None or (column.role is Role.RANGE and column.degrees is None):
        return NOT_USED
    sign = "-" if column.sign < 0.0 else ""
    name = f"r_{column.degrees:g}" if column.role is Role.RANGE else str(column.role)
    unit = column.unit or (column.usual if column.role in WHEELS else None)
    return f"{sign}{name}_{unit.replace('/', '_')}" if unit else f"{sign}{name}"


def _without_directions(ranges: Sequence[Column], robot: RobotSpec | None, source: str) -> str:
    """Says which ranges have names that say no direction."""
    if len(ranges) == 1:
        return (
            f"{source} has one column of ranges, {ranges[0].name}, and says no direction: the "
            "table needs a column for each direction, as in r_90,r_0,r_-90, which is empty where "
            "another sensor is read"
        )
    names = ",".join(each.name for each in ranges[:_MOST_NAMED])
    beams = f"--robot FILE of {counted(len(ranges), 'beam')} says it, too"
    if robot is not None:
        beams = f"the robot has {counted(len(robot.beams), 'beam')}, not {len(ranges)}"
    return (
        f"{source} does not say where {names} point: --columns names their directions, as in "
        f"r_90,r_0,r_-90; {beams}"
    )


def _assigned(
    ranges: Sequence[Column], degrees: list[float]
) -> tuple[list[float], tuple[str, ...]]:
    """Directions that were found otherwise than in the names, deg, and the words that say so."""
    rounded = [round(each, 1) for each in degrees]
    pairs = ", ".join(
        f"{column.name} {each:g}" for column, each in zip(ranges, rounded, strict=True)
    )
    columns = ",".join(f"r_{each:g}" for each in rounded)
    note = (
        f"the ranges are taken as the robot's beams, deg: {pairs}; if that is wrong, --columns "
        f"names them, as in {columns}"
    )
    return degrees, (note,)


def _between(before: Sequence[Column], after: Sequence[Column]) -> list[float]:
    """The directions that ``...`` stands for, in the step of the two directions before, up to the
    direction after.
    """
    directions = [each.degrees for each in before if each.degrees is not None]
    end = after[0].degrees if len(after) == 1 else None
    if len(directions) < 2 or end is None:
        raise ValueError("'...' must stand between two ranges and the last one")
    last = directions[-1]
    step = last - directions[-2]
    count = (end - last) / step if step else 0.0
    if not (1.0 <= count <= MOST_BEAMS and math.isclose(count, round(count), abs_tol=1e-6)):
        raise ValueError(f"'...' cannot go from {last:g} to {end:g} deg in steps of {step:g}")
    return [last + step * number for number in range(1, round(count))]
