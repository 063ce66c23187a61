"""Decides what the columns of a table are used for: which of them are the odometry, which are the
heading of an inertial measurement unit, and where each range points.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from limslam_agent.logs.columns import Column, Dimension, Role, column_of, numbered
from limslam_agent.logs.pose_log import WORST_BEAM_MISMATCH_DEG
from limslam_agent.logs.recorded_log import MOST_BEAMS
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec
from limslam_env.messages import counted

NOT_USED = "-"
"""Name of a column that is not used."""

DOTS = "..."
"""Stands in a header for directions in equal steps."""

_EXAMPLE = "t,left,right,r_90,r_0,... or t,x,y,theta,r_90,r_0,..."
_TIME = "the time of each row (t)"
_MOST_COLUMNS = MOST_BEAMS + 4  # a time and a pose, or as many others
_MOST_NAMED = 12  # columns in a message
_WORD_PRECISION_DEG = 45.0  # "front_left" is any direction between front and left
_QUATERNION = (Role.QX, Role.QY, Role.QZ, Role.QW)


class Form(StrEnum):
    """What the odometry of a table is made of."""

    WHEELS = "both wheels"
    POSES = "poses"
    MOTION = "distance and turn"


@dataclass(frozen=True)
class Layout:
    """What each column of a table is used for.

    Attributes
    ----------
    columns
        All columns in the order of the file.
    form
        What the odometry is made of.
    motion
        Places of the columns of the odometry by their roles, with that of the time. They need a
        number in each row.
    inertial
        Places of the columns of the heading by an inertial measurement unit, which may be empty.
    ranges
        Places of the columns of ranges.
    """

    columns: tuple[Column, ...]
    form: Form
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
    def unused(self) -> list[str]:
        """Names of the columns that are not used."""
        used = {*self.places.values(), *self.ranges}
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


def layout_of(columns: tuple[Column, ...], *, has_robot: bool, is_chosen: bool) -> Layout:
    """What the columns are used for.

    Parameters
    ----------
    columns
        What each column holds.
    has_robot
        Whether the robot is described. Then the travel of its wheels goes before its poses.
    is_chosen
        Whether the columns are those of ``--columns``, in which each name must be known.

    Raises
    ------
    ValueError
        If the time, the odometry or the ranges are missing, or a chosen name is not known.
    """
    unknown = [each.name for each in columns if each.role is None and each.name != NOT_USED]
    if is_chosen and unknown:
        raise ValueError(
            f"--columns: {unknown[0][:40]!r} is no name of a column; it names {_EXAMPLE}, and - "
            "for a column that is not used"
        )
    columns = _with_bare_sides(columns)
    places = _first_places(columns)
    ranges = tuple(place for place, each in enumerate(columns) if each.role is Role.RANGE)
    form, motion = _odometry(columns, places, has_robot=has_robot)
    missing = [
        words
        for words, is_there in (
            (_TIME, Role.TIME in places),
            (_missing_odometry(places), bool(motion)),
            ("a range (r_90, range_front)", bool(ranges)),
        )
        if not is_there
    ]
    if missing:
        raise ValueError(_missing(missing, columns, is_chosen=is_chosen))
    inertial = _inertial(places) if form is Form.WHEELS else {}
    return Layout(columns, form, {Role.TIME: places[Role.TIME], **motion}, inertial, ranges)


def completeness(columns: Iterable[Column]) -> int:
    """How many kinds of columns a header names out of the three that a table needs: the time, an
    odometry and ranges.
    """
    columns = tuple(columns)
    if not columns:  # as of most lines of other logs
        return 0
    places = _first_places(columns)
    _, motion = _odometry(columns, places, has_robot=True)
    return (Role.TIME in places) + bool(motion) + (Role.RANGE in places)


def range_directions(
    layout: Layout, robot: RobotSpec | None, *, is_chosen: bool
) -> tuple[list[float], list[str]]:
    """Directions of the ranges, deg, and what the reader has assumed about them, in words.

    Names like ``r_45`` say the direction. Names like ``tof_fl2`` or ``sonar3`` do not, or not
    exactly: they are the beams of a robot that has as many, in its order, if no word in them says
    otherwise. Raises a ValueError if the directions cannot be found, or two are the same.
    """
    source = "--columns" if is_chosen else "the header"
    ranges = [layout.columns[place] for place in layout.ranges]
    counts_sensors = numbered(ranges)
    named = [each.degrees for each in ranges if each.degrees is not None]
    if counts_sensors or len(named) < len(ranges):
        return _in_robots_order(ranges, robot, source)
    if robot is not None and not _fits(named, robot) and any(each.is_word for each in ranges):
        beams = np.degrees(robot.beam_angles).tolist()
        order = list(range(len(beams)))
        if len(set(named)) == len(named):
            by_angle = sorted(range(len(beams)), key=lambda beam: beams[beam])
            rank = np.argsort(np.argsort(named)).tolist()
            order = [by_angle[each] for each in rank] if len(rank) == len(beams) else order
        if len(named) == len(beams) and all(
            _apart(degrees, beams[beam]) <= _WORD_PRECISION_DEG + 1e-6
            for degrees, beam in zip(named, order, strict=True)
        ):
            return _assigned(ranges, [beams[beam] for beam in order])
    far = next((each for each in named if abs(each) > 360.0), None)
    if far is not None:
        raise ValueError(f"{source} names a beam at {far:g} deg, which is not within 360 deg")
    turns = [round(degrees % 360.0, 6) for degrees in named]
    for degrees, turn in zip(named, turns, strict=True):
        if turns.count(turn) > 1:
            raise ValueError(f"{source} names the beam at {degrees:g} deg twice")
    return named, []


def nearest_beam(robot: RobotSpec, degrees: float, source: str) -> int:
    """Index of the robot's beam in a direction that ``source`` names. Raises a ValueError if there
    is none.
    """
    apart = np.abs(np.degrees(wrap_angle(robot.beam_angles - math.radians(degrees))))
    nearest = int(np.argmin(apart))
    if apart[nearest] > WORST_BEAM_MISMATCH_DEG + 1e-9:
        known = ", ".join(f"{angle:g}" for angle in np.round(np.degrees(robot.beam_angles), 1))
        raise ValueError(
            f"{source} names a beam at {degrees:g} deg, but the robot's beams are at {known} deg"
        )
    return nearest


def _first_places(columns: Sequence[Column]) -> dict[Role, int]:
    """The first place of each role; of the wheels, the first two that hold the same. An angle
    beside x and y is a heading.
    """
    places: dict[Role, int] = {}
    for place, column in enumerate(columns):
        if column.role is not None:
            places.setdefault(column.role, place)
    if Role.ANGLE in places and _picked(places, Role.X, Role.Y):
        places.setdefault(Role.HEADING, places.pop(Role.ANGLE))
    wheels = _wheels(columns)
    return {**places, **wheels}


def _wheels(columns: Sequence[Column]) -> dict[Role, int]:
    """Places of both wheels: of travel or ticks, or else of speeds."""
    sides: dict[Role, dict[Dimension, int]] = {Role.LEFT: {}, Role.RIGHT: {}}
    for place, column in enumerate(columns):
        if column.role in sides:
            sides[column.role].setdefault(column.dimension or Dimension.TICKS, place)
    for dimension in (Dimension.TICKS, Dimension.LENGTH, Dimension.SPEED, Dimension.TURN_RATE):
        if all(dimension in places for places in sides.values()):
            return {role: places[dimension] for role, places in sides.items()}
    return {}


def _with_bare_sides(columns: tuple[Column, ...]) -> tuple[Column, ...]:
    """The columns, where ``left`` and ``right`` alone are ranges if the table has other wheels, or
    has a ``front`` beside them and another odometry.
    """
    others = tuple(
        replace(each, role=None) if each.is_bare and each.role is not Role.RANGE else each
        for each in columns
    )
    has_wheels = Role.LEFT in _wheels(others)
    has_front = any(each.is_bare and each.role is Role.RANGE for each in columns)
    has_odometry = bool(_odometry(others, _first_places(others), has_robot=True)[1])
    if not (has_wheels or (has_front and has_odometry)):
        return columns
    sides = {Role.LEFT: 90.0, Role.RIGHT: -90.0}
    return tuple(
        replace(each, role=Role.RANGE, degrees=sides[each.role], is_word=True)
        if each.is_bare and each.role in sides
        else each
        for each in columns
    )


def _odometry(
    columns: Sequence[Column], places: dict[Role, int], *, has_robot: bool
) -> tuple[Form, dict[Role, int]]:
    """The form of the odometry with the places of its columns, which are none where it is
    incomplete.
    """
    wheels = _picked(places, Role.LEFT, Role.RIGHT) if _wheels(columns) else {}
    position = _picked(places, Role.X, Role.Y)
    heading = next(
        (
            found
            for roles in ((Role.HEADING,), (Role.YAW,), _QUATERNION)
            if (found := _picked(places, *roles))
        ),
        {},
    )
    poses = {**position, **heading} if position and heading else {}
    if wheels and (has_robot or not poses):
        return Form.WHEELS, wheels
    if poses:
        return Form.POSES, poses
    forward = _picked(places, Role.DISTANCE) or _picked(places, Role.SPEED)
    by_rate = (Role.TURN_RATE, Role.YAW_RATE)
    wanted = (Role.ANGLE, *by_rate) if Role.DISTANCE in forward else (*by_rate, Role.ANGLE)
    turn = next((found for role in wanted if (found := _picked(places, role))), heading)
    return Form.MOTION, {**forward, **turn} if forward and turn else {}


def _inertial(places: dict[Role, int]) -> dict[Role, int]:
    """Places of a heading beside wheels. That of a pose is no measurement of its own, nor is a
    ``theta``, which programs calculate from the wheels.
    """
    headings: tuple[tuple[Role, ...], ...] = ((Role.YAW,), _QUATERNION, (Role.YAW_RATE,))
    if _picked(places, Role.X, Role.Y):
        headings = ((Role.YAW,), (Role.YAW_RATE,)) if Role.HEADING in places else headings[2:]
    return next((found for roles in headings if (found := _picked(places, *roles))), {})


def _picked(places: dict[Role, int], *roles: Role) -> dict[Role, int]:
    """Places of all of these roles, or none."""
    return {role: places[role] for role in roles} if all(role in places for role in roles) else {}


def _missing_odometry(places: dict[Role, int]) -> str:
    """What a table lacks in its odometry, in words."""
    for first, second in ((Role.LEFT, Role.RIGHT), (Role.X, Role.Y)):
        for there, lacking in ((first, second), (second, first)):
            if there in places and lacking not in places:
                return f"{lacking} beside {there}"
    if Role.LEFT in places:
        return "both wheels in one unit"
    if Role.X in places:
        return "the heading (theta, yaw)"
    if Role.SPEED in places or Role.DISTANCE in places:
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
    if NOT_USED not in names:
        return f"no column with {what}: found {found}{more}"
    first = names.index(NOT_USED)
    if missing[0] == _TIME:
        names[first] = str(Role.TIME)
        advice = f"says that {columns[first].name} is the time"
    else:
        advice = "with its name in place of a - says which it is"
    return f"no column with {what}: found {found}{more}; --columns {','.join(names)}{more} {advice}"


def _canonical(column: Column) -> str:
    """The name of a column in ``--columns``."""
    if column.role is None or (column.role is Role.RANGE and column.degrees is None):
        return NOT_USED
    sign = "-" if column.sign < 0.0 else ""
    name = f"r_{column.degrees:g}" if column.role is Role.RANGE else str(column.role)
    unit = column.unit or (column.usual if column.role in (Role.LEFT, Role.RIGHT) else None)
    return f"{sign}{name}_{unit.replace('/', '_')}" if unit else f"{sign}{name}"


def _in_robots_order(
    ranges: Sequence[Column], robot: RobotSpec | None, source: str
) -> tuple[list[float], list[str]]:
    """The directions of the robot's beams, for ranges whose names say none."""
    names = ",".join(each.name for each in ranges[:_MOST_NAMED])
    if robot is None or len(robot.beams) != len(ranges):
        beams = (
            f"--robot FILE of {counted(len(ranges), 'beam')} says it, too"
            if robot is None
            else f"the robot has {counted(len(robot.beams), 'beam')}, not {len(ranges)}"
        )
        raise ValueError(
            f"{source} does not say where {names} point: --columns names their directions, as in "
            f"r_90,r_0,r_-90; {beams}"
        )
    return _assigned(ranges, np.degrees(robot.beam_angles).tolist())


