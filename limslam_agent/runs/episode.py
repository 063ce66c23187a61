"""One run: the agent, or a team, in the simulated world, recorded.

Here, and nowhere else, the mind meets the world; it is handed the observations alone, and what
is true goes to the record.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from limslam_agent.config.ablations import ablated
from limslam_agent.config.presets import AgentConfig, preset
from limslam_agent.slam.core.diagnostics import Closure
from limslam_agent.slam.core.motion import motion_of
from limslam_agent.runs.oracle import Pilot, TruePose, check_policy, needs_loop, policies_for
from limslam_agent.slam.slam import AssociationRecord
from limslam_agent.team import LimSlamTeam, Snapshot
from limslam_env.envs.adapter import MAX_ROBOTS
from limslam_env.config import NoiseConfig
from limslam_env.simulation.coverage import CoverageGrid
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import compose
from limslam_env.interface import NominalNoise, Observation, RobotSpec
from limslam_env.bounds.offline_optimum import require_gtsam
from limslam_env.envs.parallel_env import LimSlamParallelEnv
from limslam_env.worlds.formats.loading import WorldSource, load_world
from limslam_env.worlds.world import World, WorldError

LONGEST_TIME = 1e6
OUT_OF_TIME = "time: the run's longest time is over"


@dataclass(frozen=True)
class RunConfig:
    """What is run.

    Attributes
    ----------
    world
        Name, file or world.
    noise
        Standard deviation of the ranges, m; the agent is told it.
    preset
        The agent's settings.
    seed
        Of all noise.
    max_time
        Longest simulated time, s.
    laps
        Drive round the world's loop this often instead of exploring; 0 explores. With the policy ``tour``, how often
        the tour is driven.
    robot
        Body and beams of each robot.
    robots
        How many there are, 1 to 8.
    ablation
        A part of the method that is left out; None leaves out nothing.
    policy
        Who drives: ``frontier`` explores, ``frontier_fast`` does so at top speed, ``learned`` is a trained network,
        ``wall_follower`` and ``random`` are there to compare with. ``learned_true_pose`` has its map drawn by the true
        pose. A pilot that
        knows the true map and pose, to which the estimators listen, drives ``tour``, round the world's loop or where
        it has none past all that can be seen and back, and ``oracle``, past everything as soon as possible.
    limit
        Score it against the offline optimum of its log too, which needs gtsam.
    settings
        The agent's settings before the ablation; those of the preset if left out.
    true_noise
        The simulator's noise. Its ``sensor_noise`` is replaced by ``noise``.

    Raises
    ------
    ValueError
        If a number is out of bounds, there is no such preset or policy, they do not go together, the world cannot
        be used or has no loop to drive laps on, or gtsam is missing for the limit.
    """

    world: WorldSource = "env1"
    noise: float = 0.0
    preset: str = "consistent"
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

    def __post_init__(self) -> None:
        _ = self.agent
        if self.limit:
            require_gtsam()
        if not 1 <= self.robots <= MAX_ROBOTS:
            raise ValueError(f"there can be 1 to {MAX_ROBOTS} robots, not {self.robots}")
        if not 0.0 < self.max_time <= LONGEST_TIME:
            raise ValueError(f"the longest time must be above 0 s and up to {LONGEST_TIME:g} s, not {self.max_time:g}")
        if self.laps < 0:
            raise ValueError(f"laps must be 0 or more, not {self.laps}")
        check_policy(self.policy, self.laps, self.robots)
        if self.seed < 0:
            raise ValueError(f"a seed is 0 or more, not {self.seed}")
        world = load_world(self.world)
        if needs_loop(self.policy, self.laps) and len(world.loop) < 3:
            raise WorldError(f"world {world.name!r} has no loop to drive laps on")
        world.check(self.robot.radius)

    @property
    def agent(self) -> AgentConfig:
        """What the agent is told."""
        config = self.settings or preset(self.preset, NominalNoise(self.noise))
        return config if self.ablation is None else ablated(config, self.ablation)


@dataclass(frozen=True, eq=False)
class Episode:
    """A run as it was recorded: a row a step, row 0 the moment of the reset.

    Attributes
    ----------
    config, world
        What was run, and where.
    time
        (t,), s.
    ranges, wheels
        (t, n, n_beams) and (t, n, 2): the observations of the n robots.
    actions
        (t, n, 2): the answer to each observation; it leads to the next row.
    true, estimated, odometry
        Poses (t, n, 3): the truth, the belief, and odometry alone.
    covariances
        Of the believed poses (t, n, 3, 3).
    wall_seen
        (t, n, n_beams), what each beam truly hit.
    dropped
        (t, n, n_beams), which beams were left out because they may have hit another robot.
    coverage, contact
        (t,) by all robots together, and (t, n), the truth.
    associations, closures, snapshot, coverage_grid
        What became of observed lines, the loops closed, what is believed at the end, and the cells that count.
    stop_reason, is_finished
        Why the run ended, and whether the mind said so itself.
    slam_ms, decide_ms, wall_clock
        (t,), (t,) and one number: what mapping and exploring cost a step, ms, and the whole loop, s.
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
    wall_seen: IntArray
    dropped: BoolArray
    coverage: FloatArray
    contact: BoolArray
    associations: list[AssociationRecord]
    closures: list[Closure]
    snapshot: Snapshot
    coverage_grid: CoverageGrid
    stop_reason: str
    is_finished: bool
    slam_ms: FloatArray
    decide_ms: FloatArray
    wall_clock: float


