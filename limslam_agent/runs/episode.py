"""One run of an agent or a team in the simulator, recorded step by step.

Agent and simulator meet only in this module. The agent gets the observations and nothing else. The truth goes into the
record of the run.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.config.ablations import ablated
from limslam_agent.config.presets import AgentConfig, preset, with_until
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.joining import Joined, JoiningMapper
from limslam_agent.places.revisions import PlaceHistory
from limslam_agent.places.saved_map import read_saved_map
from limslam_agent.policies.frontier_policy import least_reach, short_reach
from limslam_agent.policies.policy import NOT_EXPLORED, Policy
from limslam_agent.runs.actor_policy import ActorPolicy
from limslam_agent.runs.kidnapping import another_place
from limslam_agent.runs.oracle import Oracle, TruePoseExplorer, check_policy, needs_loop, policies_for
from limslam_agent.runs.policy_file import naming_lines_of
from limslam_agent.runs.smoothing import FinalMap, final_map, smooth_episode
from limslam_agent.slam.core.diagnostics import Closure
from limslam_agent.slam.core.motion import OdometryCalibration
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.slam import AssociationRecord
from limslam_agent.status.status import LEVELS
from limslam_agent.team import LimSlamTeam, Snapshot
from limslam_env.bounds.offline_optimum import require_gtsam
from limslam_env.config import NoiseConfig
from limslam_env.envs.adapter import MAX_ROBOTS
from limslam_env.envs.parallel_env import LimSlamParallelEnv
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import compose
from limslam_env.interface import NominalNoise, Observation, RobotSpec
from limslam_env.simulation.coverage import CoverageGrid
from limslam_env.worlds.formats.loading import WorldSource, load_world
from limslam_env.worlds.regions import start_region
from limslam_env.worlds.world import World, WorldError

if TYPE_CHECKING:
    from limslam_agent.slam.line_graph.smoother import SmoothedRun

LONGEST_TIME = 1e6
OUT_OF_TIME = "time: the run's longest time is over"


@dataclass(frozen=True)
class RunConfig:
    """Settings of a run.

    Attributes
    ----------
    world
        Name, file or world.
    noise
        Standard deviation of the range noise, m. The agent is told this value.
    preset
        Name of the agent's settings.
    seed
        Seed of all random numbers.
    max_time
        Longest simulated time, s.
    laps
        Number of laps of the world's loop to drive instead of exploring. 0 explores. With the policy ``tour``, the
        number of times that the tour is driven.
    robot
        Body and beams of each robot.
    robots
        Number of robots, 1 to 8.
    ablation
        Part of the method that is switched off. None switches off nothing.
    policy
        Name of the policy. ``frontier`` explores, and ``frontier_fast`` explores at top speed. ``learned`` is a trained
        network. ``learned_true_pose`` is a network whose map is drawn from the true pose. ``wall_follower`` and
        ``random`` are simple baselines. ``FILE.py:NAME`` is a class or a function of that file, which makes a policy.
        ``tour`` and ``oracle`` know the true map and the true pose, while the
        estimators listen: ``tour`` drives around the world's loop, or without a loop past everything that can be seen
        and back, and ``oracle`` drives past everything as fast as possible.
    limit
        Whether to also compare the run with the offline optimum of its log, which needs gtsam.
    settings
        The agent's settings before the ablation. The preset's settings by default.
    until
        When the policies ``frontier`` and ``frontier_fast`` are done: ``seen`` or ``walls``
        (:func:`~limslam_agent.config.presets.with_until`). None leaves this to the settings, whose default is ``seen``.
    kidnap_at
        Time at which the robot is carried to a random place, s. None leaves it alone.
    prior_map
        Folder of an earlier run. The robot begins in its map, at a place that the agent does not know. None begins with
        an empty map and a known start pose.
    unknown_starts
        Whether the second of two robots starts at a place that the agent does not know.
    true_noise
        The simulator's noise. Its ``sensor_noise`` is replaced by ``noise``.
    driver
        What the results call the policies that :func:`run_episode` is given. Empty calls them by ``policy``.

    Raises
    ------
    ValueError
        If a number is out of bounds, a preset or policy does not exist, the settings do not go together, the world
        cannot be used or has no loop to drive laps on, or gtsam is missing for the offline optimum.
    """

    world: WorldSource = "env1"
    noise: float = 0.0
    preset: str = DEFAULT_PRESET
    seed: int = 0
    max_time: float = 1800.0
    laps: int = 0
    robot: RobotSpec = field(default_factory=RobotSpec)
    robots: int = 1
    ablation: str | None = None
    policy: str = "frontier"
    limit: bool = False
    settings: AgentConfig | None = None
    true_noise: NoiseConfig = field(default_factory=NoiseConfig)
    until: str | None = None
    kidnap_at: float | None = None
    prior_map: Path | None = None
    unknown_starts: bool = False
    driver: str = ""

    def __post_init__(self) -> None:
        _ = self.agent
        if self.limit:
            require_gtsam()
        if not 1 <= self.robots <= MAX_ROBOTS:
            raise ValueError(f"there can be 1 to {MAX_ROBOTS} robots, not {self.robots}")
        if not 0.0 < self.max_time <= LONGEST_TIME:
            raise ValueError(f"the longest time must be above 0 s and up to {LONGEST_TIME:g} s, not {self.max_time:g}")
        self._check_kidnapping()
        self._check_prior_map()
        self._check_unknown_starts()
        if self.laps < 0:
            raise ValueError(f"laps must be 0 or more, not {self.laps}")
        check_policy(self.policy, self.laps, self.robots)
        if self.seed < 0:
            raise ValueError(f"a seed is 0 or more, not {self.seed}")
        world = load_world(self.world)
        if needs_loop(self.policy, self.laps) and len(world.loop) < 3:
            raise WorldError(f"world {world.name!r} has no loop to drive laps on")
        world.check(self.robot.radius)

    def _check_prior_map(self) -> None:
        if self.prior_map is None:
            return
        if self.robots > 1 or self.laps or self.limit or self.agent.recovery is None:
            raise ValueError(
                "a map of an earlier run is for one robot that explores with the preset graph or consistent"
            )
        OccupancyGrid.of(read_saved_map(self.prior_map).grid, self.agent.grid)

    def _check_unknown_starts(self) -> None:
        if not self.unknown_starts:
            return
        if self.robots != 2:
            raise ValueError(f"unknown starts are for two robots, not {self.robots}")
        if self.laps or self.limit or self.policy != "frontier" or self.agent.recovery is None:
            raise ValueError("unknown starts are for the policy frontier with the preset graph or consistent")

    def _check_kidnapping(self) -> None:
        if self.kidnap_at is None:
            return
        if not 0.0 < self.kidnap_at <= LONGEST_TIME:
            raise ValueError(
                f"a robot is kidnapped after 0 s and within {LONGEST_TIME:g} s, not at {self.kidnap_at:g} s"
            )
        if self.robots > 1 or self.limit:
            what = "one of several robots" if self.robots > 1 else "a run that is compared with the offline optimum"
            raise ValueError(f"{what} cannot be kidnapped")

    @property
    def agent(self) -> AgentConfig:
        """The agent's settings, with the noise that the agent is told."""
        config = self.settings or preset(self.preset, NominalNoise(self.noise))
        if self.until is not None:
            config = with_until(config, self.until)
        return config if self.ablation is None else ablated(config, self.ablation)

    @property
    def warnings(self) -> list[str]:
        """Reasons why the run cannot explore the world, one line each.

        They are a small start region, an open outer wall, or beams that are too short for the policy.
        """
        region = start_region(load_world(self.world), self.robot.radius).warning
        found = [] if region is None else [region]
        cell = self.agent.grid.cell
        if self.policy.startswith("frontier") and not self.laps and self.robot.reach < least_reach(self.robot, cell):
            found.append(f"{short_reach(self.robot, cell)}: the robot follows walls instead")
        return found


