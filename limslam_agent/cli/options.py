"""The options of ``limslam run``, ``replay`` and ``live``: each is a field of a dataclass, which
says all about it.

A field with `Help` is an option of the command line and a setting of the file of ``--config``. A
field without it is a setting of the file alone, or follows from an argument. An option that is not
given is None, so that the file can set it. Help shows the default of the field.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, TypeVar

import typer

from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.config.bounds import Bounded, Bounds
from limslam_agent.config.help import Help
from limslam_agent.runs.run_spec import (
    AGENT,
    FAULTS,
    POLICIES,
    RESULTS,
    WORLD,
    Map,
    Preset,
    RunSpec,
    Std,
    Time,
    Until,
)

if TYPE_CHECKING:
    from limslam_env.worlds.world import World

_LOG = "Log"
_TABLE = "Tables (.csv)"
_ODOMETRY = "Odometry"
_SCORE = "Score"
_CONNECTION = "Connection and robot"

_ROBOTS = "paper, e-puck, four-beam-drone, ring, lidar, or a TOML file with the robot's settings."
_AssumedStd = Annotated[Std, Help(AGENT, "Assumed standard deviation of the ranges, m.")]
_Watch = Annotated[
    bool,
    Help(
        RESULTS,
        "Show what the robot believes in a browser while it drives, as limslam inspect does "
        "afterwards.",
    ),
]
_Out = Annotated[Path | None, Help(RESULTS, "Folder for the results.", "runs/...")]
_Force = Annotated[bool, Help(RESULTS, "Replace the results of an earlier run in that folder.")]

Overwrite = Annotated[bool, typer.Option("--force", help="Replace an existing file.")]
"""Of commands that write one file."""

Config = Annotated[
    Path | None,
    Help(
        RESULTS, "TOML file of settings, like the run.toml of a result. Options win over the file."
    ),
]
"""Given beside the fields of the dataclasses, as all options below: they name a file, or a table of
it.
"""
Robot = Annotated[str | None, Help(WORLD, f"Robot: {_ROBOTS}", "paper")]
RecordingRobot = Annotated[str | None, Help(_TABLE, f"Robot that recorded a table: {_ROBOTS}")]
LiveRobot = Annotated[
    str | None,
    Help(_CONNECTION, f"Robot: {_ROBOTS} --ros2 needs it.", "what the robot calls itself"),
]
TrueOdometryNoise = Annotated[
    float | None,
    Help(
        FAULTS,
        "Standard deviation of each wheel's travel after 1 m, m. The agent assumes the same noise.",
        "0.0045",
    ),
]
WheelMismatch = Annotated[
    float | None,
    Help(
        FAULTS,
        "Share by which the left encoder reports too much, and the right one too little.",
        "0",
    ),
]
Sharp = Annotated[
    bool,
    Help(
        FAULTS,
        "Range errors like those of Sharp's infrared sensors: growing noise, steps, dropouts, "
        "fold-back and a cone.",
        True,
        "--sharp",
    ),
]
Log = Annotated[
    list[Path] | None,
    typer.Argument(
        help=(
            "A CARMEN log, a table (.csv), a ROS bag, or the log.npz of a run. Two logs are "
            "joined if they fit."
        ),
        show_default=False,
    ),
]
RelationsFile = Annotated[
    list[Path] | None,
    Help(
        _SCORE,
        "File of known relative poses to score the trajectory with. Of two logs: once for both, "
        "or once for each.",
    ),
]
RosArguments = Annotated[
    list[str] | None,
    typer.Argument(
        help="Arguments for ROS 2, after --: -- --ros-args -p NAME:=VALUE -r FROM:=TO.",
        show_default=False,
    ),
]


@dataclass(frozen=True)
class PlanOptions(Bounded):
    """How a world's file is read that is a plan."""

    metres_per_pixel: Annotated[
        float | None,
        Help(WORLD, "Side of a pixel of a plan that is a picture, m. Such a plan needs it."),
    ] = None
    metres_per_unit: Annotated[
        float | None,
        Help(WORLD, "Length of a unit of a plan in SVG or DXF, m.", "what the file says"),
    ] = None
    layers: Annotated[
        str | None,
        Help(
            WORLD,
            "Layers of a plan in SVG or DXF that are walls: A,B,...",
            "those called walls or windows, or all",
        ),
    ] = None

    def load(self, world: str) -> "World":
        """The world of that name or file."""
        from limslam_env.worlds.formats.loading import load_world

        names = None if self.layers is None else [each.strip() for each in self.layers.split(",")]
        return load_world(
            world,
            metres_per_pixel=self.metres_per_pixel,
            metres_per_unit=self.metres_per_unit,
            layers=names,
        )


@dataclass(frozen=True)
class RunOptions(PlanOptions, RunSpec):
    """The options of ``limslam run``: what is run, how a plan is read, and where results go."""

    video: Annotated[
        Path | None, Help(RESULTS, "Write a video of the run: FILE.mp4 or FILE.gif.")
    ] = None
    watch: _Watch = False
    out: _Out = None
    force: _Force = False
    tables: ClassVar[tuple[str, ...]] = ("agent", "robot", "true_noise")


