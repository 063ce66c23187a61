"""The options of the commands: their names, types and help texts.

An option that is not given is None, so that the file of ``--config`` can set it. Help shows the default of
`RunOptions` or `ReplayOptions`.
"""

from pathlib import Path
from typing import Annotated, Any

import typer

from limslam_agent.cli.settings import LiveOptions, ReplayOptions, RunOptions

_RUN, _REPLAY, _LIVE = RunOptions(), ReplayOptions(), LiveOptions()
_WORLD, _AGENT, _RESULTS = "World and robots", "Agent", "Settings and results"
_FAULTS = "Errors that the simulated robot has"
_LOG, _TABLE, _ODOMETRY, _SCORE = "Log", "Tables (.csv)", "Odometry", "Score"
_CONNECTION = "Connection and robot"
_PRESETS = (
    "Settings of the agent: consistent, paper (the published method), odometry (no corrections), "
    "or graph (consistent, and a recorded log is smoothed at its end)."
)


def _option(panel: str, words: str, default: Any = None, *names: str) -> Any:
    shown = False if default is None else str(default)
    return typer.Option(*names, help=words, show_default=shown, rich_help_panel=panel)


# Of several commands.
Config = Annotated[
    Path | None, _option(_RESULTS, "TOML file of settings, like the run.toml of a result. Options win over the file.")
]
Out = Annotated[Path | None, _option(_RESULTS, "Folder for the results.", "runs/...")]
Force = Annotated[
    bool | None, _option(_RESULTS, "Replace the results of an earlier run in that folder.", None, "--force")
]

# Of limslam run.
World = Annotated[
    str | None,
    _option(
        _WORLD,
        "Name of a shipped world, random:SEED or random:SEED:40x30 (m) for a random floor plan, or a world file.",
        _RUN.world,
    ),
]
Noise = Annotated[
    float | None,
    _option(_WORLD, "Standard deviation of the ranges, m. The agent assumes the same noise.", _RUN.noise),
]
Robot = Annotated[
    str | None,
    _option(_WORLD, "Robot: paper, e-puck, four-beam-drone, ring, or a TOML file with the robot's settings.", "paper"),
]
TrueOdometryNoise = Annotated[
    float | None,
    _option(
        _FAULTS, "Standard deviation of each wheel's travel after 1 m, m. The agent assumes the same noise.", "0.0045"
    ),
]
WheelMismatch = Annotated[
    float | None,
    _option(_FAULTS, "Share by which the left encoder reports too much, and the right one too little.", "0"),
]
AxleMismatch = Annotated[
    float | None, _option(_FAULTS, "Share by which the wheels are farther apart than the agent is told.", "0")
]
SlipRate = Annotated[float | None, _option(_FAULTS, "How often a wheel slips in 1 m of travel.", "0")]
SlipShare = Annotated[float | None, _option(_FAULTS, "Share of a step's travel that a slip loses.", "0.5")]
Dropout = Annotated[float | None, _option(_FAULTS, "Probability that a beam misses what it should have seen.", "0")]
Sharp = Annotated[
    bool | None,
    _option(
        _FAULTS,
        "Range errors like those of Sharp's infrared sensors: growing noise, steps, dropouts, fold-back and a cone.",
        None,
        "--sharp",
    ),
]
PriorMap = Annotated[
    Path | None,
    _option(_AGENT, "Folder of an earlier run or replay: begin in its map, at a place that is not known."),
]
KidnapAt = Annotated[
    float | None,
    _option(_FAULTS, "Time at which the robot is carried to another place, s. The seed chooses the place."),
]
Calibration = Annotated[
    bool | None,
    _option(
        _AGENT,
        "Whether the filter estimates the sizes of wheels and axle where they differ from the robot's settings.",
        "calibration",
    ),
]
Robots = Annotated[int | None, _option(_WORLD, "Number of robots that explore together, 1 to 8.", _RUN.robots)]
UnknownStarts = Annotated[
    bool | None,
    _option(
        _AGENT,
        "Whether the second of two robots starts at a place that the agent does not know.",
        "no",
        "--unknown-starts",
    ),
]
Seed = Annotated[int | None, _option(_WORLD, "Random seed.", _RUN.seed)]
MaxTime = Annotated[
    float | None,
    _option(
        _WORLD,
        "Longest simulated time, s. Without it, a world has 10 s for each square metre, and at least the default.",
        f"{_RUN.max_time:g}",
    ),
]
RunPreset = Annotated[str | None, _option(_AGENT, _PRESETS, _RUN.preset)]
Policy = Annotated[
    str | None,
    _option(
        _AGENT,
        "Policy that drives: frontier, frontier_fast, learned, wall_follower, random, "
        "or FILE.py:CLASS for your own (a class or a function that makes a policy). "
        "These policies use the true pose or the true map: learned_true_pose, tour, oracle.",
        _RUN.policy,
    ),
]
Until = Annotated[
    str | None,
    _option(
        _AGENT,
        "When the policies frontier and frontier_fast are done: seen (no frontier is left) or walls (the robot has "
        "also looked at every place where free ground ends and the map has no wall).",
        _RUN.until,
    ),
]
Laps = Annotated[
    int | None, _option(_AGENT, "Drive this many laps of the world's loop instead of exploring.", _RUN.laps)
]
Ablation = Annotated[
    str | None,
    _option(
        _AGENT,
        "Part of the method to switch off: no-ekf, no-loop-closing, no-end-gate, only-best-line or none. "
        "All go with the preset paper, and no-loop-closing with every preset.",
        "none",
    ),
]
Limit = Annotated[bool | None, _option(_RESULTS, "Also compute the offline optimum (needs gtsam).")]
FilmSpeed = Annotated[
    float | None,
    _option(
        _RESULTS,
        "How much faster the video is than the run, 1 to 100. Pauses for explanations make the video longer.",
        f"{_RUN.film_speed:g}",
    ),
]
Watch = Annotated[
    bool | None,
    _option(
        _RESULTS,
        "Show what the robot believes in a browser while it drives, as limslam inspect does afterwards.",
        None,
        "--watch",
    ),
]
Video = Annotated[Path | None, _option(_RESULTS, "Write a video of the run: FILE.mp4 or FILE.gif.")]