@dataclass(frozen=True, eq=False)
class Episode:
    """The record of a run, with one row for each step. Row 0 is the moment of the reset.

    Attributes
    ----------
    config, world
        Settings and world of the run.
    time
        (t,), s.
    ranges, wheels
        Observations of the n robots: (t, n, n_beams), m, and (t, n, 2), m.
    actions
        Answer to each observation (t, n, 2). The action of a row leads to the next row.
    true, estimated, odometry
        Poses (t, n, 3): the truth, the estimate, and odometry alone.
    covariances
        Covariances of the estimated poses (t, n, 3, 3).
    levels
        Status of each robot's estimate (t, n), as an index into ``status.LEVELS``: 0 ok, 1 unsure, 2 lost.
    wall_seen
        What each beam truly hit (t, n, n_beams).
    dropped
        Beams that were ignored because they may have hit another robot (t, n, n_beams).
    coverage, contact
        True coverage by all robots together (t,), and whether each robot touches something (t, n).
    associations, closures
        The association of each observed line, and the loops that were closed.
    calibrations
        Each robot's odometry calibration and its covariance (3, 3) at the end; None where none was needed.
    sensor
        How the range sensors measure, as the SLAM takes it at the end. None if it estimates nothing of the kind.
    snapshot
        What is believed at the end.
    coverage_grid
        The cells that count for coverage.
    places
        What happened when the robot was lost.
    in_prior_map
        Whether the robot's place in an earlier map was found. The poses are in the frame of that map then.
    stop_reason, is_finished
        Why the run ended, and whether the agent itself said so.
    slam_ms, decide_ms, wall_clock
        Cost of a step: the SLAM alone (t,), ms, and the grid with the policies (t,), ms. Cost of the whole loop, s.
    joined
        The poses in the shared frame until two robots with unknown starts were joined; None without it.
    """

    config: RunConfig
    world: World
    time: FloatArray
    ranges: FloatArray
    wheels: FloatArray
    actions: FloatArray
    true: FloatArray
    estimated: FloatArray
    odometry: FloatArray
    covariances: FloatArray
    levels: IntArray
    wall_seen: IntArray
    dropped: BoolArray
    coverage: FloatArray
    contact: BoolArray
    associations: list[AssociationRecord]
    closures: list[Closure]
    calibrations: list[tuple[OdometryCalibration, FloatArray] | None]
    places: PlaceHistory
    in_prior_map: bool
    snapshot: Snapshot
    coverage_grid: CoverageGrid
    stop_reason: str
    is_finished: bool
    slam_ms: FloatArray
    decide_ms: FloatArray
    wall_clock: float
    joined: Joined | None = None
    sensor: RangeSensor | None = None

    @property
    def placed_steps(self) -> slice:
        """The steps in which the poses are known in the frame of the map. A lost robot may end in another one."""
        known = self.places.placed
        return known if self.config.robots == 1 and known.stop != 0 else slice(None)

    @property
    def placed_robots(self) -> int:
        """Number of robots whose place in the map is known at the end: the first ones."""
        return 1 if self.config.unknown_starts and self.joined is None else self.config.robots

    @cached_property
    def smoothed(self) -> "SmoothedRun | None":
        """All poses and walls by what was known at the end; None if the run was not smoothed."""
        return smooth_episode(self)

    @cached_property
    def final_map(self) -> FinalMap:
        """The map by what was known at the end. It is drawn from the smoothed poses if the run was smoothed."""
        return final_map(self)


