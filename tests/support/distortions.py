"""Logs of drives as hobby firmware, converters and other programs write them: tables with the
faults, names, units and forms of odometry that are usual.

A :class:`Sheet` is one log before it is written. A distortion is a function that changes a sheet.
:data:`KINDS` has all of them by name, with the columns or properties that each of them changes, so
that distortions which exclude each other are not combined.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
from support.drives import ranges_at

from limslam_env.geometry import FloatArray, se2
from limslam_env.interface import RobotSpec

METRES_PER_TICK = 0.0005
_FIRST_TIME = 48.231  # s: a microcontroller that has run for a while
_LENGTHS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_DECIMALS = {"m": 3, "cm": 1, "mm": 0, "s": 3, "ms": 0, "us": 0}
_WORDS = {
    0: "front",
    45: "front_left",
    90: "left",
    135: "back_left",
    180: "back",
    -135: "back_right",
    -90: "right",
    -45: "front_right",
}
_BOOT_LINES = (
    "ets Jun  8 2016 00:22:57",
    "rst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)",
    "VL53L0X init ok",
    "WiFi connected, RSSI -61",
    "[ 5123][E][Wire.cpp:513] requestFrom(): i2cRead returned Error 263",
)
_SPEED_OF_REPEATS = 5  # rows for each measurement


@dataclass(frozen=True, eq=False)
class Drive:
    """A simulated drive of n rows: what the robot measured, and what was true.

    Attributes
    ----------
    name
        Name of the drive in tables of results.
    robot
        Body and beams.
    robot_name
        The robot's name on the command line.
    edges
        Walls and edges of obstacles (k, 4), m.
    time
        (n,), s.
    ranges
        (n, n_beams), m; ``inf`` where nothing was seen, NaN where there is no reading.
    wheels
        Travel of both wheels since the row before (n, 2), m.
    true
        True poses (n, 3).
    """

    name: str
    robot: RobotSpec
    robot_name: str
    edges: FloatArray
    time: FloatArray
    ranges: FloatArray
    wheels: FloatArray
    true: FloatArray


@dataclass(frozen=True, eq=False)
class Sheet:
    """A log before it is written: a drive, the form of its table, and what is expected of a replay.

    Attributes
    ----------
    drive
        What is written.
    odometry
        Name of the form of odometry: a key of ``_FORMS``.
    time_unit, range_unit
        Units of the table.
    names_say_units
        Whether the names of the columns say the units, so that no option has to.
    says_time_unit
        Whether an option says the unit of the time, if no name does.
    time_name, wheel_names, range_name
        Names of columns; ``range_name`` has a place for the direction.
    uses_words
        Whether directions are words where there are such words.
    nothing
        Text of a reading that saw nothing.
    order
        Order of the columns: ``plain``, ``time_last``, ``right_first`` or ``shuffled``.
    has_extras
        Whether there are columns that are of no use here.
    separator, decimal_mark, newline, encoding, is_quoted, preface
        How the text is written.
    damage
        What happened to lines: empty, or ``cut``, ``boot``, ``power_off`` or ``late``.
    wires
        Matrix (2, 2) from true to counted travel of left and right.
    metres_per_tick, axle
        What the user believes; None is what is true.
    words
        A message that holds one of these names the cause.
    cause
        Words of the message that has to name the cause, where a good map alone is not the expected
        outcome. Empty where it is.
    can_be_mended
        Whether an option makes a log right whose cause was named.
    seed
        Of what the writer draws.
    """

    drive: Drive
    odometry: str = "accumulated"
    time_unit: str = "ms"
    range_unit: str = "mm"
    names_say_units: bool = False
    says_time_unit: bool = True
    time_name: str = "t"
    wheel_names: tuple[str, str] = ("left", "right")
    range_name: str = "r_{}"
    uses_words: bool = False
    nothing: str = "8190"
    order: str = "plain"
    has_extras: bool = False
    separator: str = ","
    decimal_mark: str = "."
    newline: str = "\n"
    encoding: str = "utf-8"
    is_quoted: bool = False
    preface: tuple[str, ...] = ()
    damage: str = ""
    wires: FloatArray = field(default_factory=lambda: np.eye(2))
    metres_per_tick: float | None = None
    axle: float | None = None
    words: tuple[str, ...] = ()
    cause: str = ""
    can_be_mended: bool = False
    seed: int = 0


Distortion = Callable[[Sheet, np.random.Generator], Sheet]


@dataclass(frozen=True)
class Kind:
    """A distortion and what it changes: two kinds that change the same do not go together."""

    apply: Distortion
    changes: frozenset[str]


def write(sheet: Sheet, folder: Path, name: str) -> list[str]:
    """Write a sheet as ``name.csv`` into a folder, and the robot's file where the user believes in
    another axle. Returns the arguments of ``limslam replay`` that a user would give.
    """
    generator = np.random.default_rng(sheet.seed)
    path = folder / f"{name}.csv"
    path.write_bytes(_text(sheet, generator).encode(sheet.encoding))
    robot = sheet.drive.robot_name
    if sheet.axle is not None:
        robot = str(folder / f"{name}.toml")
        Path(robot).write_text(_robot_file(sheet.drive.robot, sheet.axle), encoding="utf-8")
    arguments = [str(path), "--robot", robot, "--noise", "0.02"]
    if sheet.odometry in _OF_TICKS:
        arguments += ["--metres-per-tick", f"{sheet.metres_per_tick or METRES_PER_TICK:g}"]
    if sheet.odometry in _OF_TICKS and sheet.odometry != "increments":
        arguments.append("--accumulated")
    if not sheet.names_say_units:
        arguments += ["--range-unit", sheet.range_unit]
    if not sheet.names_say_units and sheet.says_time_unit:
        arguments += ["--time-unit", sheet.time_unit]
    return arguments


def plain(drive: Drive, *, by_poses: bool = False) -> Sheet:
    """A drive as a clean table."""
    return Sheet(drive, odometry="poses" if by_poses else "accumulated")


def _robot_file(robot: RobotSpec, axle: float) -> str:
    settings = {"radius": robot.radius, "axle": axle, "max_wheel_speed": robot.max_wheel_speed}
    lines = [f"{name} = {value!r}" for name, value in settings.items()]
    for beam in robot.beams:
        lines.append("[[beams]]")
        values = {each.name: getattr(beam, each.name) for each in fields(beam)}
        lines += [f"{name} = {value!r}" for name, value in values.items()]
    return "\n".join(lines) + "\n"


def _text(sheet: Sheet, generator: np.random.Generator) -> str:
    names, columns = _columns(sheet, generator)
    if sheet.is_quoted:
        names = [f'"{name}"' for name in names]
    rows = [sheet.separator.join(fields) for fields in zip(*columns, strict=True)]
    if sheet.decimal_mark != ".":
        rows = [row.replace(".", sheet.decimal_mark) for row in rows]
    rows = _damaged(rows, sheet.damage, generator)
    lines = [*sheet.preface, sheet.separator.join(names), *rows]
    end = "" if sheet.damage == "power_off" else sheet.newline
    return sheet.newline.join(lines) + end


def _columns(sheet: Sheet, generator: np.random.Generator) -> tuple[list[str], list[list[str]]]:
    """Names of the columns, and their fields, in the order of the table."""
    drive = sheet.drive
    time = (_FIRST_TIME + drive.time - drive.time[0]) / _TIMES[sheet.time_unit]
    table = {sheet.time_name: _numbers(time, _DECIMALS[sheet.time_unit])}
    table |= _FORMS[sheet.odometry](sheet)
    if sheet.has_extras:
        voltage = 7.4 - 1e-4 * np.arange(len(time))
        table["battery"] = _numbers(voltage, 2)
        table["mode"] = ["auto"] * len(time)
    for beam, angle in enumerate(np.degrees(drive.robot.beam_angles)):
        table[_range_name(sheet, round(float(angle)))] = _readings(sheet, drive.ranges[:, beam])
    names = list(table)
    if sheet.order == "time_last":
        names = [*names[1:], names[0]]
    elif sheet.order == "right_first":
        names[1:3] = names[2:0:-1]
    elif sheet.order == "shuffled":
        names = [names[place] for place in generator.permutation(len(names))]
    return names, [table[name] for name in names]


def _range_name(sheet: Sheet, degrees: int) -> str:
    word = _WORDS.get(degrees) if sheet.uses_words else None
    return sheet.range_name.format(word or degrees)


def _readings(sheet: Sheet, ranges: FloatArray) -> list[str]:
    values = ranges / _LENGTHS[sheet.range_unit]
    texts = _numbers(np.where(np.isfinite(values), values, 0.0), _DECIMALS[sheet.range_unit])
    for row in np.nonzero(~np.isfinite(values))[0]:
        texts[row] = "nan" if np.isnan(values[row]) else sheet.nothing
    return texts


def _numbers(values: Iterable[float], decimals: int) -> list[str]:
    return [f"{value:.{decimals}f}" for value in values]


def _counted(sheet: Sheet) -> FloatArray:
    """Travel (n, 2), m, as the wheels are wired."""
    return sheet.drive.wheels @ sheet.wires.T


def _accumulated(sheet: Sheet) -> dict[str, list[str]]:
    ticks = np.round(np.cumsum(_counted(sheet), axis=0) / METRES_PER_TICK)
    return dict(zip(sheet.wheel_names, (_numbers(side, 0) for side in ticks.T), strict=True))


def _increments(sheet: Sheet) -> dict[str, list[str]]:
    ticks = np.round(np.cumsum(_counted(sheet), axis=0) / METRES_PER_TICK)
    steps = np.diff(ticks, axis=0, prepend=ticks[:1])
    return dict(zip(sheet.wheel_names, (_numbers(side, 0) for side in steps.T), strict=True))


def _speeds(sheet: Sheet) -> dict[str, list[str]]:
    speeds = _counted(sheet) / _lasted(sheet.drive)[:, None]
    return {
        "left_m_s": _numbers(speeds[:, 0], 4),
        "right_m_s": _numbers(speeds[:, 1], 4),
    }


def _speed_and_turn(sheet: Sheet) -> dict[str, list[str]]:
    left, right = (_counted(sheet) / _lasted(sheet.drive)[:, None]).T
    turns = (right - left) / sheet.drive.robot.axle
    return {
        "v_m_s": _numbers(0.5 * (left + right), 4),
        "omega_rad_s": _numbers(turns, 4),
    }


def _distance_and_angle(sheet: Sheet) -> dict[str, list[str]]:
    left, right = np.cumsum(_counted(sheet), axis=0).T
    distance = np.round(500.0 * (left + right), 1)
    angle = np.round(np.degrees((right - left) / sheet.drive.robot.axle), 2)
    return {
        "distance_mm": _numbers(np.diff(distance, prepend=distance[:1]), 1),
        "angle_deg": _numbers(np.diff(angle, prepend=angle[:1]), 2),
    }


def _heading(sheet: Sheet) -> FloatArray:
    """Heading (n,), deg, by a measurement unit in a frame of its own."""
    generator = np.random.default_rng(sheet.seed)
    noise = np.radians(0.3) * generator.standard_normal(len(sheet.drive.time))
    return np.degrees(se2.wrap_angle(sheet.drive.true[:, 2] + 1.0 + noise))


def _ticks_and_yaw(sheet: Sheet) -> dict[str, list[str]]:
    return {**_accumulated(sheet), "yaw_deg": _numbers(_heading(sheet), 1)}


def _ticks_and_compass(sheet: Sheet) -> dict[str, list[str]]:
    return {**_accumulated(sheet), "heading": _numbers(-_heading(sheet) % 360.0, 1)}


def _ticks_and_gyro(sheet: Sheet) -> dict[str, list[str]]:
    generator = np.random.default_rng(sheet.seed)
    turns = se2.wrap_angle(np.diff(sheet.drive.true[:, 2], prepend=sheet.drive.true[:1, 2]))
    rates = np.degrees(turns) / _lasted(sheet.drive)
    noise = 0.2 * generator.standard_normal(len(rates))
    return {**_accumulated(sheet), "gyro_z": _numbers(rates + 0.3 + noise, 2)}


def _ticks_and_theta(sheet: Sheet) -> dict[str, list[str]]:
    return {**_accumulated(sheet), "theta": _numbers(_path(sheet)[:, 2], 4)}


def _poses(sheet: Sheet) -> dict[str, list[str]]:
    path = _path(sheet)
    return {
        "x": _numbers(path[:, 0], 4),
        "y": _numbers(path[:, 1], 4),
        "theta": _numbers(path[:, 2], 4),
    }


def _poses_in_degrees(sheet: Sheet) -> dict[str, list[str]]:
    path = _path(sheet)
    return {
        "x_mm": _numbers(1000.0 * path[:, 0], 1),
        "y_mm": _numbers(1000.0 * path[:, 1], 1),
        "heading_deg": _numbers(np.degrees(path[:, 2]), 2),
    }


def _poses_after_reset(sheet: Sheet) -> dict[str, list[str]]:
    """The robot is switched on again in the middle, where its odometry begins anew."""
    path = _path(sheet)
    middle = len(path) // 2
    path[middle:] = se2.between(path[middle], path[middle:])
    return {
        "x": _numbers(path[:, 0], 4),
        "y": _numbers(path[:, 1], 4),
        "theta": _numbers(path[:, 2], 4),
    }


_FORMS: dict[str, Callable[[Sheet], dict[str, list[str]]]] = {
    "accumulated": _accumulated,
    "increments": _increments,
    "speeds": _speeds,
    "speed_and_turn": _speed_and_turn,
    "distance_and_angle": _distance_and_angle,
    "ticks_and_yaw": _ticks_and_yaw,
    "ticks_and_compass": _ticks_and_compass,
    "ticks_and_gyro": _ticks_and_gyro,
    "ticks_and_theta": _ticks_and_theta,
    "poses": _poses,
    "poses_in_degrees": _poses_in_degrees,
    "poses_after_reset": _poses_after_reset,
}
"""Columns of odometry by the form of odometry."""
_OF_TICKS = (
    "accumulated",
    "increments",
    "ticks_and_yaw",
    "ticks_and_compass",
    "ticks_and_gyro",
    "ticks_and_theta",
)


def _path(sheet: Sheet) -> FloatArray:
    """Poses (n, 3) by the wheels alone."""
    return se2.driven(_counted(sheet), sheet.drive.robot.axle, np.zeros(3))


def _lasted(drive: Drive) -> FloatArray:
    """Time (n,) since the row before, s."""
    steps = np.diff(drive.time, prepend=drive.time[0])
    steps[0] = steps[1]
    return steps


def _damaged(rows: list[str], damage: str, generator: np.random.Generator) -> list[str]:
    if damage == "power_off":
        return [*rows[:-1], rows[-1][: len(rows[-1]) // 2]]
    share = generator.uniform(0.005, 0.03)
    places = generator.random(len(rows)) < share
    places[:2] = False
    found: list[str] = []
    for row, is_bad in zip(rows, places, strict=True):
        if is_bad and damage == "cut":
            found.append(row[: int(generator.integers(1, len(row) - 4))])
            continue
        if is_bad and damage == "boot":
            found.append(str(generator.choice(_BOOT_LINES)))
        if is_bad and damage == "late":
            found.insert(-1, row)
            continue
        found.append(row)
    return found


def _changing(**changes: object) -> Distortion:
    return lambda sheet, _: replace(sheet, **changes)  # type: ignore[arg-type]


def _dropouts(sheet: Sheet, generator: np.random.Generator) -> Sheet:
    """One reading in ten is missing, whether there is a wall or not."""
    ranges = sheet.drive.ranges.copy()
    ranges[generator.random(ranges.shape) < 0.1] = np.nan
    return replace(sheet, drive=replace(sheet.drive, ranges=ranges))


def _at_50_hz(drive: Drive) -> Drive:
    """A drive with rows between its measurements. Ranges are held."""
    count = _SPEED_OF_REPEATS
    old = np.repeat(np.arange(len(drive.time) - 1), count)
    share = np.tile(np.arange(count) / count, len(drive.time) - 1)
    step = np.diff(drive.time)[old]
    moves = se2.between(drive.true[:-1], drive.true[1:])
    parts = np.array([_part_of(moves[row], part) for row, part in zip(old, share, strict=True)])
    wheels = drive.wheels[old + 1] / count
    return replace(
        drive,
        time=drive.time[old] + share * step,
        ranges=drive.ranges[old],
        wheels=np.vstack((np.zeros((1, 2)), wheels[:-1])),
        true=se2.compose(drive.true[old], parts),
    )


def _part_of(move: FloatArray, share: float) -> FloatArray:
    """The pose (3,) after a share of a motion (3,) along an arc."""
    turn = float(move[2])
    chord = math.hypot(float(move[0]), float(move[1]))
    length = chord * (0.5 * turn / math.sin(0.5 * turn) if abs(turn) > 1e-9 else 1.0)
    ahead = math.copysign(length, move[0] * math.cos(0.5 * turn) + move[1] * math.sin(0.5 * turn))
    return se2.arc(share * ahead, share * turn)


def _held(sheet: Sheet, _: np.random.Generator) -> Sheet:
    return replace(sheet, drive=_at_50_hz(sheet.drive))


def _one_beam_at_a_time(sheet: Sheet, generator: np.random.Generator) -> Sheet:
    """Rows at 50 Hz, of which each has a new reading of one beam."""
    drive = _at_50_hz(sheet.drive)
    robot = drive.robot
    ranges = np.empty((len(drive.time), len(robot.beams)))
    now = ranges_at(drive.true[0], drive.edges, robot)
    now[now >= robot.too_far] = np.inf
    for row, pose in enumerate(drive.true):
        beam = row % len(now)
        reading = float(ranges_at(pose, drive.edges, robot)[beam])
        is_nothing = reading >= float(robot.too_far[beam])
        now[beam] = np.inf if is_nothing else reading + 0.02 * generator.standard_normal()
        ranges[row] = np.maximum(now, robot.min_ranges)
    return replace(sheet, drive=replace(drive, ranges=ranges))


def _renamed(sheet: Sheet, generator: np.random.Generator) -> Sheet:
    choices = (
        ("time", ("enc_l", "enc_r"), "range_{}"),
        ("timestamp", ("encoder_left", "encoder_right"), "Range_{}"),
        ("Time", ("left_ticks", "right_ticks"), "range.{}"),
        ("stamp", ("ticks_left", "ticks_right"), "dist_{}"),
    )
    time, wheels, ranges = choices[int(generator.integers(len(choices)))]
    return replace(sheet, time_name=time, wheel_names=wheels, range_name=ranges, uses_words=True)


def _units_in_names(sheet: Sheet, generator: np.random.Generator) -> Sheet:
    time_unit = str(generator.choice(list(_TIMES)))
    range_unit = str(generator.choice(list(_LENGTHS)))
    millis = {"ms": "millis", "us": "micros", "s": "time [s]"}
    time = str(generator.choice([f"t_{time_unit}", f"time [{time_unit}]", millis[time_unit]]))
    ranges = str(generator.choice([f"r_{{}}_{range_unit}", f"range_{{}} [{range_unit}]"]))
    return replace(
        _in_units(sheet, time_unit, range_unit),
        names_say_units=True,
        time_name=time,
        range_name=ranges,
    )


def _units_by_options(sheet: Sheet, generator: np.random.Generator) -> Sheet:
    time_unit = str(generator.choice(list(_TIMES)))
    range_unit = str(generator.choice(list(_LENGTHS)))
    return _in_units(sheet, time_unit, range_unit)


def _in_units(sheet: Sheet, time_unit: str, range_unit: str) -> Sheet:
    nothing = {"m": "8.190", "cm": "819.0", "mm": "8190"}[range_unit]
    if sheet.nothing != "8190":
        nothing = sheet.nothing
    return replace(sheet, time_unit=time_unit, range_unit=range_unit, nothing=nothing)


def _odometry(form: str) -> Distortion:
    return _changing(odometry=form)


def _rows_without_ranges(sheet: Sheet, _: np.random.Generator) -> Sheet:
    """Rows at 50 Hz, of which each fifth one has ranges."""
    drive = _at_50_hz(sheet.drive)
    ranges = drive.ranges.copy()
    ranges[np.arange(len(ranges)) % _SPEED_OF_REPEATS > 0] = np.nan
    return replace(sheet, drive=replace(drive, ranges=ranges))


def _wired(matrix: list[list[float]], cause: str) -> Distortion:
    """Wheels that are wired otherwise."""
    return _changing(wires=np.array(matrix), cause=cause, can_be_mended=True)


def _ticks_wrong(factor: float) -> Distortion:
    return _changing(
        metres_per_tick=factor * METRES_PER_TICK,
        cause="--metres-per-tick",
        can_be_mended=True,
    )


def _axle_wrong(factor: float) -> Distortion:
    return lambda sheet, _: replace(
        sheet,
        axle=factor * sheet.drive.robot.axle,
        cause="--axle",
        can_be_mended=True,
    )


def _jump(sheet: Sheet, _: np.random.Generator) -> Sheet:
    return replace(sheet, odometry="poses_after_reset", cause="jump")


_MISSING = ("missing", "no reading")


def _nothing_as(text: str) -> Kind:
    return Kind(_changing(nothing=text, words=_MISSING), frozenset({"missing"}))


def _kind(apply: Distortion, *changes: str) -> Kind:
    return Kind(apply, frozenset(changes))


KINDS: dict[str, Kind] = {
    "nothing_nan": _nothing_as("NaN"),
    "nothing_empty": _nothing_as(""),
    "nothing_minus_1": _nothing_as("-1"),
    "nothing_0": _nothing_as("0"),
    "nothing_65535": _nothing_as("65535"),
    "dropouts": _kind(_dropouts, "missing", "repeats"),
    "held_50_hz": _kind(_held, "repeats"),
    "one_beam_at_a_time": _kind(_one_beam_at_a_time, "repeats"),
    "rows_without_ranges": _kind(_rows_without_ranges, "repeats"),
    "right_first": _kind(_changing(order="right_first"), "order"),
    "time_last": _kind(_changing(order="time_last"), "order"),
    "shuffled": _kind(_changing(order="shuffled"), "order"),
    "renamed": _kind(_renamed, "columns"),
    "extra_columns": _kind(_changing(has_extras=True), "extras"),
    "units_in_names": _kind(_units_in_names, "units", "columns"),
    "units_by_options": _kind(_units_by_options, "units"),
    "unsaid_time_unit": _kind(_changing(says_time_unit=False), "time unit"),
    "quoted_header": _kind(_changing(is_quoted=True), "text"),
    "byte_order_mark": _kind(_changing(encoding="utf-8-sig"), "text"),
    "utf_16": _kind(_changing(encoding="utf-16"), "text"),
    "text_before_header": _kind(_changing(preface=_BOOT_LINES[:3]), "text"),
    "decimal_commas": _kind(_changing(separator=";", decimal_mark=","), "text"),
    "tabs": _kind(_changing(separator="\t"), "text"),
    "crlf": _kind(_changing(newline="\r\n"), "text"),
    "ticks_per_row": _kind(_odometry("increments"), "odometry", "lost_travel"),
    "wheel_speeds": _kind(_odometry("speeds"), "odometry", "size of ticks"),
    "speed_and_turn": _kind(_odometry("speed_and_turn"), "odometry", "wheels"),
    "distance_and_angle": _kind(
        _odometry("distance_and_angle"), "odometry", "wheels", "lost_travel"
    ),
    "ticks_and_yaw": _kind(_odometry("ticks_and_yaw"), "odometry", "axle"),
    "ticks_and_compass": _kind(_odometry("ticks_and_compass"), "odometry", "axle"),
    "ticks_and_gyro": _kind(_odometry("ticks_and_gyro"), "odometry", "axle"),
    "ticks_and_theta": _kind(_odometry("ticks_and_theta"), "odometry"),
    "poses_in_degrees": _kind(_odometry("poses_in_degrees"), "odometry", "wheels"),
    "cut_lines": _kind(_changing(damage="cut"), "damage", "lost_travel"),
    "boot_text": _kind(_changing(damage="boot"), "damage"),
    "power_off": _kind(_changing(damage="power_off"), "damage"),
    "late_rows": _kind(_changing(damage="late"), "damage"),
    "right_backwards": _kind(
        _wired([[1.0, 0.0], [0.0, -1.0]], "the right wheel counts the other way"), "wheels"
    ),
    "left_backwards": _kind(
        _wired([[-1.0, 0.0], [0.0, 1.0]], "the left wheel counts the other way"), "wheels"
    ),
    "both_backwards": _kind(
        _wired([[-1.0, 0.0], [0.0, -1.0]], "both wheels count the other way"), "wheels"
    ),
    "exchanged": _kind(_wired([[0.0, 1.0], [1.0, 0.0]], "left and right are exchanged"), "wheels"),
    "ticks_halved": _kind(_ticks_wrong(0.5), "wheels", "size of ticks"),
    "ticks_doubled": _kind(_ticks_wrong(2.0), "wheels", "size of ticks"),
    "axle_too_long": _kind(_axle_wrong(4.0 / 3.0), "wheels", "axle"),
    "axle_too_short": _kind(_axle_wrong(2.0 / 3.0), "wheels", "axle"),
    "reset_of_poses": _kind(_jump, "odometry", "wheels", "damage"),
}
"""Distortions by name. What two of them both change, they do not change in one log."""


def distorted(drive: Drive, kinds: Sequence[str], generator: np.random.Generator) -> Sheet:
    """A drive as a sheet with distortions, by their names.

    Raises
    ------
    ValueError
        If two of the distortions exclude each other.
    """
    for number, first in enumerate(kinds):
        for second in kinds[number + 1 :]:
            if KINDS[first].changes & KINDS[second].changes:
                raise ValueError(f"{first} and {second} do not go together")
    sheet = replace(plain(drive), seed=int(generator.integers(2**31)))
    for kind in kinds:
        sheet = KINDS[kind].apply(sheet, generator)
    return sheet


def drawn_kinds(
    first: str, others: Sequence[str], most: int, generator: np.random.Generator
) -> list[str]:
    """The names of 1 to ``most`` distortions that go together, of which one is given."""
    chosen = [first]
    count = int(generator.integers(1, most + 1))
    for place in generator.permutation(len(others)):
        other = KINDS[others[place]].changes
        if len(chosen) < count and not any(KINDS[each].changes & other for each in chosen):
            chosen.append(others[place])
    return chosen
