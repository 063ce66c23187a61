"""One run: the agent in the simulated world, recorded.

Here, and nowhere else, the agent meets the world; it is handed the observation alone, and what
is true goes to the record.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from limslam_agent.agent import LimSlamAgent, Snapshot
from limslam_agent.config import AgentConfig, preset
from limslam_agent.motion import motion_of
from limslam_agent.policies import Laps, Policy
from limslam_agent.slam import AssociationRecord
from limslam_env.config import NoiseConfig
from limslam_env.coverage import CoverageGrid
from limslam_env.env import LimSlamEnv
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import compose
from limslam_env.interface import NominalNoise, RobotSpec
from limslam_env.world import World, WorldError, WorldSource, load_world

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
        Drive round the world's loop this often instead of exploring; 0 explores.
    robot
        Body and beams.

    Raises
    ------
    ValueError
        If a number is out of bounds, there is no such preset, or the world cannot be used or has no
        loop to drive laps on.
    """

    world: WorldSource = "env1"
    noise: float = 0.0
    preset: str = "paper"
    seed: int = 0
    max_time: float = 1800.0
    laps: int = 0
    robot: RobotSpec = field(default_factory=RobotSpec)

    def __post_init__(self) -> None:
        NominalNoise(self.noise)
        preset(self.preset)
        if not 0.0 < self.max_time <= LONGEST_TIME:
            raise ValueError(f"the longest time must be above 0 s and up to {LONGEST_TIME:g} s, not {self.max_time:g}")
        if self.laps < 0:
            raise ValueError(f"laps must be 0 or more, not {self.laps}")
        if self.seed < 0:
            raise ValueError(f"a seed is 0 or more, not {self.seed}")
        world = load_world(self.world)
        if self.laps and len(world.loop) < 3:
            raise WorldError(f"world {world.name!r} has no loop to drive laps on")
        world.check(self.robot.radius)

    @property
    def agent(self) -> AgentConfig:
        """What the agent is told."""
        return preset(self.preset, NominalNoise(self.noise))


@dataclass(frozen=True, eq=False)
class Episode:
    """A run as it was recorded: a row a step, row 0 the moment of the reset.

    Attributes
    ----------
    config, world
        What was run, and where.
    time
        (n,), s.
    ranges, wheels
        (n, n_beams) and (n, 2): the observations.
    actions
        (n, 2): the answer to each observation; it leads to the next row.
    true, estimated, odometry
        Poses (n, 3): the truth, the belief, and odometry alone.
    covariances
        Of the believed poses (n, 3, 3).
    wall_seen
        (n, n_beams), the wall that each beam truly hit.
    coverage, contact
        (n,) and (n,), the truth.
    associations, snapshot, coverage_grid
        What the agent made of its lines, what it believes at the end, and the cells that count.
    stop_reason, is_finished
        Why the run ended, and whether the agent said so itself.
    slam_ms, decide_ms, wall_clock
        (n,), (n,) and one number: what mapping and exploring cost a step, ms, and the whole loop, s.
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
    coverage: FloatArray
    contact: BoolArray
    associations: list[AssociationRecord]
    snapshot: Snapshot
    coverage_grid: CoverageGrid
    stop_reason: str
    is_finished: bool
    slam_ms: FloatArray
    decide_ms: FloatArray
    wall_clock: float


def run_episode(config: RunConfig, progress: Callable[[float, float], None] | None = None) -> Episode:
    """Let the agent loose, and record what happens.

    Parameters
    ----------
    config
        What is run.
    progress
        Told the simulated time (s) and the true coverage (0 to 1) at each step.
    """
    world = load_world(config.world)
    env = LimSlamEnv(world, robot=config.robot, noise=NoiseConfig(sensor_noise=config.noise), coverage_goal=None)
    agent = LimSlamAgent(config.robot, config.agent, _laps(config, world))
    observation, info = env.reset(seed=config.seed)
    agent.reset(info["pose"], config.seed)
    associations: list[AssociationRecord] = []
    agent.slam.on_association = associations.append
    odometry, rows, clock = info["pose"], [], time.perf_counter()
    max_steps = round(config.max_time / config.robot.control_period)
    while True:
        before = time.perf_counter()
        agent.observe(observation)
        between = time.perf_counter()
        action = agent.decide()
        after = time.perf_counter()
        odometry = compose(
            odometry, motion_of(observation, config.robot, config.agent.noise, config.agent.odometry).increment
        )
        rows.append(
            (
                info,
                observation,
                action,
                agent.slam.pose,
                odometry,
                agent.slam.covariance,
                between - before,
                after - between,
            )
        )
        if progress is not None:
            progress(info["time"], info["coverage"])
        if agent.done or len(rows) > max_steps:
            break
        observation, _, _, _, info = env.step(action)
    agent.finish()
    infos, observations, actions, estimated, odometries, covariances, slam, decide = zip(*rows, strict=True)
    return Episode(
        config=config,
        world=world,
        time=np.array([info["time"] for info in infos]),
        ranges=np.array([observation["ranges"] for observation in observations]),
        wheels=np.array([observation["wheels"] for observation in observations]),
        actions=np.array(actions),
        true=np.array([info["pose"] for info in infos]),
        estimated=np.array(estimated),
        odometry=np.array(odometries),
        covariances=np.array(covariances),
        wall_seen=np.array([info["wall_seen"] for info in infos]),
        coverage=np.array([info["coverage"] for info in infos]),
        contact=np.array([info["collision"] for info in infos]),
        associations=associations,
        snapshot=agent.snapshot(),
        coverage_grid=env.coverage_grid,
        stop_reason=agent.stop_reason or OUT_OF_TIME,
        is_finished=agent.done,
        slam_ms=1e3 * np.array(slam),
        decide_ms=1e3 * np.array(decide),
        wall_clock=time.perf_counter() - clock,
    )


def _laps(config: RunConfig, world: World) -> Policy | None:
    if not config.laps:
        return None
    return Laps(config.robot, config.agent.policy, world.loop, config.laps)
