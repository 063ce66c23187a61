"""The options of ``limslam run``, ``replay`` and ``live``: each is a field of a dataclass, which
says all about it.

A field with `told` is an option of the command line and a setting of the file of ``--config``. A
field without it is a setting of the file alone, or follows from an argument. An option that is not
given is None, so that the file can set it. Help shows the default of the field.
"""

import functools
import inspect
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

import typer
from typer.models import OptionInfo

from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.config.bounds import Bounded, Bounds, CountOrNone

_WORLD = "World and robots"
_AGENT = "Agent"
_RESULTS = "Settings and results"
_FAULTS = "Errors that the simulated robot has"
_LOG = "Log"
_TABLE = "Tables (.csv)"
_ODOMETRY = "Odometry"
_SCORE = "Score"
_CONNECTION = "Connection and robot"

_ROBOTS = "paper, e-puck, four-beam-drone, ring, or a TOML file with the robot's settings."
_POLICIES = (
    "Policy that drives: frontier, frontier_fast, learned, wall_follower, random, "
    "or FILE.py:CLASS for your own (a class or a function that makes a policy)."
)


def told(panel: str, words: str, shown: str | bool = True, *names: str) -> Any:
    """What the command line says about an option: its panel in the help, and the help.

    ``shown`` is the default in words, where it is not that of the field; False shows none.
    ``names`` are those of an option that does not have the name of the field.
    """
    return typer.Option(*names, help=words, rich_help_panel=panel, show_default=shown)


_Time = Annotated[float, Bounds(1e-3, 1e6)]
_Std = Annotated[float, Bounds(0.0, 1e3)]
_AssumedStd = Annotated[_Std, told(_AGENT, "Assumed standard deviation of the ranges, m.")]
_Preset = Annotated[
    str,
    told(
        _AGENT,
        "Settings of the agent: consistent, paper (the published method), odometry (no "
        "corrections), "
        "or graph (consistent, and a recorded log is smoothed at its end).",
    ),
]
_Until = Annotated[
    str,
    told(
        _AGENT,
        "When the policies frontier and frontier_fast are done: seen (no frontier is left) or "
        "walls (the robot has "
        "also looked at every place where free ground ends and the map has no wall).",
    ),
]
_Map = Annotated[
    Path | None,
    told(
        _AGENT,
        "Folder of an earlier run or replay: begin in its map, at a place that is not known.",
    ),
]
_Watch = Annotated[
    bool,
    told(
        _RESULTS,
        "Show what the robot believes in a browser while it drives, as limslam inspect does "
        "afterwards.",
    ),
]
_Out = Annotated[Path | None, told(_RESULTS, "Folder for the results.", "runs/...")]
_Force = Annotated[bool, told(_RESULTS, "Replace the results of an earlier run in that folder.")]

