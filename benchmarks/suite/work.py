"""The execution of a job: its world or log, its scores, and its series for the plots."""

import functools
import hashlib
import os
from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.suite.faults import Fault, fault_begins, fault_scores
from benchmarks.suite.jobs import KIDNAPPED, PLAN, RANDOM, Job, LogSource, Outcome, digest
from limslam_agent.config.ablations import ablated
from limslam_agent.config.presets import OdometryConfig, preset
from limslam_agent.output.export import plain
from limslam_agent.replay.options import odometry_config
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.record import Episode
from limslam_agent.runs.results import cost, score, trajectory_scores
from limslam_agent.runs.run_config import RunConfig
from limslam_env.geometry import FloatArray
from limslam_env.worlds.formats.loading import WorldSource, load_world

SERIES_PERIOD = 1.0
"""Simulated time between two rows of a job's series, s."""


def data_folder() -> Path:
    """The folder of recorded data: ``LIMSLAM_DATA``, or ``shared/data`` beside the checkout.

    Raises
    ------
    ValueError
        If there is no such folder.
    """
    folder = Path(os.environ.get("LIMSLAM_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
    if not folder.is_dir():
        raise ValueError(
            f"recorded data not found in {folder}: set LIMSLAM_DATA to the folder that holds fr079 and kth"
        )
    return folder


def data_file(name: str) -> Path:
    """A file in the data folder.

    Raises
    ------
    ValueError
        If there is no such file, or no such folder.
    """
    path = data_folder() / name
    if not path.is_file():
        raise ValueError(f"{path}: no such file in the folder of recorded data")
    return path


# The plan and its free space are computed once for all seeds of the plan.
@functools.lru_cache(maxsize=8)
def world_source(world: str) -> WorldSource:
    """The argument of ``load_world`` for a job's world.

    Raises
    ------
    ValueError
        If the text does not name a floor plan.
    """
    if world.startswith(RANDOM):
        return load_world(world)
    if world.startswith(PLAN):
        return data_file(f"kth/{world.removeprefix(PLAN)}.json")
    return world


def contents(jobs: Iterable[Job]) -> dict[str, str]:
    """Digests of the worlds and logs that jobs use, by their names.

    Raises
    ------
    ValueError
        If a world or log is missing or invalid.
    """
    jobs = list(jobs)
    worlds = {job.world: load_world(world_source(job.world)).digest for job in jobs if job.log is None}
    sources = {job.log for job in jobs if job.log is not None}
    files = {name for source in sources for name in (source.file, source.relations) if name is not None}
    return worlds | {name: file_digest(data_file(name)) for name in files}


def check_log(source: LogSource) -> None:
    """Check that a log exists and that its options are valid.

    Raises
    ------
    ValueError
        If the log does not exist or an option is invalid.
    """
    for name in (source.file, source.relations):
        if name is not None:
            data_file(name)
    if source.max_range <= 0.0:
        raise ValueError(f"max_range: must be above 0 m, not {source.max_range:g}")
    _odometry(source)


def run_config(job: Job) -> RunConfig:
    """The run configuration of a job that is not a log.

    Raises
    ------
    ValueError
        If the job cannot be run.
    """
    begin = fault_begins(job)
    return RunConfig(
        world_source(job.world), job.noise, job.preset, job.seed,
        job.max_time if begin is None else begin + job.after_fault, job.laps,
        robots=job.robots, ablation=job.ablation, policy=job.policy, limit=job.limit, until=job.until,
        kidnap_at=begin if job.fault == KIDNAPPED else None,
    )  # fmt: skip


def run_job(job: Job) -> Outcome:
    """Run a job and score it. All random numbers depend on the job's seed only.

    Raises
    ------
    ValueError
        If the job cannot be run.
    """
    return _explored(job) if job.log is None else _replayed(job, job.log)


def simulated(config: RunConfig) -> Outcome:
    """Run the simulator by a configuration, and score the run."""
    return _scored(run_episode(config))


def _explored(job: Job) -> Outcome:
    begin = fault_begins(job)
    if job.fault is None or begin is None:
        return simulated(run_config(job))
    episode = run_episode(run_config(job), alter=Fault(job.fault, begin, job.seed).altered)
    scores = fault_scores(episode, begin)
    outcome = _scored(episode)
    return replace(outcome, metrics={**outcome.metrics, **scores})


def _scored(episode: Episode) -> Outcome:
    config = episode.config
    made_from = {"agent": asdict(config.agent), "robot": asdict(config.robot), "world": episode.world.digest}
    return Outcome(plain(score(episode)), cost(episode), _series(episode), digest(made_from))


def _series(episode: Episode) -> dict[str, FloatArray]:
    rows = _each_second(episode.time)
    sigma = np.sqrt(np.maximum(np.diagonal(episode.covariances[rows], axis1=-2, axis2=-1), 0.0))
    return {
        "time": episode.time[rows], "coverage": episode.coverage[rows], "true": episode.true[rows],
        "estimated": episode.estimated[rows], "odometry": episode.odometry[rows], "sigma": sigma,
        "segments": episode.final_map.segments, "edges": episode.world.edges, "doors": episode.world.doors,
    }  # fmt: skip


def _replayed(job: Job, source: LogSource) -> Outcome:
    from limslam_agent.logs.log_reader import read_log
    from limslam_agent.logs.relations import read_relations
    from limslam_agent.output.cost import run_cost
    from limslam_agent.replay.replay import relation_scores, replay_log
    from limslam_env.interface import NominalNoise

    path = data_file(source.file)
    settings = preset(job.preset, NominalNoise(job.noise))
    settings = settings if job.ablation is None else ablated(settings, job.ablation)
    config = replace(settings, odometry=_odometry(source))
    log = read_log(path, source.beams, source.max_range)
    result = replay_log(log, config)
    scores: dict[str, Any] = {"landmarks": len(result.segments), "refused_readings": result.refused_readings}
    if log.true_pose is not None:
        scores |= trajectory_scores(log.true_pose, result.estimated, result.odometry, result.covariances)
    if source.relations is not None:
        scores |= relation_scores(result, read_relations(data_file(source.relations)))
    rows = _each_second(log.time)
    series = {
        "time": log.time[rows], "estimated": result.estimated[rows, None], "odometry": result.odometry[rows, None],
        "segments": result.segments,
    }  # fmt: skip
    made_from = {"agent": asdict(config), "robot": asdict(log.robot), "log": file_digest(path)}
    spent = run_cost(float(np.ptp(log.time)), result.wall_clock, slam=result.slam_ms)
    return Outcome(plain(scores), spent, series, digest(made_from))


def _odometry(source: LogSource) -> OdometryConfig:
    turn, scale = source.odometry_bias
    return odometry_config(None, f"{turn!r},{scale!r}")


def file_digest(path: Path) -> str:
    """Digest of a file's content."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def _each_second(times: FloatArray) -> Any:
    """Indices of the first row in each period, and of the last row. The times of a log may decrease."""
    latest = np.maximum.accumulate(times - times[0])
    _, first = np.unique(np.floor(latest / SERIES_PERIOD + 1e-9), return_index=True)
    return np.union1d(first, [len(times) - 1])
