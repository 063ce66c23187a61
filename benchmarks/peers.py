"""Explorers on the maps of exploration papers (ARiADNE, DARE), in the measure of these papers.

A run is scored by the distance driven, in pixels, until the beams have swept a share of the free
pixels, and until the explorer ends. Without noise the poses are known, as in the papers. With noise
the default estimator estimates them.
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.suite.jobs import Job, Metric, Outcome, Suite, digest
from benchmarks.suite.runner import Summary, run_suite
from benchmarks.suite.store import Row, read_rows
from limslam_agent.belief import Belief
from limslam_agent.config.presets import AgentConfig, preset
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.mapping.team import LimSlamTeam
from limslam_agent.measurements.processes import Processes
from limslam_agent.measurements.statistics import MISSING, mean
from limslam_agent.policies.policy import Policy, checked_action
from limslam_agent.policies.wall_policy import explorer
from limslam_agent.runs.policies import check_belief_policy, policies_by_belief
from limslam_env.config import NoiseConfig
from limslam_env.envs.parallel_env import LimSlamParallelEnv
from limslam_env.geometry import BoolArray, FloatArray, no_rows
from limslam_env.geometry.se2 import between, compose, transform_points
from limslam_env.interface import NominalNoise, Observation, RobotSpec
from limslam_env.simulation.sensors import build_wall_index, cast
from limslam_env.worlds.formats.loading import load_world
from limslam_env.worlds.formats.pictures import read_picture
from limslam_env.worlds.world import World

PIXEL = {"dungeon": 0.02, "dare": 0.025}
"""Side of a pixel of the maps in each folder, m."""

REACH = 1.6
"""Range of a laser scanner, m: 80 pixels of a dungeon, as in the papers."""

SHARES = (95, 99)
"""Shares of the free pixels, and of the coverable cells, at which the distance is noted, %."""

PUBLISHED = {
    "TARE's planner in DARE's code": ((827, 901, 971), (1113, 1211, 1375), (1565, 1759, 2063)),
    "nearest node on DARE's graph": ((926, 977, 1044), (1324, 1379, 1520), (1985, 2070, 2280)),
}
"""Distances, pixels, to 95 % and 99 % of the free pixels and to the end, on the dungeons 1 to 7 of
each kind, of planners that look all around. They were measured once with the code of the papers.
"""

KINDS = ("easy", "medium", "complex", "dare")
"""Kinds of maps."""

COLUMNS = (
    "explorer",
    "maps",
    "n",
    "95 %, px",
    "99 %, px",
    "end, px",
    "95 % of cells",
    "99 % of cells",
    "least seen",
    "ended",
    "touches",
)
"""Columns of the table: distances to shares of the free pixels and to the end, and to shares of the
coverable cells; the least share of the free pixels that was seen, how many ended, and contacts.
"""

_SIX = 6
_SAMPLED = 0.9  # pixels between the points of a beam


@dataclass(frozen=True)
class Entrant:
    """What explores: a policy, and the number of beams. Six are those of the paper's robot, and
    others those of a laser scanner.
    """

    policy: str
    beams: int

    @property
    def name(self) -> str:
        """The name in results."""
        return f"{self.policy}, {self.beams} beams"

    @property
    def robot(self) -> RobotSpec:
        """The robot."""
        return RobotSpec() if self.beams == _SIX else RobotSpec.lidar(self.beams, REACH)


def maps_in(data: Path, patterns: Sequence[str]) -> list[Path]:
    """The maps in a folder, and in those in it, whose names have one of the patterns.

    Raises
    ------
    ValueError
        If there are none, or if one of them cannot be read or does not say where robots start.
    """
    found = [
        path
        for path in sorted(data.glob("**/*.png"))
        if any(fnmatch(path.stem, pattern) for pattern in patterns)
    ]
    if not found:
        raise ValueError(f"{data}: no maps there that are called {' or '.join(patterns)} (.png)")
    for path in found:
        if not len(_world(path).starts):
            raise ValueError(
                f"{path}: a map of ARiADNE or DARE has walls (level 127), floor (195) and a block "
                "where robots start (208, or yellow)"
            )
    return found


def _pixel(path: Path) -> float:
    """Side of a pixel of a map, m."""
    return PIXEL.get(path.resolve().parent.name, PIXEL["dungeon"])


def _world(path: Path) -> World:
    return load_world(path, metres_per_pixel=_pixel(path))


def run_peers(
    maps: Sequence[Path],
    explorers: Sequence[Entrant],
    folder: Path,
    processes: Processes,
    *,
    noise: float = 0.0,
    robots: int = 1,
) -> tuple[list[str], Summary]:
    """Run what is missing in a folder of results, and the table of all that is there."""
    entrants = {entrant.name: entrant for entrant in explorers}
    for entrant in explorers:
        check_belief_policy(entrant.policy)
    jobs = tuple(
        Job(
            world=str(path),
            noise=noise,
            robots=robots,
            preset="graph",
            policy=entrant.policy,
            fault=name,
        )
        for path in maps
        for name, entrant in entrants.items()
    )
    suite = Suite("peers", jobs, digest("peers"))
    summary = run_suite(suite, folder, processes, work=partial(measure, entrants))
    return table(read_rows(folder)), summary


class Sweep:
    """The free pixels of a picture that beams have swept.

    Parameters
    ----------
    free
        Free pixels (rows, columns), the uppermost row first.
    pixel
        Side of a pixel, m.
    world, robot
        The world of that picture, and the robot that sees it.
    """

    def __init__(self, free: BoolArray, pixel: float, world: World, robot: RobotSpec) -> None:
        self._free = free[::-1]
        self._seen = np.zeros_like(self._free)
        self.pixel = pixel
        self._walls = build_wall_index(world.edges)
        self._robot = robot
        self._points = np.arange(0.0, robot.max_ranges.max(), _SAMPLED * pixel)

    def add(self, pose: FloatArray) -> None:
        """Sweep what the beams truly see from a pose (3,)."""
        robot = self._robot
        origins = transform_points(pose, robot.beam_origins)
        angles = robot.beam_angles + pose[2]
        directions = np.column_stack((np.cos(angles), np.sin(angles)))
        ranges, _ = cast(self._walls, origins, directions, robot.max_ranges)
        beam, at = np.nonzero(self._points < ranges[:, None])
        places = origins[beam] + self._points[at, None] * directions[beam]
        column, row = np.floor(places / self.pixel).astype(np.int64).T
        self._seen[row, column] = True

    @property
    def share(self) -> float:
        """Share of the free pixels that were seen."""
        return float(np.count_nonzero(self._seen & self._free) / np.count_nonzero(self._free))


class KnownPoses:
    """Robots that know their poses, and map the readings around them.

    Parameters
    ----------
    robot, config
        Body and beams of each robot, and settings.
    policies
        The policy of each robot.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig, policies: Sequence[Policy]) -> None:
        self._robot = robot
        self._grid = OccupancyGrid(config.grid)
        self.policies = policies

    def decide(self, poses: FloatArray, observations: Sequence[Observation]) -> list[FloatArray]:
        """Wheel speeds (2,) of each robot at its true pose (n, 3)."""
        ranges = [np.asarray(each["ranges"], dtype=float) for each in observations]
        everything = np.ones(len(self._robot.beams), dtype=bool)
        for pose, readings in zip(poses, ranges, strict=True):
            self._grid.update(pose, self._robot, readings, everything)
        grid = self._grid.view
        actions = []
        for each, policy in enumerate(self.policies):
            goals = [getattr(other, "goal", None) for other in self.policies if other is not policy]
            belief = Belief(
                pose=poses[each],
                covariance=np.zeros((3, 3)),
                ranges=ranges[each],
                segments=no_rows(4),
                grid=grid,
                other_poses=np.delete(poses, each, axis=0),
                other_goals=np.array([goal for goal in goals if goal is not None]).reshape(-1, 2),
            )
            actions.append(checked_action(policy, belief))
        return actions