Config = Annotated[
    Path | None,
    told(
        _RESULTS, "TOML file of settings, like the run.toml of a result. Options win over the file."
    ),
]
"""Given beside the fields of the dataclasses, as all options below: they name a file, or a table of
it.
"""
Robot = Annotated[str | None, told(_WORLD, f"Robot: {_ROBOTS}", "paper")]
RecordingRobot = Annotated[str | None, told(_TABLE, f"Robot that recorded a table: {_ROBOTS}")]
LiveRobot = Annotated[
    str | None,
    told(_CONNECTION, f"Robot: {_ROBOTS} --ros2 needs it.", "what the robot calls itself"),
]
TrueOdometryNoise = Annotated[
    float | None,
    told(
        _FAULTS,
        "Standard deviation of each wheel's travel after 1 m, m. The agent assumes the same noise.",
        "0.0045",
    ),
]
WheelMismatch = Annotated[
    float | None,
    told(
        _FAULTS,
        "Share by which the left encoder reports too much, and the right one too little.",
        "0",
    ),
]
Sharp = Annotated[
    bool,
    told(
        _FAULTS,
        "Range errors like those of Sharp's infrared sensors: growing noise, steps, dropouts, "
        "fold-back and a cone.",
        True,
        "--sharp",
    ),
]
MetresPerPixel = Annotated[
    float | None,
    told(_WORLD, "Side of a pixel of a plan that is a picture, m. Such a plan needs it."),
]
MetresPerUnit = Annotated[
    float | None,
    told(_WORLD, "Length of a unit of a plan in SVG or DXF, m.", "what the file says"),
]
Layers = Annotated[
    str | None,
    told(
        _WORLD,
        "Layers of a plan in SVG or DXF that are walls: A,B,...",
        "those called walls or windows, or all",
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
    told(
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
class RunOptions(Bounded):
    """The options of ``limslam run``."""

    world: Annotated[
        str,
        told(
            _WORLD,
            "Name of a shipped world, random:SEED or random:SEED:40x30 (m) for a random floor "
            "plan, or a world file, which may be a plan (.png, .jpg, .svg, .dxf).",
        ),
    ] = "env1"
    noise: Annotated[
        _Std, told(_WORLD, "Standard deviation of the ranges, m. The agent assumes the same noise.")
    ] = 0.02
    preset: _Preset = DEFAULT_PRESET
    seed: Annotated[CountOrNone, told(_WORLD, "Random seed.")] = 0
    max_time: Annotated[
        _Time,
        told(
            _WORLD,
            "Longest simulated time, s. Without it, a world has 10 s for each square metre, and "
            "at least the default.",
        ),
    ] = 1800.0
    policy: Annotated[
        str, told(_AGENT, f"{_POLICIES} tour drives around the world's loop by the true pose.")
    ] = "frontier"
    until: _Until = "walls"
    laps: Annotated[
        CountOrNone, told(_AGENT, "Drive this many laps of the world's loop instead of exploring.")
    ] = 0
    robots: Annotated[
        int, Bounds(1, 8), told(_WORLD, "Number of robots that explore together, 1 to 8.")
    ] = 1
    metres_per_pixel: MetresPerPixel = None
    metres_per_unit: MetresPerUnit = None
    layers: Layers = None
    ablation: Annotated[
        str | None,
        told(
            _AGENT,
            "Part of the method to switch off: no-ekf, no-loop-closing, no-end-gate, "
            "only-best-line or none. "
            "All go with the preset paper, and no-loop-closing with every preset.",
            "none",
        ),
    ] = None
    kidnap_at: Annotated[
        float | None,
        told(
            _FAULTS,
            "Time at which the robot is carried to another place, s. The seed chooses the place.",
        ),
    ] = None
    unknown_starts: Annotated[
        bool,
        told(
            _AGENT,
            "Whether the second of two robots starts at a place that the agent does not know.",
            "no",
        ),
    ] = False
    imu: Annotated[
        bool,
        told(
            _WORLD,
            "Whether the robot measures its heading by an inertial measurement unit, too.",
            "no",
        ),
    ] = False
    map: _Map = None
    limit: Annotated[bool, told(_RESULTS, "Also compute the offline optimum.")] = False
    video: Annotated[
        Path | None, told(_RESULTS, "Write a video of the run: FILE.mp4 or FILE.gif.")
    ] = None
    watch: _Watch = False
    out: _Out = None
    force: _Force = False


@dataclass(frozen=True)
class ReplayOptions(Bounded):
    """The options of ``limslam replay``."""

    log: Path | None = None
    other_log: Path | None = None
    beams: Annotated[
        str | None,
        told(_LOG, "Directions of the beams that are used, deg: A,B,...", "all of a few"),
    ] = None
    max_range: Annotated[
        float | None, told(_LOG, "Longest range that is used, m.", "3.0, or that of --robot")
    ] = None
    missing: Annotated[
        str,
        told(
            _LOG,
            "What missing ranges (nan, empty, negative, 0, 65535) mean: nothing (was seen), "
            "not-measured, or auto, what the log says.",
        ),
    ] = "auto"
    metres_per_tick: Annotated[
        float, told(_TABLE, "Wheel travel for each 1 in left and right, m.")
    ] = 1.0
    accumulated: Annotated[
        bool,
        told(_TABLE, "The columns left and right count from the start, not from the row before."),
    ] = False
    axle: Annotated[
        float | None,
        told(_TABLE, "Distance between the wheels, m, in place of the robot's.", "that of --robot"),
    ] = None
    range_unit: Annotated[
        str | None, told(_TABLE, "Unit of the ranges: m, cm or mm.", "that of their names, or m")
    ] = None
    time_unit: Annotated[
        str | None,
        told(
            _TABLE,
            "Unit of the times: s, ms, us or ns.",
            "that of the name or of the spacing, or s",
        ),
    ] = None
    angle_unit: Annotated[
        str | None,
        told(_TABLE, "Unit of headings and turns: rad or deg.", "that of their names, or rad"),
    ] = None
    position_unit: Annotated[
        str | None,
        told(
            _TABLE,
            "Unit of positions and travelled distances: m, cm or mm.",
            "that of their names, or m",
        ),
    ] = None
    wheel_radius: Annotated[
        float | None, told(_TABLE, "Radius of the wheels, m, of speeds in rad/s or rpm.", "none")
    ] = None
    zone_axes: Annotated[
        str | None,
        told(
            _TABLE,
            "Axes of multi-zone sensors, deg: A,B,...; their ranges are perpendicular distances.",
        ),
    ] = None
    columns: Annotated[
        str | None,
        told(
            _TABLE,
            "What the columns hold, in place of the header: t,left,right,r_90,..., with - for one "
            "not used, and - before the name of one that counts the other way.",
        ),
    ] = None
    dry_run: Annotated[
        bool, told(_LOG, "Say how the log is read, with its first rows, and stop.")
    ] = False
    as_read: Annotated[
        bool,
        told(
            _LOG,
            "Replay the log even if its ranges fit far better with its wheels read in another way.",
        ),
    ] = False
    noise: _AssumedStd = 0.02
    preset: _Preset = DEFAULT_PRESET
    map: _Map = None
    odometry_noise: Annotated[
        str | None,
        told(
            _ODOMETRY,
            "Three standard deviations: of the distance after 1 m (m), of the heading after 1 m "
            "(deg), "
            "and of the heading after a turn of 1 rad (deg).",
            "0.05,0.8,4",
        ),
    ] = None
    odometry_bias: Annotated[
        str | None,
        told(
            _ODOMETRY,
            "True minus reported heading after 1 m (deg), and true distance over reported "
            "distance.",
            "0,1",
        ),
    ] = None
    calibrate: Annotated[
        Path | None, told(_ODOMETRY, "File of known relative poses to estimate the bias from.")
    ] = None
    topics: Annotated[
        str | None,
        told(
            _LOG,
            "Topics of a ROS bag: A,B,... of scans, of ranges (TOPIC:DEG), and of an odometry.",
        ),
    ] = None
    relations: Path | None = None
    other_relations: Path | None = None
    out: _Out = None
    force: _Force = False


@dataclass(frozen=True)
class LiveOptions(Bounded):
    """The options of ``limslam live``, and ``baud``, bits per second of the serial port, which a
    file may set.
    """

    serial: Annotated[
        str | None, told(_CONNECTION, "Serial port of the robot, like /dev/ttyUSB0 or COM3.")
    ] = None
    baud: Annotated[int, Bounds(300, 10**7)] = 115200
    udp: Annotated[int | None, told(_CONNECTION, "UDP port on which to wait for the robot.")] = None
    listen: Annotated[
        str,
        told(
            _CONNECTION,
            "Address of this computer where --udp listens. 0.0.0.0 hears robots in its networks.",
        ),
    ] = "127.0.0.1"
    token: Annotated[
        str | None,
        told(_CONNECTION, "With --udp, drive only a robot that says this word in its hello."),
    ] = None
    ros2: Annotated[
        bool, told(_CONNECTION, "The robot is one of ROS 2, with scan or ranges, odom and cmd_vel.")
    ] = False
    patience: Annotated[
        float,
        Bounds(0.1, 3600.0),
        told(_CONNECTION, "How long to wait for a robot that is silent, s."),
    ] = 10.0
    max_time: Annotated[
        _Time, told(_CONNECTION, "Longest time of the session by the robot's clock, s.")
    ] = 1800.0
    noise: _AssumedStd = 0.02
    preset: _Preset = DEFAULT_PRESET
    policy: Annotated[str, told(_AGENT, _POLICIES)] = "frontier"
    until: _Until = "walls"
    watch: _Watch = False
    out: _Out = None
    force: _Force = False


Options = TypeVar("Options", RunOptions, ReplayOptions, LiveOptions)


def takes(kind: type[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a function a command that has the options of a dataclass, and then those of its own
    named arguments.

    The function gets the options of the dataclass as keyword arguments, None for those that were
    not given.
    """

    def decorated(function: Callable[..., None]) -> Callable[..., None]:
        own = [
            each
            for each in inspect.signature(function).parameters.values()
            if each.kind is not each.VAR_KEYWORD
        ]

        @functools.wraps(function)
        def command(**arguments: Any) -> None:
            function(**arguments)

        parameters = [*_declared(kind), *own]
        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined] # what typer looks at
        command.__annotations__ = {each.name: each.annotation for each in parameters}
        return command

    return decorated


def _declared(kind: type[Any]) -> list[inspect.Parameter]:
    """The arguments of a function that typer makes the options of a dataclass of."""
    hints = get_type_hints(kind, include_extras=True)
    found = list[inspect.Parameter]()
    for field in fields(kind):
        plain, *extras = (
            get_args(hints[field.name]) if hasattr(hints[field.name], "__metadata__") else (None,)
        )
        said = next((each for each in extras if isinstance(each, OptionInfo)), None)
        if said is None:
            continue
        option = copy(said)
        if option.show_default is True:
            is_shown = field.default is not None and field.default is not False
            option.show_default = (
                f"{field.default:g}" if isinstance(field.default, float) else str(field.default)
            )
            option.show_default = option.show_default if is_shown else False
        if isinstance(option.default, str):  # where typer keeps the first name of an option
            option.param_decls = (option.default,)
        elif plain is bool:  # nothing is said to switch it off
            option.param_decls = (f"--{field.name.replace('_', '-')}",)
        option.default = None
        kind_of_argument = inspect.Parameter.POSITIONAL_OR_KEYWORD
        found.append(
            inspect.Parameter(field.name, kind_of_argument, default=option, annotation=plain | None)
        )
    return found