@dataclass(frozen=True)
class ReplayOptions(Bounded):
    """The options of ``limslam replay``."""

    log: Path | None = None
    other_log: Path | None = None
    beams: Annotated[
        str | None,
        Help(_LOG, "Directions of the beams that are used, deg: A,B,...", "all of a few"),
    ] = None
    max_range: Annotated[
        float | None, Help(_LOG, "Longest range that is used, m.", "3.0, or that of --robot")
    ] = None
    missing: Annotated[
        str,
        Help(
            _LOG,
            "What missing ranges (nan, empty, negative, 0, 65535) mean: nothing (was seen), "
            "not-measured, or auto, what the log says.",
        ),
    ] = "auto"
    metres_per_tick: Annotated[
        float, Help(_TABLE, "Wheel travel for each 1 in left and right, m.")
    ] = 1.0
    accumulated: Annotated[
        bool,
        Help(_TABLE, "The columns left and right count from the start, not from the row before."),
    ] = False
    axle: Annotated[
        float | None,
        Help(_TABLE, "Distance between the wheels, m, in place of the robot's.", "that of --robot"),
    ] = None
    range_unit: Annotated[
        str | None,
        Help(_TABLE, "Unit of the ranges: m, cm, mm or in.", "that of their names, or m"),
    ] = None
    time_unit: Annotated[
        str | None,
        Help(
            _TABLE,
            "Unit of the times: s, ms, us or ns.",
            "that of the name or of the spacing, or s",
        ),
    ] = None
    rate: Annotated[
        float | None, Help(_TABLE, "Rows in a second, in place of a column of times.", "none")
    ] = None
    angle_unit: Annotated[
        str | None,
        Help(_TABLE, "Unit of headings and turns: rad or deg.", "that of their names, or rad"),
    ] = None
    position_unit: Annotated[
        str | None,
        Help(
            _TABLE,
            "Unit of positions and travelled distances: m, cm, mm or in.",
            "that of their names, or m",
        ),
    ] = None
    wheel_radius: Annotated[
        float | None,
        Help(_TABLE, "Radius of the wheels, m, of turns in rad, rad/s or rpm.", "none"),
    ] = None
    zone_axes: Annotated[
        str | None,
        Help(
            _TABLE,
            "Axes of multi-zone sensors, deg: A,B,...; their ranges are perpendicular distances.",
        ),
    ] = None
    columns: Annotated[
        str | None,
        Help(
            _TABLE,
            "What the columns hold, in place of the header: t,left,right,r_90,..., with - for one "
            "not used, and - before the name of one that counts the other way.",
        ),
    ] = None
    dry_run: Annotated[
        bool, Help(_LOG, "Say how the log is read, with its first rows, and stop.")
    ] = False
    as_read: Annotated[
        bool,
        Help(
            _LOG,
            "Replay the log even if its ranges fit far better with its wheels read in another way.",
        ),
    ] = False
    noise: _AssumedStd = 0.02
    preset: Preset = DEFAULT_PRESET
    map: Map = None
    odometry_noise: Annotated[
        str | None,
        Help(
            _ODOMETRY,
            "Three standard deviations: of the distance after 1 m (m), of the heading after 1 m "
            "(deg), "
            "and of the heading after a turn of 1 rad (deg).",
            "0.05,0.8,4",
        ),
    ] = None
    odometry_bias: Annotated[
        str | None,
        Help(
            _ODOMETRY,
            "True minus reported heading after 1 m (deg), and true distance over reported "
            "distance.",
            "0,1",
        ),
    ] = None
    calibrate: Annotated[
        Path | None, Help(_ODOMETRY, "File of known relative poses to estimate the bias from.")
    ] = None
    topics: Annotated[
        str | None,
        Help(
            _LOG,
            "Topics of a ROS bag: A,B,... of scans, of ranges (TOPIC:DEG), and of an odometry.",
        ),
    ] = None
    relations: Path | None = None
    other_relations: Path | None = None
    out: _Out = None
    force: _Force = False
    tables: ClassVar[tuple[str, ...]] = ("agent", "robot")


@dataclass(frozen=True)
class LiveOptions(Bounded):
    """The options of ``limslam live``, and ``baud``, bits per second of the serial port, which a
    file may set.
    """

    serial: Annotated[
        str | None, Help(_CONNECTION, "Serial port of the robot, like /dev/ttyUSB0 or COM3.")
    ] = None
    baud: Annotated[int, Bounds(300, 10**7)] = 115200
    udp: Annotated[int | None, Help(_CONNECTION, "UDP port on which to wait for the robot.")] = None
    listen: Annotated[
        str,
        Help(
            _CONNECTION,
            "Address of this computer where --udp listens. 0.0.0.0 hears robots in its networks.",
        ),
    ] = "127.0.0.1"
    token: Annotated[
        str | None,
        Help(_CONNECTION, "With --udp, drive only a robot that says this word in its hello."),
    ] = None
    ros2: Annotated[
        bool, Help(_CONNECTION, "The robot is one of ROS 2, with scan or ranges, odom and cmd_vel.")
    ] = False
    patience: Annotated[
        float,
        Bounds(0.1, 3600.0),
        Help(_CONNECTION, "How long to wait for a robot that is silent, s."),
    ] = 10.0
    max_time: Annotated[
        Time, Help(_CONNECTION, "Longest time of the session by the robot's clock, s.")
    ] = 1800.0
    noise: _AssumedStd = 0.02
    preset: Preset = DEFAULT_PRESET
    policy: Annotated[str, Help(AGENT, POLICIES)] = "frontier"
    until: Until = "walls"
    map: Map = None
    stay: Annotated[
        bool,
        Help(AGENT, "When nothing is left to explore, wait for orders instead of ending."),
    ] = False
    watch: _Watch = False
    out: _Out = None
    force: _Force = False
    tables: ClassVar[tuple[str, ...]] = ("agent", "robot")


Options = TypeVar("Options", RunOptions, ReplayOptions, LiveOptions)