Watcher = Callable[[LimSlamTeam, LimSlamParallelEnv, float, float], None]
"""Called at each step, after the team has decided, with team, env, simulated time (s) and true coverage (0 to 1)."""


@dataclass(frozen=True, eq=False)
class _Row:
    """One step of a run, with all robots."""

    time: float
    coverage: float
    infos: list[dict[str, Any]]
    observations: list[Observation]
    actions: list[FloatArray]
    estimated: FloatArray
    covariances: FloatArray
    levels: list[int]
    odometry: FloatArray
    dropped: list[BoolArray]
    slam_ms: float
    decide_ms: float


def run_episode(
    config: RunConfig,
    watch: Watcher | None = None,
    *,
    on_association: Callable[[AssociationRecord], None] | None = None,
    render_mode: str | None = None,
    policies: Sequence[Policy] | None = None,
) -> Episode:
    """Run the robots and record what happens.

    Parameters
    ----------
    config
        Settings of the run.
    watch
        Called at each step.
    on_association
        Called with the association of each observed line.
    render_mode
        Render mode of the environment, for pictures of the truth.
    policies
        A policy for each robot, in place of those that ``config.policy`` names.
    """
    world = load_world(config.world)
    env = LimSlamParallelEnv(
        world, num_robots=config.robots, robot=config.robot,
        noise=replace(config.true_noise, sensor_noise=config.noise),
        coverage_goal=None, max_cycles=None, render_mode=render_mode,
    )  # fmt: skip
    if policies is None:
        policies = policies_for(
            config.policy, config.robot, config.agent, world, robots=config.robots, laps=config.laps, seed=config.seed
        )
    prior_map = None if config.prior_map is None else read_saved_map(config.prior_map)
    team = LimSlamTeam(
        config.robot, config.agent, config.robots, policies, prior_map=prior_map, unknown_starts=config.unknown_starts
    )
    clock, associations = time.perf_counter(), list[AssociationRecord]()

    def note_association(record: AssociationRecord) -> None:
        associations.append(record)
        if on_association is not None:
            on_association(record)

    team.mapper.on_restart = lambda kept: associations.__delitem__(slice(kept, None))
    with naming_lines_of(config.policy):
        rows = _drive(config, env, team, note_association, watch)
    joined, parted = (
        (team.mapper.joined, team.mapper.parted) if isinstance(team.mapper, JoiningMapper) else (None, None)
    )
    return Episode(
        config=config,
        world=world,
        associations=associations,
        closures=list(team.slam.closures),
        calibrations=team.slam.odometry_calibrations,
        places=team.mapper.places,
        in_prior_map=team.mapper.prior_frame is not None,
        snapshot=team.snapshot(),
        coverage_grid=env.coverage_grid,
        stop_reason=_stop_reason(config, world, team.stop_reason),
        is_finished=team.done,
        wall_clock=time.perf_counter() - clock,
        joined=joined,
        sensor=team.slam.sensor,
        **_in_shared_frame(
            _in_one_frame(_columns(rows), team.mapper.prior_frame, team.mapper.places), joined or parted
        ),
    )


