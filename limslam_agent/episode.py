"""One run: the agent in the simulated world, recorded, scored and written down.

The composition root. Here, and nowhere else, the agent meets the world; it is handed the
observation alone, and what is true goes to the record.
"""

import math
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from limslam_agent.agent import LimSlamAgent, Snapshot
from limslam_agent.config import AgentConfig, preset
from limslam_agent.export import map_content, write_grid, write_json, write_tum
from limslam_agent.motion import motion_of
from limslam_agent.policies import Laps, Policy
from limslam_agent.slam import AssociationRecord
from limslam_env import metrics
from limslam_env.config import NoiseConfig
from limslam_env.coverage import CELL, CoverageGrid
from limslam_env.env import LimSlamEnv
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import compose
from limslam_env.interface import NominalNoise, RobotSpec
from limslam_env.sensors import longest_reach
from limslam_env.world import World, WorldSource, load_world

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
        If a number is out of bounds, or there is no such preset.
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
        if not self.max_time > 0.0:
            raise ValueError(f"the longest time must be above 0 s, not {self.max_time:g}")
        if self.laps < 0:
            raise ValueError(f"laps must be 0 or more, not {self.laps}")
        if self.seed < 0:
            raise ValueError(f"a seed is 0 or more, not {self.seed}")

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

    Raises
    ------
    WorldError
        If the world cannot be used, or has no loop to drive laps on.
    """
    world = load_world(config.world)
    env = LimSlamEnv(world, robot=config.robot, noise=NoiseConfig(sensor_noise=config.noise), coverage_goal=None)
    agent = LimSlamAgent(config.robot, config.agent, _laps(config, world))
    observation, info = env.reset(seed=config.seed)
    agent.reset(info["pose"], config.seed)
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
        associations=agent.slam.associations,
        snapshot=agent.snapshot(),
        coverage_grid=env.coverage_grid,
        stop_reason=agent.stop_reason or OUT_OF_TIME,
        is_finished=agent.done,
        slam_ms=1e3 * np.array(slam),
        decide_ms=1e3 * np.array(decide),
        wall_clock=time.perf_counter() - clock,
    )


def trajectory_scores(true: FloatArray, estimated: FloatArray, odometry: FloatArray) -> dict[str, float | None]:
    """Errors of an estimated trajectory (n, 3), and the error of odometry alone beside them."""
    by_odometry = metrics.trajectory_metrics(true, odometry)
    return {
        **metrics.trajectory_metrics(true, estimated),
        **{f"odometry_{name}": by_odometry[name] for name in ("ate_m", "heading_rmse_deg")},
    }


def score(episode: Episode) -> dict[str, Any]:
    """The metrics of a run, by their names in ``docs/metrics.md``."""
    robot, snapshot = episode.config.robot, episode.snapshot
    segments = snapshot.segments
    alignment = metrics.rigid_alignment(episode.true[:, :2], episode.estimated[:, :2])
    visible = metrics.visible_samples(episode.world, robot.radius, longest_reach(robot))
    grid = snapshot.grid
    return {
        **trajectory_scores(episode.true, episode.estimated, episode.odometry),
        **metrics.consistency_metrics(episode.true, episode.estimated, episode.covariances),
        **metrics.wall_metrics(visible, episode.world.edges, segments, alignment),
        "doors_open": metrics.doors_open(episode.world.doors, segments),
        "coverage_true": float(episode.coverage[-1]),
        **metrics.coverage_claims(
            grid.centres(np.argwhere(grid.free)),
            grid.cell,
            episode.coverage_grid.coverable,
            episode.coverage_grid.low,
            CELL,
        ),
        **metrics.coverage_times(episode.time, episode.coverage),
        "exploration_time_s": float(episode.time[-1]) if episode.is_finished and not episode.config.laps else None,
        "path_m": metrics.path_length(episode.true),
        "collisions": metrics.contacts_begun(episode.contact),
        "landmarks": len(segments),
        **metrics.association_metrics(_events(episode), len(episode.world.edges)),
        "stop_reason": episode.stop_reason,
    }


def cost(episode: Episode) -> dict[str, float]:
    """What a run cost: wall clock and memory, never part of a comparison for identity."""
    # Linux counts kilobytes, macOS bytes.
    unit = 1e6 if sys.platform == "darwin" else 1e3
    return {
        "slam_ms_median": float(np.median(episode.slam_ms)),
        "slam_ms_p99": float(np.percentile(episode.slam_ms, 99)),
        "explore_ms_median": float(np.median(episode.decide_ms)),
        "explore_ms_p99": float(np.percentile(episode.decide_ms, 99)),
        "speed_x_real_time": float(episode.time[-1] / episode.wall_clock),
        "wall_clock_s": episode.wall_clock,
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit,
    }


def write_episode(folder: Path, episode: Episode) -> dict[str, Any]:
    """Write a run's folder, and give back what its ``result.json`` holds."""
    from limslam_agent.drawing import MapPicture, draw_map

    config, robot = episode.config, episode.config.robot
    np.savez_compressed(
        folder / "log.npz",
        time=episode.time, ranges=episode.ranges, wheels=episode.wheels, action=episode.actions,
        true_pose=episode.true, wall_seen=episode.wall_seen, start_pose=episode.true[0],
        robot=np.array(robot.to_json()),
    )  # fmt: skip
    write_tum(folder / "trajectory_true.tum", episode.time, episode.true)
    write_tum(folder / "trajectory_est.tum", episode.time, episode.estimated)
    write_json(folder / "map.json", map_content(episode.snapshot.landmarks))
    write_grid(folder, episode.snapshot.grid)
    title = f"{episode.world.name}, range noise {100 * config.noise:g} cm, {config.preset}, seed {config.seed}"
    draw_map(
        folder / "map.png",
        MapPicture(
            title, episode.snapshot.segments, episode.estimated[:, :2], episode.odometry[:, :2],
            episode.world.edges, episode.true[:, :2],
        ),
    )  # fmt: skip
    written_config = {
        "world": episode.world.name, "world_digest": episode.world.digest, "noise": config.noise,
        "preset": config.preset, "max_time": config.max_time, "laps": config.laps,
        "robot": asdict(robot), "agent": asdict(config.agent),
    }  # fmt: skip
    result = {
        "metrics": _finite(score(episode)), "cost": cost(episode), "config": written_config,
        "versions": versions(), "seed": config.seed,
    }  # fmt: skip
    write_json(folder / "result.json", result)
    return result


def versions() -> dict[str, str]:
    """Versions of all that a result depends on."""
    packages = ("limslam", "gymnasium", "pymunk", "numpy", "scipy", "numba", "filterpy", "opencv-python-headless")
    return {"python": sys.version.split()[0], **{name: version(name) for name in packages}}


def _finite(scores: dict[str, Any]) -> dict[str, Any]:
    """JSON knows no infinity: a NEES that no covariance allows is written as null."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in scores.items()
    }


def _laps(config: RunConfig, world: World) -> Policy | None:
    if not config.laps:
        return None
    if len(world.loop) < 3:
        raise ValueError(f"world {world.name!r} has no loop to drive laps on")
    return Laps(config.robot, config.agent.policy, world.loop, config.laps)


def _events(episode: Episode) -> list[metrics.AssociationEvent]:
    return [
        metrics.AssociationEvent(
            record.landmark,
            record.is_new,
            tuple(episode.wall_seen[record.readings[:, 0], record.readings[:, 1]].tolist()),
        )
        for record in episode.associations
    ]
