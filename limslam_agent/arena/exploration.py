"""A plan: the entry drives, the arena's mapper draws the map, and both are scored."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from limslam_agent.arena.command import CommandActor
from limslam_agent.arena.entry import Entry
from limslam_agent.arena.scoring import correct_coverage, exploration_scores
from limslam_agent.arena.tracks import Plan
from limslam_agent.policies.policy import Policy
from limslam_agent.runs.actor_checks import is_policy
from limslam_agent.runs.actors import ActorPolicy
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.policy_file import made_by_file, naming_lines_of
from limslam_agent.runs.record import Episode
from limslam_agent.runs.results import cost, score
from limslam_agent.runs.run_config import RunConfig

if TYPE_CHECKING:
    from limslam_env.envs.parallel_env import LimSlamParallelEnv

Keep = Callable[[Path, Episode], dict[str, Any]]
"""Writes the folder of a run and returns its metrics."""


def run_config(entry: Entry, plan: Plan) -> RunConfig:
    """What is run: the command ``limslam run`` with the same settings drives the same run for a shipped policy."""
    manifest = entry.manifest
    is_named = manifest.kind != "command"
    return RunConfig(
        plan.world, plan.noise, manifest.preset, plan.seed, plan.max_time, robots=plan.robots,
        policy=entry.run if is_named else "frontier", true_noise=plan.true_noise,
        driver="" if is_named else f"command {manifest.name}",
    )  # fmt: skip


def explore(
    entry: Entry, plan: Plan, folder: Path | None = None, keep: Keep | None = None
) -> tuple[dict[str, Any], dict[str, float]]:
    """Let an entry explore a plan. Returns metrics and cost.

    Parameters
    ----------
    entry, plan
        Who explores what.
    folder, keep
        The folder of the run, and what writes it. None keeps nothing.
    """
    config, last = run_config(entry, plan), dict[str, "LimSlamParallelEnv"]()
    policies = _policies(entry, config)
    try:
        episode = run_episode(config, lambda _team, env, _time, _share: last.update(env=env), policies=policies)
    finally:
        for policy in policies or ():
            if isinstance(policy, ActorPolicy):
                policy.close()
    metrics = score(episode) if folder is None or keep is None else keep(folder, episode)
    correct = correct_coverage(episode.coverage_grid, last["env"].seen, episode.final_map.grid)
    mine = exploration_scores(plan, episode.time, episode.coverage, correct, is_finished=episode.is_finished)
    best = metrics.get("ate_smoothed_m", metrics["ate_m"])
    nees = metrics.get("anees_smoothed", metrics["anees"])
    final = {"ate_final_m": best, "anees_final": nees, "touches": metrics["collisions"]}
    return {**metrics, **mine, **final}, cost(episode)


def _policies(entry: Entry, config: RunConfig) -> list[Policy] | None:
    """A policy for each robot. None for shipped policies, which the run makes by their names."""
    manifest, robots = entry.manifest, range(config.robots)
    if manifest.kind == "shipped":
        return None
    if manifest.kind == "command":
        return [ActorPolicy(CommandActor(manifest.command, entry.folder, config.robot)) for _ in robots]
    made = made_by_file(entry.run, config.robot, config.agent.policy, robots=config.robots, seed=config.seed)
    with naming_lines_of(entry.run):
        return [_policy(each, manifest.uses) for each in made]


def _policy(made: Any, uses: str) -> Policy:
    """What a Python class makes as a policy, if it uses what the manifest says."""
    found = "belief" if is_policy(made) else "readings"
    if found != uses:
        raise ValueError(f"{type(made).__name__} acts on {found}, and the manifest says that it uses {uses}")
    policy: Policy = made if found == "belief" else ActorPolicy(made)
    return policy