def _stop_reason(config: RunConfig, world: World, reason: str | None) -> str:
    """Why the run ended. A small region of a world that is explored is not the world."""
    if reason is None:
        return OUT_OF_TIME
    region = start_region(world, config.robot.radius)
    if not (reason.startswith("explored") and region.is_small):
        return reason
    return (
        f"stopped: the start region is explored, but {1.0 - region.share:.0%} of the floor cannot be reached from it: "
        f"{NOT_EXPLORED}"
    )


def _columns(rows: list[_Row]) -> dict[str, Any]:
    """The rows of a run as arrays, by their names in :class:`Episode`."""
    robots = range(len(rows[0].observations))
    columns: dict[str, Any] = {
        "time": np.array([row.time for row in rows]),
        "ranges": _stacked([row.observations[robot]["ranges"] for row in rows for robot in robots], rows),
        "wheels": _stacked([row.observations[robot]["wheels"] for row in rows for robot in robots], rows),
        "actions": _stacked([row.actions[robot] for row in rows for robot in robots], rows),
        "true": _stacked([row.infos[robot]["pose"] for row in rows for robot in robots], rows),
        "estimated": _stacked([row.estimated for row in rows], rows),
        "odometry": _stacked([row.odometry for row in rows], rows),
        "covariances": np.concatenate([row.covariances for row in rows]).reshape(len(rows), len(robots), 3, 3),
        "levels": np.array([row.levels for row in rows]),
        "wall_seen": _stacked([row.infos[robot]["wall_seen"] for row in rows for robot in robots], rows),
        "dropped": _stacked([row.dropped[robot] for row in rows for robot in robots], rows),
        "coverage": np.array([row.coverage for row in rows]),
        "contact": np.array([[info["collision"] for info in row.infos] for row in rows]),
        "slam_ms": np.array([row.slam_ms for row in rows]),
        "decide_ms": np.array([row.decide_ms for row in rows]),
    }
    return columns


