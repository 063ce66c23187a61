"""The comparison: one run for each map and explorer, kept as rows like those of a suite, and one table."""

import time
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.peers.explore import Exploration, explore_as_point, explore_as_robot
from benchmarks.peers.maps import PeerMap, read_map, read_maps, world_of
from benchmarks.peers.table import LIDAR, POINT, peers_table
from benchmarks.suite.engines import Engine
from benchmarks.suite.jobs import Job, Outcome, digest
from benchmarks.suite.runner import Summary, run_suite
from benchmarks.suite.store import read_rows
from benchmarks.suite.suite import Suite
from benchmarks.suite.work import simulated
from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.config.presets import preset
from limslam_agent.runs.run_config import RunConfig
from limslam_env.interface import NominalNoise, RobotSpec

FORMAT = 1
"""Version of what a run records. Results of another version are not continued."""

LIDAR_EXPLORERS = (POINT, "frontier_fast", "learned")
SIX_EXPLORERS = ("frontier", "frontier_fast", "learned")


@dataclass(frozen=True)
class PeersConfig:
    """A comparison.

    Attributes
    ----------
    maps, count
        Folder of the PNG maps, and the most maps that are used.
    scale
        Side of a pixel for our robot, m.
    noise
        Standard deviation of the ranges of the six beams, m. The estimator is told this value.
    max_time
        Longest driving time of a run, s.
    lidar, six
        Explorers with 720 rays and the true pose, and with six beams and an unknown pose.

    Raises
    ------
    ValueError
        If a value is out of bounds, or there is no such explorer.
    """

    maps: Path
    count: int = 100
    scale: float = 0.05
    noise: float = 0.02
    max_time: float = 3600.0
    lidar: tuple[str, ...] = LIDAR_EXPLORERS
    six: tuple[str, ...] = ("frontier_fast", "learned")

    def __post_init__(self) -> None:
        if not 1 <= self.count <= 100_000:
            raise ValueError(f"--count: 1 to 100000 maps can be used, not {self.count}")
        if not 0.01 <= self.scale <= 0.5:
            raise ValueError(f"--scale: a pixel has a side of 0.01 to 0.5 m, not {self.scale:g}")
        if not 0.0 <= self.noise <= 1.0:
            raise ValueError(f"--noise: a standard deviation from 0 to 1 m, not {self.noise:g}")
        if not 1.0 <= self.max_time <= 100_000.0:
            raise ValueError(f"--max-time: 1 to 100000 s, not {self.max_time:g}")
        if not self.lidar + self.six:
            raise ValueError("no explorer is named: see --lidar and --six")
        for option, names, known in (("--lidar", self.lidar, LIDAR_EXPLORERS), ("--six", self.six, SIX_EXPLORERS)):
            if unknown := [name for name in names if name not in known]:
                raise ValueError(f"{option}: no explorer is called {unknown[0]!r}; there are {', '.join(known)}")
            if len(set(names)) < len(names):
                raise ValueError(f"{option}: each explorer is named once")

    def suite(self, maps: list[PeerMap]) -> Suite:
        """One job for each map and explorer, map by map, so that a part of the runs has all explorers."""
        jobs = tuple(job for number, found in enumerate(maps) for job in self._jobs(found.name, number))
        settings = {name: value for name, value in asdict(self).items() if name != "maps"}
        return Suite("peers", "Maps of other work.", jobs, digest([FORMAT, settings, [each.digest for each in maps]]))

    def _jobs(self, name: str, number: int) -> list[Job]:
        by_lidar = [Job(name, 0.0, preset=LIDAR, policy=policy, max_time=self.max_time) for policy in self.lidar]
        by_six = [
            Job(name, self.noise, preset=DEFAULT_PRESET, policy=policy, seed=number, max_time=self.max_time)
            for policy in self.six
        ]
        return by_lidar + by_six


def compare_peers(
    config: PeersConfig, folder: Path, engine: Engine, *, retry_failed: bool = False
) -> tuple[Summary, str]:
    """Run what is missing of a comparison, and make its table.

    Parameters
    ----------
    config
        Settings. All maps are read before the first run.
    folder
        Folder of the results. It may hold a part of the same comparison.
    engine
        Runs the explorers.
    retry_failed
        Run again what has failed.

    Raises
    ------
    ValueError
        If a map cannot be used, or the folder holds something else.
    """
    suite = config.suite(read_maps(config.maps, config.count))
    summary = run_suite(suite, folder, engine, work=partial(run_peer_job, config), retry_failed=retry_failed)
    return summary, peers_table(read_rows(folder))


def run_peer_job(config: PeersConfig, job: Job) -> Outcome:
    """Run an explorer on a map.

    Raises
    ------
    ValueError
        If the map cannot be used.
    """
    begin, begin_cpu = time.perf_counter(), time.process_time()
    found = read_map(config.maps / job.world)
    outcome = _by_lidar(found, config, job) if job.preset == LIDAR else _by_six_beams(found, config, job)
    spent = {"job_s": time.perf_counter() - begin, "job_cpu_s": time.process_time() - begin_cpu}
    return replace(outcome, cost={**outcome.cost, **spent})


def _by_lidar(found: PeerMap, config: PeersConfig, job: Job) -> Outcome:
    """An exploration with 720 rays and the true pose."""
    if job.policy == POINT:
        done = explore_as_point(found, config.scale)
    else:
        robot, agent = RobotSpec(), preset(DEFAULT_PRESET, NominalNoise(0.0))
        done = explore_as_robot(found, config.scale, job.policy, robot, agent, seed=job.seed, max_time=config.max_time)
    metrics = {
        "path_px": _length(done) / config.scale, "explored": done.seen.explored, "is_done": int(done.seen.is_done),
        "unseen_px": done.seen.unseen, "exploration_time_s": done.time_s, "scans": done.seen.scans,
        "stop_reason": done.stop_reason,
    }  # fmt: skip
    cost = {"decide_ms": 1e3 * done.decide_s / max(done.decisions, 1)}
    return Outcome(metrics, cost, {"path": done.path}, digest([FORMAT, found.digest, config.scale]))


def _length(done: Exploration) -> float:
    return float(np.hypot(*np.diff(done.path, axis=0).T).sum())


def _by_six_beams(found: PeerMap, config: PeersConfig, job: Job) -> Outcome:
    """An ordinary run of the agent: six beams with noise, and a pose that it estimates."""
    world = world_of(found, config.scale, RobotSpec().radius)
    outcome = simulated(
        RunConfig(world, job.noise, job.preset, job.seed, job.max_time, policy=job.policy, until="seen")
    )
    path, ended = outcome.metrics["path_m"], outcome.metrics["exploration_time_s"]
    own = {
        "path_px": float(path or 0.0) / config.scale, "explored": outcome.metrics["coverage_true"],
        "is_done": int(ended is not None),
    }  # fmt: skip
    return replace(outcome, metrics={**outcome.metrics, **own})