def _assigned(ranges: Sequence[Column], degrees: Sequence[float]) -> tuple[list[float], list[str]]:
    """Directions that were found otherwise than in the names, deg, and the words that say so."""
    rounded = [float(round(each, 1)) for each in degrees]
    pairs = ", ".join(
        f"{column.name} {each:g}" for column, each in zip(ranges, rounded, strict=True)
    )
    named = ",".join(f"r_{each:g}" for each in rounded)
    note = (
        f"the ranges are taken as the robot's beams, deg: {pairs}; if that is wrong, --columns "
        f"names them, as in {named}"
    )
    return list(degrees), [note]


def _fits(named: Sequence[float], robot: RobotSpec) -> bool:
    """Whether each direction, deg, is that of another beam of the robot."""
    beams = np.degrees(robot.beam_angles).tolist()
    nearest = [min(range(len(beams)), key=lambda beam: _apart(each, beams[beam])) for each in named]
    return len(set(nearest)) == len(nearest) and all(
        _apart(each, beams[beam]) <= WORST_BEAM_MISMATCH_DEG + 1e-9
        for each, beam in zip(named, nearest, strict=True)
    )


def _apart(first: float, second: float) -> float:
    return abs((first - second + 180.0) % 360.0 - 180.0)


def _between(before: Sequence[Column], after: Sequence[Column]) -> list[float]:
    """The directions that ``...`` stands for, in the step of the two directions before, up to the
    direction after.
    """
    directions = [each.degrees for each in before if each.degrees is not None]
    end = after[0].degrees if len(after) == 1 else None
    if len(directions) < 2 or end is None:
        raise ValueError("'...' must stand between two ranges and the last one")
    step = directions[-1] - directions[-2]
    count = (end - directions[-1]) / step if step else 0.0
    if not (1.0 <= count <= MOST_BEAMS and math.isclose(count, round(count), abs_tol=1e-6)):
        raise ValueError(
            f"'...' cannot go from {directions[-1]:g} to {end:g} deg in steps of {step:g}"
        )
    return [directions[-1] + step * number for number in range(1, round(count))]