def _stacked(each: list[Any], rows: list[_Row]) -> Any:
    """The values of all robots in all steps as one array (t, n, k). It is much faster than ``np.array`` on lists."""
    return np.concatenate(each).reshape(len(rows), len(rows[0].observations), -1)


def _in_one_frame(columns: dict[str, Any], prior_frame: FloatArray | None, places: PlaceHistory) -> dict[str, Any]:
    """The columns of a run, with all poses in the frame of an earlier map if the robot found its place there."""
    if prior_frame is None:
        return columns
    own = slice(places.records[0]["step"])
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(prior_frame[2]), -np.sin(prior_frame[2])], [np.sin(prior_frame[2]), np.cos(prior_frame[2])]]
    for name in ("estimated", "odometry"):
        columns[name][own] = compose(prior_frame, columns[name][own])
    columns["covariances"][own] = turn @ columns["covariances"][own] @ turn.T
    return columns


def _in_shared_frame(columns: dict[str, Any], joined: Joined | None) -> dict[str, Any]:
    """The columns of a run, with the second robot in the frame of the first one if both were joined."""
    if joined is None:
        return columns
    own = slice(len(joined.poses))
    columns["estimated"][own, 1], columns["covariances"][own, 1] = joined.poses[:, 1], joined.covariances[:, 1]
    columns["odometry"][own, 1] = joined.odometry[:, 1]
    return columns


def _drive(
    config: RunConfig,
    env: LimSlamParallelEnv,
    team: LimSlamTeam,
    on_association: Callable[[AssociationRecord], None],
    watch: Watcher | None,
) -> list[_Row]:
    observed, infos = env.reset(seed=config.seed)
    starts = np.array([infos[name]["pose"] for name in team.names])
    if config.unknown_starts:
        starts[1] = 0.0
    team.reset(starts if config.prior_map is None else np.zeros_like(starts), config.seed)
    team.slam.on_association = on_association
    for policy, start in zip(team.policies, starts, strict=True):
        if isinstance(policy, ActorPolicy):
            policy.reset(start, config.seed)
    rows: list[_Row] = []
    max_steps = round(config.max_time / config.robot.control_period)
    kidnapped_at = None if config.kidnap_at is None else round(config.kidnap_at / config.robot.control_period)
    while True:
        observations = [observed[name] for name in team.names]
        truth = infos[team.names[0]]
        _inform(team.policies, observations, env, truth)
        begin = time.perf_counter()
        team.observe(observations)
        actions = team.decide()
        elapsed_ms, slam_ms = 1e3 * (time.perf_counter() - begin), team.mapper.slam_ms
        rows.append(
            _Row(
                truth["time"], truth["coverage"], [infos[name] for name in team.names], observations, actions,
                team.mapper.poses, team.mapper.covariances,
                [LEVELS.index(status.level) for status in team.mapper.statuses], team.mapper.odometry,
                team.mapper.dropped, slam_ms, elapsed_ms - slam_ms,
            )
        )  # fmt: skip
        if watch is not None:
            watch(team, env, truth["time"], truth["coverage"])
        if team.done or len(rows) > max_steps:
            team.finish()
            return rows
        if len(rows) == kidnapped_at:
            draws = np.random.default_rng([config.seed, kidnapped_at])
            env.carry(0, another_place(env.world, config.robot, infos[team.names[0]]["pose"], draws))
        observed, _, _, _, infos = env.step(dict(zip(team.names, actions, strict=True)))


def _inform(
    policies: Sequence[Policy], observations: Sequence[Observation], env: LimSlamParallelEnv, truth: dict[str, Any]
) -> None:
    """Tell what no belief holds: the truth to oracles, and the readings to actors."""
    for policy, observation in zip(policies, observations, strict=True):
        if isinstance(policy, Oracle | TruePoseExplorer):
            policy.observe_truth(env, truth["pose"], truth["coverage"])
        if isinstance(policy, ActorPolicy):
            policy.observe(observation)
