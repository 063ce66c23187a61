"""Runs an entry on plans, in several processes, and stores each result as soon as its plan has
ended.

The entry drives, the arena's mapper draws the map, and both are scored.
"""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from limslam_agent.arena.command import CommandActor, rights_of, without_folders
from limslam_agent.arena.entry import Entry
from limslam_agent.arena.results import FORMAT, RUNS, Row, digest_of, stamp_of
from limslam_agent.arena.scoring import BOUNDS, correct_coverage, exploration_scores, lost_scores
from limslam_agent.arena.tracks import Plan
from limslam_agent.measurements.linux import hide_memory
from limslam_agent.measurements.processes import Failure, Processes
from limslam_agent.measurements.store import open_store
from limslam_agent.output.export import plain
from limslam_agent.output.provenance import commit, versions
from limslam_agent.policies.policy import Policy
from limslam_agent.runs.actor_checks import acts_on_belief
from limslam_agent.runs.actors import ActorPolicy
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.policy_file import is_termination, made_by_file, naming_lines_of
from limslam_agent.runs.record import Episode
from limslam_agent.runs.results import cost as cost_of
from limslam_agent.runs.results import score
from limslam_agent.runs.run_config import RunConfig
from limslam_env.envs.parallel_env import LimSlamParallelEnv
from limslam_env.messages import one_line

Keep = Callable[[Path, Episode], dict[str, Any]]
"""Writes the folder of a run and returns its metrics."""

Report = Callable[[Row, int], None]
"""Called with each new row and the number of rows that exist."""


@dataclass(frozen=True)
class Job:
    """A plan that an entry has to run, and the provenance of its row.

    ``keep`` writes the folder of the run and returns its metrics. None keeps nothing. ``user`` is
    the user whose rights a command has, and None is the present user.
    """

    entry: Entry
    plan: Plan
    versions: dict[str, str]
    commit: str
    keep: Callable[[Episode], dict[str, Any]] | None = None
    user: str | None = None


class Execution(NamedTuple):
    """How plans are run: the number of processes, what writes the folders of runs (None: nothing),
    whether plans that failed are run again, and whose rights a command has (None: the present
    user's).
    """

    jobs: int = 1
    keep: Keep | None = None
    retry_failed: bool = False
    user: str | None = None


def run_entry(
    entry: Entry,
    plans: Sequence[Plan],
    folder: Path,
    seed: int,
    execution: Execution,
    report: Report = lambda _row, _count: None,
) -> list[Row]:
    """Run the plans of a seed that have no row in a folder yet. Returns all rows of these plans.

    The folder may contain earlier results of the same entry. ``report`` is called with each new
    row.

    Raises
    ------
    ValueError
        If the folder cannot be used, or a process of the arena has died.
    """
    place = folder.absolute()
    inside = entry.folder.resolve()
    if folder.resolve() == inside or inside in folder.resolve().parents:
        raise ValueError(
            f"{folder}: lies in the folder of the entry, which must not change while it runs"
        )
    rights_of(execution.user)
    stamp = stamp_of(entry, seed, versions=versions(), commit=commit())
    again = {plan.number for plan in plans} if execution.retry_failed else set()
    with open_store(
        FORMAT, folder, stamp, lambda row: row.error is None or row.plan not in again
    ) as store:
        todo = [
            Job(
                entry,
                plan,
                stamp.versions,
                stamp.commit,
                execution.keep and partial(execution.keep, place / RUNS / f"{plan.number:03d}"),
                execution.user,
            )
            for plan in plans
            if plan.number not in store.rows
        ]
        for row in results_of(todo, execution.jobs):
            store.append(row)
            report(row, sum(plan.number in store.rows for plan in plans))
        return [store.rows[plan.number] for plan in plans]


def results_of(todo: Sequence[Job], jobs: int) -> Iterator[Row]:
    """The rows of jobs as they end, in any order.

    A command could read the plans in the memory of the processes above it, which is hidden. It
    always runs under a process of its own, which ends all that the command has started.
    """
    is_process = any(job.entry.manifest.is_process for job in todo)
    if is_process:
        hide_memory()
    if jobs == 1 and not is_process:
        yield from map(run_job, todo)
        return
    with closing(Processes(jobs).run(todo, run_job)) as results:
        for job, row in results:
            if isinstance(row, Failure):
                raise ValueError(  # noqa: TRY004 (a process has failed)
                    f"plan {job.plan.number}: {row.reason}; the same command goes on"
                )
            yield row


