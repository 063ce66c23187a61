"""The execution of a job: its world and its scores."""

import functools
import os
from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path

from benchmarks.suite.faults import Fault, fault_begins, fault_scores
from benchmarks.suite.jobs import KIDNAPPED, PLAN, RANDOM, Job, Outcome, digest
from limslam_agent.output.export import plain
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.record import Episode
from limslam_agent.runs.results import cost, score
from limslam_agent.runs.run_config import RunConfig
from limslam_env.worlds.formats.loading import WorldSource, load_world


def data_folder() -> Path:
    """The folder of recorded data: ``LIMSLAM_DATA``, or ``shared/data`` beside the checkout."""
    return Path(os.environ.get("LIMSLAM_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


def data_file(name: str) -> Path:
    """A file or a folder of recorded data."""
    folder = data_folder()
    if not (folder / name).exists():
        raise ValueError(f"recorded data not found in {folder}: set LIMSLAM_DATA to the folder that holds {name}")
    return folder / name


# The plan and its free space are computed once for all seeds of the plan.
@functools.lru_cache(maxsize=8)
def world_source(world: str) -> WorldSource:
    """The argument of ``load_world`` for a job's world."""
    if world.startswith(RANDOM):
        return load_world(world)
    if world.startswith(PLAN):
        return data_file(f"kth/{world.removeprefix(PLAN)}.json")
    return world


def contents(jobs: Iterable[Job]) -> dict[str, str]:
    """Digests of the worlds that jobs use, by their names."""
    return {world: load_world(world_source(world)).digest for world in {job.world for job in jobs}}


def run_config(job: Job) -> RunConfig:
    """The run configuration of a job."""
    begin = fault_begins(job)
    return RunConfig(
        world_source(job.world), job.noise, job.preset, job.seed,
        job.max_time if begin is None else begin + job.after_fault, job.laps,
        robots=job.robots, ablation=job.ablation, policy=job.policy, limit=job.limit, until=job.until,
        kidnap_at=begin if job.fault == KIDNAPPED else None,
    )  # fmt: skip


def run_job(job: Job) -> Outcome:
    """Run a job and score it. All random numbers depend on the job's seed only."""
    begin = fault_begins(job)
    if job.fault is None or begin is None:
        return _scored(run_episode(run_config(job)))
    episode = run_episode(run_config(job), alter=Fault(job.fault, begin, job.seed).altered)
    scores = fault_scores(episode, begin)
    outcome = _scored(episode)
    return replace(outcome, metrics={**outcome.metrics, **scores})


def _scored(episode: Episode) -> Outcome:
    config = episode.config
    made_from = {"agent": asdict(config.agent), "robot": asdict(config.robot), "world": episode.world.digest}
    return Outcome(plain(score(episode)), cost(episode), digest(made_from))
