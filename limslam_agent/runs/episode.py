"""One run of an agent or a team in the simulator, recorded step by step.

Agent and simulator meet only in this module. The agent gets the observations and nothing else. The
truth goes into the record of the run.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from limslam_agent.mapping.joining import JoiningMapper
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.mapping.team import LimSlamTeam
from limslam_agent.places.saved_map import read_saved_map
from limslam_agent.policies.policy import NOT_EXPLORED, Policy
from limslam_agent.policies.simple_policies import Laps
from limslam_agent.runs.actors import ActorPolicy
from limslam_agent.runs.policies import TOUR, Tour, policies_by_belief
from limslam_agent.runs.policy_file import naming_lines_of
from limslam_agent.runs.record import Episode
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.slam.core.front_end import yaw_of
from limslam_agent.slam.slam import ConsistentEstimator
from limslam_agent.status.status import LEVELS
from limslam_env.bounds import loop_tour
from limslam_env.envs.parallel_env import LimSlamParallelEnv
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose, turned
from limslam_env.interface import Observation, RobotSpec
from limslam_env.worlds.formats.loading import load_world
from limslam_env.worlds.regions import start_region
from limslam_env.worlds.world import World, WorldError

OUT_OF_TIME = "time: the run's longest time is over"
INTERRUPTED = "interrupted: somebody has ended the run"

LEAST_MOVE = 2.0
"""Least distance to which a robot is carried, m."""

Watcher = Callable[[LimSlamTeam, LimSlamParallelEnv, float, float], None]
"""Called at each step, after the team has decided, with team, env, simulated time (s) and true
coverage (0 to 1).
"""

_Row = dict[str, Any]
"""One step of a run with all robots, by the names of the columns in :class:`Episode`."""


def run_episode(
    config: RunConfig,
    watch: Watcher | None = None,
    *,
    render_mode: str | None = None,
    policies: Sequence[Policy] | None = None,
    alter: Callable[[Observation, float], Observation] | None = None,
    is_interrupted: Callable[[], bool] = lambda: False,
) -> Episode:
    """Run the robots and record what happens.

    Parameters
    ----------
    config
        Settings of the run.
    watch
        Called at each step.
    render_mode
        Render mode of the environment, for pictures of the truth.
    policies
        A policy for each robot, in place of those that ``config.policy`` names.
    alter
        Makes of each observation and its time (s) the observation that the agent gets and that is
        recorded: a fault.
    is_interrupted
        Asked after each step. If it is true, the run ends there.
    """
    with naming_lines_of(config.policy):
        world = load_world(config.world)
        env = LimSlamParallelEnv(
            world,
            num_robots=config.robots,
            robot=config.robot,
            noise=replace(config.true_noise, sensor_noise=config.noise),
            imu=config.imu,
            coverage_goal=None,
            max_cycles=None,
            render_mode=render_mode,
        )
        team = team_of(config, policies_of(config, world) if policies is None else policies)
        clock = time.perf_counter()
        rows = _drive(config, env, team, watch, alter, is_interrupted)
        columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return Episode(
            config=config,
            world=world,
            associations=team.slam.associations,
            closures=list(team.slam.closures),
            calibrations=team.slam.odometry_calibrations,
            places=team.mapper.places,
            in_prior_map=team.mapper.prior_frame is not None,
            snapshot=team.snapshot(),
            coverage_grid=env.coverage_grid,
            stop_reason=_stop_reason(config, world, team.stop_reason, len(rows)),
            is_finished=team.done,
            wall_clock=time.perf_counter() - clock,
            is_joined=not team.mapper.is_apart,
            sensor=team.slam.sensor if isinstance(team.slam, ConsistentEstimator) else None,
            beam_turns=team.slam.beam_turns,
            **_in_one_frame(columns, team.mapper),
        )


def policies_of(config: RunConfig, world: World) -> list[Policy] | None:
    """A policy for each robot of a run, by the name in its settings; None for those that a team has
    by default.
    """
    robot = config.robot
    if config.policy == "frontier":
        return [Laps(robot, world.loop, config.laps)] if config.laps else None
    if config.policy == TOUR:
        return [Tour(robot, lambda pose: loop_tour(world, robot, pose, config.laps or 1))]
    return policies_by_belief(
        config.policy, robot, config.agent, robots=config.robots, seed=config.seed
    )


def team_of(config: RunConfig, policies: Sequence[Policy] | None) -> LimSlamTeam:
    """The robots of a run, with the default policies if none are given."""
    prior_map = None if config.map is None else read_saved_map(config.map)
    return LimSlamTeam(
        config.robot,
        config.agent,
        config.robots,
        policies,
        prior_map=prior_map,
        unknown_starts=config.unknown_starts,
    )


def told_starts(config: RunConfig, true: FloatArray) -> FloatArray:
    """The start poses (n, 3) that the agent is told, of the true ones: an unknown start is the
    origin.
    """
    told = np.array(true)
    if config.unknown_starts:
        told[1] = 0.0
    if config.map is not None:
        told[:] = 0.0
    return told


def _stop_reason(config: RunConfig, world: World, reason: str | None, steps: int) -> str:
    """Why the run ended. A small region of a world that is explored is not the world."""
    if reason is None:
        return OUT_OF_TIME if steps > _most_steps(config) else INTERRUPTED
    region = start_region(world, config.robot.radius)
    if not (reason.startswith("explored") and region.is_small):
        return reason
    return (
        f"stopped: the start region is explored, but {1.0 - region.share:.0%} of the floor cannot "
        "be reached from it: "
        f"{NOT_EXPLORED}"
    )


def _most_steps(config: RunConfig) -> int:
    return round(config.max_time / config.robot.control_period)


def _in_one_frame(columns: dict[str, Any], mapper: Mapper) -> dict[str, Any]:
    """The columns of a run, with all poses in the frame of an earlier map, or of the first robot,
    if that was found.
    """
    earlier = mapper.earlier if isinstance(mapper, JoiningMapper) else None
    if mapper.prior_frame is not None:
        own = slice(mapper.places.records[0]["step"])
        for name in ("estimated", "odometry"):
            columns[name][own] = compose(mapper.prior_frame, columns[name][own])
        columns["covariances"][own] = turned(columns["covariances"][own], mapper.prior_frame[2])
    if earlier is not None:
        known = slice(len(earlier.poses)), 1
        columns["estimated"][known] = earlier.poses[:, 1]
        columns["odometry"][known] = earlier.odometry[:, 1]
        columns["covariances"][known] = earlier.covariances[:, 1]
    return columns


def _drive(
    config: RunConfig,
    env: LimSlamParallelEnv,
    team: LimSlamTeam,
    watch: Watcher | None,
    alter: Callable[[Observation, float], Observation] | None,
    is_interrupted: Callable[[], bool],
) -> list[_Row]:
    """Step the robots until the team is done, the time is over, or the run is interrupted."""
    observed, infos = env.reset(seed=config.seed)
    starts = told_starts(config, np.array([infos[name]["pose"] for name in team.names]))
    team.reset(starts, config.seed)
    for policy, start in zip(team.policies, starts, strict=True):
        if isinstance(policy, ActorPolicy):
            policy.reset(start, config.seed)
    rows: list[_Row] = []
    max_steps = _most_steps(config)
    kidnapped_at = (
        None if config.kidnap_at is None else round(config.kidnap_at / config.robot.control_period)
    )
    while True:
        told = [observed[name] for name in team.names]
        if alter is not None:
            told = [alter(each, infos[team.names[0]]["time"]) for each in told]
        row = _decide(team, told, [infos[name] for name in team.names])
        rows.append(row)
        if watch is not None:
            watch(team, env, row["time"], row["coverage"])
        if team.done or len(rows) > max_steps or is_interrupted():
            team.finish()
            return rows
        if len(rows) == kidnapped_at:
            draws = np.random.default_rng([config.seed, kidnapped_at])
            env.carry(0, another_place(env.world, config.robot, row["true"][0], draws))
        observed, _, _, _, infos = env.step(dict(zip(team.names, row["actions"], strict=True)))


def _decide(
    team: LimSlamTeam, observations: list[Observation], infos: list[dict[str, Any]]
) -> _Row:
    """Let the robots observe and choose their actions; the record of the step."""
    truth = infos[0]
    mapper = team.mapper
    for policy, observation in zip(team.policies, observations, strict=True):
        # What no belief holds: the true pose for a tour, and the readings for actors.
        if isinstance(policy, Tour):
            policy.observe_truth(truth["pose"])
        if isinstance(policy, ActorPolicy):
            policy.observe(observation)
    begin = time.perf_counter()
    team.observe(observations)
    actions = team.decide()
    elapsed_ms = 1e3 * (time.perf_counter() - begin)
    return {
        "time": truth["time"],
        "coverage": truth["coverage"],
        "true": np.array([info["pose"] for info in infos]),
        "wall_seen": np.array([info["wall_seen"] for info in infos]),
        "contact": np.array([info["collision"] for info in infos]),
        "ranges": np.array([observation["ranges"] for observation in observations]),
        "wheels": np.array([observation["wheels"] for observation in observations]),
        "yaw": np.array([yaw_of(observation) for observation in observations]),
        "actions": np.array(actions),
        "estimated": mapper.poses,
        "covariances": mapper.covariances,
        "odometry": mapper.odometry,
        "levels": [LEVELS.index(status.level) for status in mapper.statuses],
        "dropped": np.array(mapper.dropped),
        "slam_ms": mapper.slam_ms,
        "decide_ms": elapsed_ms - mapper.slam_ms,
    }


def another_place(
    world: World, robot: RobotSpec, pose: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """A random free pose (3,) that the robot could drive to, at least 2 m away from its pose (3,).

    Raises
    ------
    WorldError
        If there is no such place.
    """
    grid = world.free_space(robot.radius)
    places = grid.centres(grid.region_of(pose[:2]))
    far = places[np.hypot(*(places - pose[:2]).T) > LEAST_MOVE]
    if not len(far):
        raise WorldError(
            f"world {world.name!r} has no free place that is {LEAST_MOVE:g} m away from the robot"
        )
    return np.array([*far[rng.integers(len(far))], rng.uniform(-np.pi, np.pi)])
