"""``limslam replay LOG LOG``: two logs of one building, joined if their maps fit together, and their folder."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from limslam_agent.cli.options import ReplayOptions
from limslam_agent.cli.replay import Job, job_of, scores_of
from limslam_agent.cli.settings import write_replay_settings
from limslam_agent.cli.terminal import progress_bar, warn

if TYPE_CHECKING:
    from limslam_agent.config.presets import AgentConfig
    from limslam_agent.replay.two_logs import JointReplay
    from limslam_env.interface import RobotSpec

_FOR_ONE_LOG = ("map", "calibrate")


def carry_out_both(options: ReplayOptions, agent: "AgentConfig", robot: "RobotSpec | None" = None) -> None:
    """Replay two logs, join them if they fit, write their folder, and print its summary.

    Raises
    ------
    ValueError
        If they cannot be replayed or written, or an option is for one log only.
    """
    from limslam_agent.output.run_folder import new_folder
    from limslam_agent.output.summary import record_summary, replay_summary
    from limslam_agent.replay.plausibility import log_warnings
    from limslam_agent.replay.two_logs import check_logs, replay_logs
    from limslam_agent.replay.two_logs_output import write_joint_replay
    from limslam_agent.runs.results import versions
    from limslam_env.messages import printable

    for name in _FOR_ONE_LOG:
        if getattr(options, name) is not None:
            raise ValueError(f"--{name.replace('_', '-')} is for one log, not for two")
    if options.log is None or options.other_log is None:
        raise ValueError("two logs are needed: limslam replay LOG LOG")
    jobs = job_of(options.log, options, agent, robot), job_of(options.other_log, _of_other(options), agent, robot)
    logs = [each.log for each in jobs]
    check_logs(logs, agent)
    target = options.out or Path("runs") / f"replay-{_stem(options.log)}-{_stem(options.other_log)}"
    count = sum(len(each) for each in logs)
    for each in logs:
        warn(log_warnings(each))
    with new_folder(target, force=options.force, numbered=options.out is None) as folder:
        with progress_bar("replaying", count) as advance:
            joint = replay_logs(
                logs, agent, lambda done: advance(done, f"{done} of {count} events"),
                lambda stage: advance(count, f"smoothing: {stage}"),
            )  # fmt: skip
        files = options.relations, options.other_relations or options.relations
        own = [scores_of(*each) for each in zip(jobs, joint.replays, files, strict=True)]
        sources = jobs[0].source, jobs[1].source
        scores = own[0], own[1], _scores(joint, jobs, is_shared=options.other_relations is None)
        content = write_joint_replay(folder.beside, joint, sources, scores, versions())
        write_replay_settings(folder.beside, options, agent, robot)
    for line in record_summary(content) + replay_summary(content["metrics"]):
        typer.echo(line)
    typer.echo(printable(f"results     {folder.target}"))


def _stem(path: Path) -> str:
    return path.name.split(".")[0]


def _of_other(options: ReplayOptions) -> ReplayOptions:
    """The options by which the second log is read."""
    return replace(options, log=options.other_log, relations=options.other_relations or options.relations)


def _scores(joint: "JointReplay", jobs: tuple[Job, Job], *, is_shared: bool) -> dict[str, Any]:
    """Metrics of both logs together. Relations that both logs share may lie between the logs."""
    from limslam_agent.replay.two_logs_output import relation_scores
    from limslam_agent.runs.smoothing import mean_scores
    from limslam_env.metrics.metrics import trajectory_metrics

    one, other = (each.relations for each in jobs)
    scores = relation_scores(joint, (one, one if is_shared else other))
    true = [each.log.true_pose for each in jobs if each.log.true_pose is not None]
    if len(true) < 2 or not joint.is_joined:
        return scores
    kinds = {"": joint.online(), "odometry_": joint.odometry(), "smoothed_": joint.poses}
    for kind, paths in kinds.items():
        found = mean_scores([dict(trajectory_metrics(*each)) for each in zip(true, paths, strict=True)])
        scores |= {("ate_smoothed_m" if kind == "smoothed_" else f"{kind}ate_m"): found["ate_m"]}
    return scores