# Of limslam replay.
Log = Annotated[
    list[Path] | None,
    typer.Argument(
        help="A CARMEN log, a table (.csv), a ROS bag, or the log.npz of a run. Two logs are joined if they fit.",
        show_default=False,
    ),
]
Beams = Annotated[str | None, _option(_LOG, "Directions of the beams that are used, deg: A,B,...", "all of a few")]
MaxRange = Annotated[float | None, _option(_LOG, "Longest range that is used, m.", "3.0, or that of --robot")]
RecordingRobot = Annotated[
    str | None,
    _option(
        _TABLE,
        "Robot that recorded a table: paper, e-puck, four-beam-drone, ring, or a TOML file with the robot's settings.",
    ),
]
MetresPerTick = Annotated[
    float | None, _option(_TABLE, "Wheel travel for each 1 in left and right, m.", f"{_REPLAY.metres_per_tick:g}")
]
Accumulated = Annotated[
    bool | None,
    _option(_TABLE, "The columns left and right count from the start, not from the row before."),
]
RangeUnit = Annotated[str | None, _option(_TABLE, "Unit of the ranges: m, cm or mm.", _REPLAY.range_unit)]
TimeUnit = Annotated[str | None, _option(_TABLE, "Unit of the times: s, ms or us.", _REPLAY.time_unit)]
ZoneAxes = Annotated[
    str | None,
    _option(_TABLE, "Axes of multi-zone sensors, deg: A,B,...; their ranges are perpendicular distances."),
]
Columns = Annotated[
    str | None,
    _option(_TABLE, "What the columns hold, in place of the header: t,left,right,r_90,..., and - for one not used."),
]
ZeroIsNothing = Annotated[
    bool | None,
    _option(_TABLE, "A range of 0 or less says that nothing was seen. Else 0 is too near, and less is no reading."),
]
Topics = Annotated[
    str | None,
    _option(_LOG, "Topics of a ROS bag: A,B,... of scans, of ranges (TOPIC:DEG), and of an odometry."),
]
MaxSize = Annotated[float | None, _option(_LOG, "Largest log that is read, unpacked, MB.", f"{_REPLAY.max_size:g}")]
AssumedNoise = Annotated[float | None, _option(_AGENT, "Assumed standard deviation of the ranges, m.", _REPLAY.noise)]
ReplayPreset = Annotated[str | None, _option(_AGENT, _PRESETS, _REPLAY.preset)]
OdometryNoise = Annotated[
    str | None,
    _option(
        _ODOMETRY,
        "Three standard deviations: of the distance after 1 m (m), of the heading after 1 m (deg), "
        "and of the heading after a turn of 1 rad (deg).",
        "0.05,0.8,4",
    ),
]
OdometryBias = Annotated[
    str | None,
    _option(_ODOMETRY, "True minus reported heading after 1 m (deg), and true distance over reported distance.", "0,1"),
]
SelfCalibrate = Annotated[
    bool | None,
    _option(
        _ODOMETRY,
        "Let the filter always, or never, estimate the constant errors of the odometry (presets graph and consistent).",
        "where needed",
    ),
]
Calibrate = Annotated[Path | None, _option(_ODOMETRY, "File of known relative poses to estimate the bias from.")]
RelationsFile = Annotated[
    list[Path] | None,
    _option(
        _SCORE,
        "File of known relative poses to score the trajectory with. Of two logs: once for both, or once for each.",
    ),
]

# Of limslam live.
Serial = Annotated[str | None, _option(_CONNECTION, "Serial port of the robot, like /dev/ttyUSB0 or COM3.")]
Baud = Annotated[int | None, _option(_CONNECTION, "Bits per second of the serial port.", _LIVE.baud)]
Udp = Annotated[int | None, _option(_CONNECTION, "UDP port on which to wait for the robot.")]
Ros2 = Annotated[
    bool | None,
    _option(_CONNECTION, "The robot is one of ROS 2, with scan or ranges, odom and cmd_vel.", None, "--ros2"),
]
RosArguments = Annotated[
    list[str] | None,
    typer.Argument(help="Arguments for ROS 2, after --: -- --ros-args -p NAME:=VALUE -r FROM:=TO.", show_default=False),
]
LiveRobot = Annotated[
    str | None,
    _option(
        _CONNECTION,
        "Robot: paper, e-puck, four-beam-drone, ring, or a TOML file with the robot's settings. --ros2 needs it.",
        "what the robot calls itself",
    ),
]
Patience = Annotated[
    float | None,
    _option(_CONNECTION, "How long to wait for a robot that is silent, s.", f"{_LIVE.patience:g}"),
]
LivePolicy = Annotated[
    str | None,
    _option(
        _AGENT,
        "Policy that drives: frontier, frontier_fast, learned, wall_follower, random, "
        "or FILE.py:CLASS for your own (a class or a function that makes a policy).",
        _LIVE.policy,
    ),
]
LiveTime = Annotated[
    float | None,
    _option(_CONNECTION, "Longest time of the session by the robot's clock, s.", f"{_LIVE.max_time:g}"),
]