Watcher = Callable[[LimSlamTeam, LimSlamParallelEnv, float, float], None]
"""Told of team, env, simulated time (s) and true coverage (0 to 1) at each step, after the team has decided."""


@dataclass(frozen=True, eq=False)
class _Row:
    """One step of a run, of all robots."""

    time: float
    coverage: float
    infos: list[dict[str, Any]]
    observations: list[Observation]
    actions: list[FloatArray]
    estimated: FloatArray
    covariances: FloatArray
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
) -> Episode:
    """Let the robots loose, and record what happens.

    Parameters
    ----------
    config
        What is run.
    watch
        Told of each step.
    on_association
        Told what became of each observed line.
    render_mode
        Of the environment, for those who want pictures of the truth.
    """
    world = load_world(config.world)
    env = LimSlamParallelEnv(
        world, num_robots=config.robots, robot=config.robot, noise=replace(config.true_noise, sensor_noise=config.noise),
        coverage_goal=None, max_cycles=None, render_mode=render_mode,
    )  # fmt: skip
    policies = policies_for(
        config.policy, config.robot, config.agent, world, robots=config.robots, laps=config.laps, seed=config.seed
    )
    team = LimSlamTeam(config.robot, config.agent, config.robots, policies)
    clock, associations = time.perf_counter(), list[AssociationRecord]()

    def note(record: AssociationRecord) -> None:
        associations.append(record)
        if on_association is not None:
            on_association(record)

    rows = _drive(config, env, team, note, watch)
    return Episode(
        config=config,
        world=world,
        time=np.array([row.time for row in rows]),
        ranges=np.array([[seen["ranges"] for seen in row.observations] for row in rows]),
        wheels=np.array([[seen["wheels"] for seen in row.observations] for row in rows]),
        actions=np.array([row.actions for row in rows]),
        true=np.array([[info["pose"] for info in row.infos] for row in rows]),
        estimated=np.array([row.estimated for row in rows]),
        odometry=np.array([row.odometry for row in rows]),
        covariances=np.array([row.covariances for row in rows]),
        wall_seen=np.array([[info["wall_seen"] for info in row.infos] for row in rows]),
        dropped=np.array([row.dropped for row in rows]),
        coverage=np.array([row.coverage for row in rows]),
        contact=np.array([[info["collision"] for info in row.infos] for row in rows]),
        associations=associations,
        closures=list(team.slam.closures),
        snapshot=team.snapshot(),
        coverage_grid=env.coverage_grid,
        stop_reason=team.stop_reason or OUT_OF_TIME,
        is_finished=team.done,
        slam_ms=np.array([row.slam_ms for row in rows]),
        decide_ms=np.array([row.decide_ms for row in rows]),
        wall_clock=time.perf_counter() - clock,
    )


def _drive(
    config: RunConfig,
    env: LimSlamParallelEnv,
    team: LimSlamTeam,
    on_association: Callable[[AssociationRecord], None],
    watch: Watcher | None,
) -> list[_Row]:
    told, infos = env.reset(seed=config.seed)
    odometry = np.array([infos[name]["pose"] for name in team.names])
    team.reset(odometry, config.seed)
    team.slam.on_association = on_association
    rows: list[_Row] = []
    agent = config.agent
    max_steps = round(config.max_time / config.robot.control_period)
    while True:
        observations = [told[name] for name in team.names]
        truth = infos[team.names[0]]
        for policy in team.policies:
            if isinstance(policy, Pilot | TruePose):
                policy.look(env, truth["pose"], truth["coverage"])
        begin = time.perf_counter()
        team.observe(observations)
        between = time.perf_counter()
        actions = team.decide()
        end = time.perf_counter()
        odometry = np.array(
            [_moved(pose, seen, config.robot, agent) for pose, seen in zip(odometry, observations, strict=True)]
        )  # fmt: skip
        rows.append(
            _Row(
                truth["time"], truth["coverage"], [infos[name] for name in team.names], observations, actions,
                team.slam.poses, team.slam.covariances, odometry, [front.dropped for front in team.slam.robots],
                1e3 * (between - begin), 1e3 * (end - between),
            )
        )  # fmt: skip
        if watch is not None:
            watch(team, env, truth["time"], truth["coverage"])
        if team.done or len(rows) > max_steps:
            team.finish()
            return rows
        told, _, _, _, infos = env.step(dict(zip(team.names, actions, strict=True)))


def _moved(pose: FloatArray, observation: Observation, robot: RobotSpec, agent: AgentConfig) -> FloatArray:
    """Where odometry alone puts a robot."""
    return compose(pose, motion_of(observation, robot, agent.noise, agent.odometry).increment)