def run_job(job: Job) -> Row:
    """Run a plan. Whatever the entry's code raises becomes the error of the row, and the plan is
    lost.
    """
    plan = job.plan
    manifest = job.entry.manifest
    if manifest.is_process:
        hide_memory()
    provenance: dict[str, Any] = {
        "versions": job.versions,
        "commit": job.commit,
        "settings": digest_of({"plan": plan.setting, "entry": job.entry.digest}),
    }
    begin = time.perf_counter()
    cpu = _cpu_s()
    error = None
    cost: dict[str, float] = {}
    try:
        if plan.robots > manifest.robots:
            raise ValueError(f"the entry drives one robot, and the plan has {plan.robots}")  # noqa: TRY301
        metrics, cost = explore(job)
    except OSError:  # no space, or no permission: not the entry's failure
        raise
    except (Exception, SystemExit) as failure:
        if is_termination(failure):
            raise
        error = (
            f"{failure}"
            if isinstance(failure, ValueError)
            else f"{type(failure).__name__}: {failure}"
        )
        error = one_line(without_folders(error, (job.entry.folder,)))
        metrics = lost_scores(plan, f"failed: {error}")
    cost = {**cost, "cpu_s": _cpu_s() - cpu, "wall_clock_s": time.perf_counter() - begin}
    return Row(plan.number, plan.setting, plain(metrics), plain(cost), **provenance, error=error)


def _cpu_s() -> float:
    """Processor time of this process and of its children that have ended, s. Windows tells nothing
    of children.
    """
    if sys.platform == "win32":
        return time.process_time()
    import resource

    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def explore(job: Job) -> tuple[dict[str, Any], dict[str, float]]:
    """Let an entry explore a plan. Returns metrics and cost.

    The command ``limslam run`` with the same settings drives the same run for a shipped policy.
    """
    entry = job.entry
    plan = job.plan
    last = dict[str, LimSlamParallelEnv]()
    is_named = not entry.manifest.is_process
    asked = replace(
        plan, preset=entry.manifest.preset, policy=entry.run if is_named else "frontier"
    )
    config = RunConfig(
        **asked.spec,
        true_noise=plan.true_noise,
        driver="" if is_named else f"command {entry.manifest.name}",
    )
    policies = _policies(job, config)
    try:
        episode = run_episode(
            config, lambda _team, env, _time, _share: last.update(env=env), policies=policies
        )
    finally:
        for policy in policies or ():
            if isinstance(policy, ActorPolicy):
                policy.close()
    metrics = (job.keep or score)(episode)
    correct = correct_coverage(episode.coverage_grid, last["env"].seen, episode.final_map.grid)
    mine = exploration_scores(
        plan, episode.time, episode.coverage, correct, is_finished=episode.claims_explored
    )
    best = metrics.get("ate_smoothed_m", metrics["ate_m"])
    nees = metrics.get("anees_smoothed", metrics["anees"])
    final = {"ate_final_m": best, "anees_final": nees, "touches": metrics["collisions"]}
    found = {**metrics, **mine, **final}
    if entry.manifest.is_process:
        found = {name: found[name] for name in BOUNDS}
    return found, cost_of(episode)


def _policies(job: Job, config: RunConfig) -> list[Policy] | None:
    """A policy for each robot. None for shipped policies, which the run makes by their names."""
    entry = job.entry
    manifest = job.entry.manifest
    if manifest.kind == "shipped":
        return None
    if manifest.is_process:
        return [
            ActorPolicy(CommandActor(manifest.command, entry.folder, config.robot, job.user))
            for _ in range(config.robots)
        ]
    made = made_by_file(
        entry.run, config.robot, config.agent.policy, robots=config.robots, seed=config.seed
    )
    with naming_lines_of(entry.run):
        return [_policy(each, manifest.uses) for each in made]


def _policy(made: Any, uses: str) -> Policy:
    """What a Python class makes as a policy, if it uses what the manifest says."""
    found = "belief" if acts_on_belief(made) else "readings"
    if found != uses:
        raise ValueError(
            f"{type(made).__name__} acts on {found}, and the manifest says that it uses {uses}"
        )
    policy: Policy = made if found == "belief" else ActorPolicy(made)
    return policy