def measure(entrants: Mapping[str, Entrant], job: Job) -> Outcome:
    """Explore a map until the explorer ends, or its time is over."""
    entrant = entrants[str(job.fault)]
    robot = entrant.robot
    config = preset(job.preset, NominalNoise(job.noise))
    path = Path(job.world)
    world = _world(path)
    env = LimSlamParallelEnv(
        world,
        num_robots=job.robots,
        robot=robot,
        noise=NoiseConfig(sensor_noise=job.noise),
        coverage_goal=None,
        max_cycles=None,
    )
    levels = read_picture(path).levels
    sweep = Sweep(levels != levels.min(), _pixel(path), world, robot)
    policies = policies_by_belief(
        entrant.policy, robot, config, robots=job.robots, seed=job.seed
    ) or [explorer(robot, config) for _ in range(job.robots)]
    decide = (
        _estimating(job, robot, config, policies)
        if job.noise
        else KnownPoses(robot, config, policies).decide
    )
    metrics, ms = _driven(job, env, sweep, policies, decide)
    return Outcome(metrics, {"decide_ms": ms}, digest(world.digest))


_Decide = Callable[[FloatArray, Sequence[Observation]], list[FloatArray]]


def _estimating(
    job: Job, robot: RobotSpec, config: AgentConfig, policies: Sequence[Policy]
) -> _Decide:
    """Decisions by estimated poses; the true ones of the first call are the starts."""
    team = LimSlamTeam(robot, config, job.robots, policies)
    is_first = True

    def decide(poses: FloatArray, observations: Sequence[Observation]) -> list[FloatArray]:
        nonlocal is_first
        if is_first:
            team.reset(poses, job.seed)
            is_first = False
        team.observe(observations)
        return team.decide()

    return decide


