"""The robots that ship with the package, and those that TOML files describe."""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from limslam_agent.config.tables import SettingsError, read_toml, updated
from limslam_env.interface import RobotSpec, beams_on_rim
from limslam_env.robots import ROBOTS


@dataclass(frozen=True)
class _RimBeams:
    """Beams that start on the rim of the body and point straight out, as a robot's file may
    describe them.
    """

    beams_deg: tuple[float, ...] = ()
    min_range: float = 0.05
    max_range: float = 1.5


def robot_named(named: str) -> RobotSpec:
    """A robot that ships with the package by its name, or the robot in a TOML file.

    The file has the settings of `RobotSpec`. Its beams are tables of `SensorSpec`, or
    ``beams_deg``, ``min_range`` and ``max_range`` for beams that start on the rim of the body.
    """
    if named.replace("_", "-") in ROBOTS:
        return ROBOTS[named.replace("_", "-")]()
    if not named.endswith(".toml"):
        raise SettingsError(
            f"--robot: no robot is called {named!r}; there are {', '.join(ROBOTS)}, or a .toml file"
        )
    try:
        table = read_toml(Path(named))
        missing = next((name for name in ("radius", "axle") if name not in table), None)
        robot = _robot_in(table, named)
    except SettingsError as error:
        raise SettingsError(f"--robot: {error}") from error
    if missing is not None:
        raise SettingsError(
            f"--robot: {named}: {missing} is missing: a robot's file needs radius and axle, m"
        )
    return robot


def _robot_in(table: dict[str, Any], where: str) -> RobotSpec:
    """The robot of a file's table."""
    of_rim = [field.name for field in fields(_RimBeams)]
    names = [*(field.name for field in fields(RobotSpec)), *of_rim]
    unknown = next((name for name in table if name not in names), None)
    if unknown is not None:
        raise SettingsError(
            f"{where}: {unknown}: there is no such setting; there are {', '.join(names)}"
        )
    rim = {name: table.pop(name) for name in of_rim if name in table}
    robot = updated(RobotSpec(), table, where)
    if not rim:
        return robot
    if "beams_deg" not in rim or "beams" in table:
        wrong = (
            f"beams and {min(rim)} both describe the beams"
            if "beams" in table
            else f"{min(rim)} goes with beams_deg"
        )
        raise SettingsError(f"{where}: {wrong}")
    on_rim = updated(_RimBeams(), rim, where)
    try:
        beams = beams_on_rim(
            on_rim.beams_deg, robot.radius, min_range=on_rim.min_range, max_range=on_rim.max_range
        )
        return replace(robot, beams=beams)
    except ValueError as error:
        raise SettingsError(f"{where}: {error}") from error
