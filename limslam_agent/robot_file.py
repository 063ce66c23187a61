"""The robots that ship with the package, and those that TOML files describe."""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from limslam_agent.config.tables import SettingsError, read_toml, updated
from limslam_env.interface import RobotSpec, beams_on_rim, degrees_around
from limslam_env.robots import ROBOTS

# The settings that describe such beams.
_BEAMS = "beams_deg", "lidar_beams"


@dataclass(frozen=True)
class _BeamsAlike:
    """Beams that differ by their directions only, as a robot's file may describe them: on the rim
    of the body, pointing straight out, or those of a laser scanner.
    """

    beams_deg: tuple[float, ...] = ()
    lidar_beams: int = 0
    min_range: float = 0.05
    max_range: float = 1.5


def robot_named(named: str) -> RobotSpec:
    """A robot that ships with the package by its name, or the robot in a TOML file.

    The file has the settings of `RobotSpec`. Its beams are tables of `SensorSpec`, or
    ``beams_deg``, ``min_range`` and ``max_range`` for beams that start on the rim of the body, or
    ``lidar_beams`` in place of ``beams_deg`` for as many beams of a laser scanner.
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
    alike = [field.name for field in fields(_BeamsAlike)]
    names = [*(field.name for field in fields(RobotSpec)), *alike]
    unknown = next((name for name in table if name not in names), None)
    if unknown is not None:
        raise SettingsError(
            f"{where}: {unknown}: there is no such setting; there are {', '.join(names)}"
        )
    beams_alike = {name: table.pop(name) for name in alike if name in table}
    robot = updated(RobotSpec(), table, where)
    if not beams_alike:
        return robot
    kinds = [name for name in ("beams", *_BEAMS) if name in {**table, **beams_alike}]
    if len(kinds) != 1 or kinds == ["beams"]:
        other = next((name for name in beams_alike if name not in kinds[:1]), "")
        wrong = (
            f"{kinds[0]} and {other} both describe the beams"
            if kinds
            else f"{other} goes with {' or '.join(_BEAMS)}"
        )
        raise SettingsError(f"{where}: {wrong}")
    form = updated(_BeamsAlike(), beams_alike, where)
    is_lidar = "lidar_beams" in beams_alike
    try:
        beams = beams_on_rim(
            degrees_around(form.lidar_beams) if is_lidar else form.beams_deg,
            0.0 if is_lidar else robot.radius,
            min_range=form.min_range,
            max_range=form.max_range,
        )
        return replace(robot, beams=beams)
    except ValueError as error:
        raise SettingsError(f"{where}: {error}") from error