class _Tally:
    """How far all robots have driven, m, when shares were seen, and their touches."""

    def __init__(self, sweep: Sweep) -> None:
        self._sweep = sweep
        self._before: FloatArray | None = None
        self._touching = np.zeros(0, dtype=bool)
        self.driven = 0.0
        self.touches = 0
        self.reached: dict[str, Metric] = {}

    def add(self, poses: FloatArray, touching: BoolArray, coverage: float) -> None:
        """Add a step: true poses (n, 3), who touches something (n,), and the share of cells."""
        if self._before is not None:
            self.driven += float(np.hypot(*(poses - self._before)[:, :2].T).sum())
            self.touches += int(np.count_nonzero(touching & ~self._touching))
            # The beams go on to see between two steps, in which a robot drives a pixel or more.
            for pose in compose(self._before, 0.5 * between(self._before, poses)):
                self._sweep.add(pose)
        self._before = poses
        self._touching = touching
        for pose in poses:
            self._sweep.add(pose)
        seen = {"pixels": self._sweep.share, "cells": coverage}
        for what, share in seen.items():
            for least in SHARES:
                if 100.0 * share >= least:
                    self.reached.setdefault(f"{what}_{least}_px", self.driven / self._sweep.pixel)


def _driven(
    job: Job, env: LimSlamParallelEnv, sweep: Sweep, policies: Sequence[Policy], decide: _Decide
) -> tuple[dict[str, Metric], float]:
    """Drive the robots to the end; the metrics, and the mean time of a decision, ms."""
    observed, infos = env.reset(seed=job.seed)
    names = env.possible_agents
    tally = _Tally(sweep)
    elapsed = 0.0
    steps = 0
    while True:
        told = [infos[name] for name in names]
        poses = np.array([each["pose"] for each in told])
        coverage = told[0]["coverage"]
        tally.add(poses, np.array([each["collision"] for each in told]), coverage)
        begin = time.perf_counter()
        actions = decide(poses, [observed[name] for name in names])
        elapsed += time.perf_counter() - begin
        steps += 1
        reasons = [policy.stop_reason for policy in policies if policy.stop_reason is not None]
        is_over = len(reasons) == len(policies)
        if is_over or told[0]["time"] >= job.max_time:
            return {
                **tally.reached,
                "end_px": tally.driven / sweep.pixel if is_over else None,
                "seen": sweep.share,
                "coverage": coverage,
                "touches": tally.touches,
                "time_s": told[0]["time"],
                "reason": "; ".join(dict.fromkeys(reasons)) if is_over else None,
            }, 1e3 * elapsed / steps
        observed, _, _, _, infos = env.step(dict(zip(names, actions, strict=True)))


def table(rows: Iterable[Row]) -> list[str]:
    """Mean distances with 95 % bootstrap intervals, a line for each setting and kind of maps."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        stem = Path(row.world).stem
        kind = next((kind for kind in KINDS if stem.startswith(kind)), KINDS[-1])
        setting = f"{row.policy}, {100.0 * row.noise:g} cm" + f", {row.robots} robots" * (
            row.robots > 1
        )
        groups.setdefault((setting, kind), []).append(row)
    lines: list[tuple[str, ...]] = [
        (name, kind, "7", *map(str, distances), *[MISSING] * 5)
        for name, kinds in PUBLISHED.items()
        for kind, distances in zip(KINDS, kinds, strict=False)
    ]
    for setting, kind in sorted(groups, key=lambda key: (key[0], KINDS.index(key[1]))):
        group = groups[setting, kind]
        lines.append((setting, kind, str(len(group)), *_columns(group)))
    rows_of_text = (COLUMNS, ["---"] * len(COLUMNS), *lines)
    return ["| " + " | ".join(line) + " |" for line in rows_of_text]


def _columns(rows: Sequence[Row]) -> list[str]:
    """The figures of a group."""
    distances = ("pixels_95_px", "pixels_99_px", "end_px", "cells_95_px", "cells_99_px")
    ended = [row for row in rows if row.metrics.get("end_px") is not None]
    seen = min(_numbers(rows, "seen"), default=None)
    return [
        *(_mean(rows, name) for name in distances),
        MISSING if seen is None else f"{seen:.1%}",
        f"{len(ended)} of {len(rows)}",
        f"{sum(_numbers(rows, 'touches')):g}",
    ]


def _mean(rows: Sequence[Row], name: str) -> str:
    """The mean of a metric with its interval. A dash if not all runs have it."""
    values = _numbers(rows, name)
    found = mean(values) if len(values) == len(rows) else None
    return MISSING if found is None else found.text(0)


def _numbers(rows: Sequence[Row], name: str) -> list[float]:
    values = (row.metrics.get(name) for row in rows)
    return [float(value) for value in values if isinstance(value, int | float)]
