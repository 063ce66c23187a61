"""What a run is: the options of ``limslam run`` that are not about its files.

The command line fills it, ``run.toml`` keeps it, suites vary it, and `RunConfig` adds the robot and
the agent to it. This file imports nothing that takes long.
"""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.config.bounds import Bounded, Bounds, CountOrNone
from limslam_agent.config.help import Help

WORLD = "World and robots"
AGENT = "Agent"
RESULTS = "Settings and results"
FAULTS = "Errors that the simulated robot has"
"""Panels of the help."""

LONGEST_TIME = 1e6
"""Longest simulated time of a run, s."""

POLICIES = (
    "Policy that drives: frontier, frontier_fast, learned, wall_follower, random, "
    "or FILE.py:CLASS for your own (a class or a function that makes a policy)."
)

Time = Annotated[float, Bounds(1e-3, LONGEST_TIME)]
Std = Annotated[float, Bounds(0.0, 1e3)]
Preset = Annotated[
    str,
    Help(
        AGENT,
        "Settings of the agent: consistent, paper (the published method), odometry (no "
        "corrections), "
        "or graph (consistent, and a recorded log is smoothed at its end).",
    ),
]
Until = Annotated[
    str,
    Help(
        AGENT,
        "When the policies frontier and frontier_fast are done: seen (no frontier is left) or "
        "walls (the robot has "
        "also looked at every place where free ground ends and the map has no wall).",
    ),
]
Map = Annotated[
    Path | None,
    Help(
        AGENT,
        "Folder of an earlier run or replay: begin in its map, at a place that is not known.",
    ),
]


@dataclass(frozen=True)
class RunSpec(Bounded):
    """What a run is, without the robot and the agent's settings. Each field is an option."""

    world: Annotated[
        str,
        Help(
            WORLD,
            "Name of a shipped world, random:SEED or random:SEED:40x30 (m) for a random floor "
            "plan, or a world file, which may be a plan (.png, .jpg, .svg, .dxf).",
        ),
    ] = "env1"
    noise: Annotated[
        Std, Help(WORLD, "Standard deviation of the ranges, m. The agent assumes the same noise.")
    ] = 0.02
    preset: Preset = DEFAULT_PRESET
    seed: Annotated[CountOrNone, Help(WORLD, "Random seed.")] = 0
    max_time: Annotated[
        Time,
        Help(
            WORLD,
            "Longest simulated time, s. Without it, a world has 10 s for each square metre, and "
            "at least the default.",
        ),
    ] = 1800.0
    policy: Annotated[
        str,
        Help(
            AGENT,
            f"{POLICIES} tour drives around the world's loop by the true pose, and keyboard is "
            "driven in a window (limslam play).",
        ),
    ] = "frontier"
    until: Until = "walls"
    laps: Annotated[
        CountOrNone, Help(AGENT, "Drive this many laps of the world's loop instead of exploring.")
    ] = 0
    robots: Annotated[
        int,
        Bounds(1, 8, is_whole=True),
        Help(WORLD, "Number of robots that explore together, 1 to 8."),
    ] = 1
    ablation: Annotated[
        str | None,
        Help(
            AGENT,
            "Part of the method to switch off: no-ekf, no-loop-closing, no-end-gate, "
            "only-best-line or none. "
            "All go with the preset paper, and no-loop-closing with every preset.",
            "none",
        ),
    ] = None
    kidnap_at: Annotated[
        float | None,
        Help(
            FAULTS,
            "Time at which the robot is carried to another place, s. The seed chooses the place.",
        ),
    ] = None
    unknown_starts: Annotated[
        bool,
        Help(
            AGENT,
            "Whether the second of two robots starts at a place that the agent does not know.",
            "no",
        ),
    ] = False
    imu: Annotated[
        bool,
        Help(
            WORLD,
            "Whether the robot measures its heading by an inertial measurement unit, too.",
            "no",
        ),
    ] = False
    map: Map = None
    limit: Annotated[bool, Help(RESULTS, "Also compute the offline optimum.")] = False

    @property
    def spec(self) -> dict[str, Any]:
        """The fields of a `RunSpec` by their names, without those of other classes."""
        return {field.name: getattr(self, field.name) for field in fields(RunSpec)}
