"""The rows of the scoreboard, read from a TOML file. A row is a condition, and its cells are drives
under it.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal

from benchmarks.suite.faults import FAULTS
from benchmarks.suite.jobs import Job
from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.config.tables import built, read_toml
from limslam_env.config import NoiseConfig
from limslam_env.interface import RobotSpec

SHIPPED = Path(__file__).parent / "rows.toml"

Kind = Literal[
    "batch",
    "campus log",
    "drive",
    "exploration",
    "flight",
    "log",
    "made-up log",
    "second drive",
    "two logs",
]


@dataclass(frozen=True)
class Row:
    """A row of the scoreboard."""

    name: str  # name of the row
    # ``drive``: a drive that depends on the seed alone, replayed. ``exploration``: in closed loop.
    # ``log``: a log in the folder of recorded data, replayed. ``made-up log``: a log of few points,
    # of those of :mod:`benchmarks.scoreboard.made_up_logs`, smoothed. ``flight``: a short one of
    # them, replayed. ``campus log``: a long drive of :mod:`benchmarks.scoreboard.campus`, replayed.
    # ``second drive``: a drive that begins at an unknown place of the map of another one. ``two
    # logs``: two drives, joined. ``batch``: a drive by the estimator of batches.
    kind: Kind
    # worlds, seeds: worlds as in a suite, or ``pillars:seed``; and the number of seeds for each of
    # them
    worlds: tuple[str, ...] = ("",)
    seeds: int = 1
    noise: float = 0.02  # standard deviation of the ranges that the estimator is told, m
    # The simulator's noise. Its ``sensor_noise`` is ``noise`` unless it is given here.
    true_noise: NoiseConfig = field(default_factory=NoiseConfig)
    # How long a drive lasts, or the longest time of an exploration, s; after it was kidnapped, if
    # it is
    seconds: float = 150.0
    # Whether the robot of a drive drives straight on until it hits something, instead of from place
    # to place
    bumps: bool = False
    # How long the robot of a drive stands in its middle, s, beside ``seconds``
    stands: float = 0.0
    # Half the opening of the beams, rad, in truth and as the estimator is told
    cone: float = 0.0
    # fault, fault_size: a fault that the estimator is not told of, one of ``FAULTS`` of
    # :mod:`benchmarks.suite.faults`, from the start on (``delayed``: in the second half of the
    # drive), and its size where it is not that of the kind
    fault: str | None = None
    fault_size: float = math.nan
    # Standard deviation of further noise of recorded ranges, m, by which the noise of the
    # scoreboard itself is measured
    jitter: float = 0.0
    # robots, unknown_starts, kidnapped: number of robots of an exploration, whether the second
    # one's start is unknown, and the earliest and the latest time at which the robot is kidnapped,
    # s
    robots: int = 1
    unknown_starts: bool = False
    kidnapped: tuple[float, float] | None = None
    # file, relations, beams, max_range: a log and its relations in the folder of recorded data, the
    # directions of its beams, deg, and their longest range, m
    file: str = ""
    relations: str = ""
    beams: tuple[float, ...] = ()
    max_range: float = 5.0
    # preset, until: settings of the estimator, and what an exploration looks for
    preset: str = DEFAULT_PRESET
    until: str = "walls"
    # biases: by how much the ranges of each of two logs are too long, m
    biases: tuple[float, float] = (0.0, 0.0)
    # points: of made-up logs, the least and the most readings of walls in a metre of driving
    points: tuple[float, float] = (5.0, 40.0)

    def __post_init__(self) -> None:
        if self.seeds < 1 or not self.worlds:
            raise ValueError("a row needs at least one seed and one world")
        if not (self.noise >= 0.0 and self.jitter >= 0.0 and self.seconds > 0.0):
            raise ValueError("noise and jitter are 0 m or more, and the time is above 0 s")
        if self.kind == "log" and not (self.file and self.relations and self.beams):
            raise ValueError("a log needs its file, relations and beams")
        if self.fault is not None and self.fault not in FAULTS:
            raise ValueError(f"no fault is called {self.fault!r}; there are {', '.join(FAULTS)}")
        if self.kind != "drive" and (self.fault or self.bumps or self.stands or self.cone):
            raise ValueError("fault, bumps, stands and cone go with the kind drive")
        if self.cone:
            true_noise = replace(self.true_noise, cone=self.cone)
            object.__setattr__(self, "true_noise", true_noise)
        if self.kind != "exploration" and (self.robots > 1 or self.kidnapped):
            raise ValueError("robots and kidnapped go with the kind exploration")

    def cells(self, first_seed: int) -> list[Job]:
        """A job for each world and seed. The policy of the job is the name of the row."""
        return [
            Job(
                world.replace(":seed", f":{seed}") or self.file or self.kind,
                self.noise,
                self.preset,
                seed,
                policy=self.name,
                robots=self.robots,
            )
            for seed in range(first_seed, first_seed + self.seeds)
            for world in self.worlds
        ]

    @property
    def robot(self) -> RobotSpec:
        """The robot as the estimator is told of it."""
        return RobotSpec(cone=self.cone)

    @property
    def needs_data(self) -> bool:
        """Whether the row needs the folder of recorded data."""
        return self.kind in {"log", "made-up log"} or any(
            world.startswith("plan:") for world in self.worlds
        )


@dataclass(frozen=True)
class Rows:
    """A file of rows: the first seeds of development and of figures that are published, and the
    rows.
    """

    tuning_seed: int
    unused_seed: int
    row: tuple[Row, ...]

    def __post_init__(self) -> None:
        repeated = [
            name for name, count in Counter(row.name for row in self.row).items() if count > 1
        ]
        if repeated or not self.row:
            raise ValueError(
                f"each row has a name of its own, unlike {', '.join(repeated) or 'no row'}"
            )

    def chosen(self, patterns: Sequence[str]) -> list[Row]:
        """The rows whose names match one of the patterns (``*`` stands for any text); all without
        patterns.
        """
        for pattern in patterns:
            if not any(fnmatchcase(row.name, pattern) for row in self.row):
                raise ValueError(
                    f"--rows: no row is called {pattern!r}; there are "
                    f"{', '.join(r.name for r in self.row)}"
                )
        return [
            row
            for row in self.row
            if not patterns or any(fnmatchcase(row.name, each) for each in patterns)
        ]


def read_rows(path: Path = SHIPPED) -> Rows:
    """Read a file of rows."""
    return built(Rows, read_toml(path), path.name)
