"""The folder of two logs: each log's own results, and the map and the paths of both in one
frame.
"""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from limslam_agent.logs.relations import RelationErrors, Relations, relation_errors, summary
from limslam_agent.output.map_picture import MapPicture
from limslam_agent.output.results import Results, write_results
from limslam_agent.output.summary import run_cost
from limslam_agent.replay.replay import write_replay
from limslam_agent.two_logs.joint import JointReplay
from limslam_env.geometry import FloatArray

LOG_FOLDERS = ("log_0", "log_1")
"""The folders of the results of each log by itself."""

Source = dict[str, str | None]


def relation_scores(
    joint: JointReplay, relations: tuple[Relations | None, Relations | None]
) -> dict[str, Any]:
    """Errors of relative poses against known ones: over the relations of each log, and over those
    between the logs.

    Relations between the logs are known only if one set of relations is given for both logs, and
    the times of the logs do not overlap.
    """
    logs = [each.log for each in joint.replays]
    scores = dict[str, Any]()
    paths = joint.paths()
    for prefix, kind in (("", "est"), ("odometry_", "odometry"), ("smoothed_", "smoothed")):
        errors = [
            relation_errors(known, log.time, path, log.odometry)
            for known, log, path in zip(relations, logs, paths[kind], strict=True)
            if known is not None
        ]
        if errors:
            scores |= {prefix + name: value for name, value in summary(*errors).items()}
    one, other = relations
    is_apart = logs[0].time.max() < logs[1].time.min() or logs[1].time.max() < logs[0].time.min()
    if joint.is_joined and one is not None and one is other and is_apart:
        found = summary(_errors_between(joint, one))
        scores |= {
            f"smoothed_between_{name}": value for name, value in found.items() if "loop" not in name
        }
    return scores


def _errors_between(joint: JointReplay, known: Relations) -> RelationErrors:
    """Errors of the relations that begin in one log and end in the other one."""
    logs = [each.log for each in joint.replays]
    begins, ends = (
        [(when >= log.time.min()) & (when <= log.time.max()) for log in logs]
        for when in (known.start_time, known.end_time)
    )
    chosen = (begins[0] & ends[1]) | (begins[1] & ends[0])
    known = Relations(known.start_time[chosen], known.end_time[chosen], known.relative[chosen])
    odometry = [log.odometry for log in logs if log.odometry is not None]
    time = np.concatenate([log.time for log in logs])
    poses = np.concatenate(joint.poses)
    return relation_errors(known, time, poses, np.concatenate(odometry) if odometry else None)


def write_joint_replay(
    folder: Path,
    joint: JointReplay,
    sources: tuple[Source, Source],
    scores: tuple[dict[str, Any], dict[str, Any], dict[str, Any]],
) -> dict[str, Any]:
    """Write the results of two logs into a folder. Returns the content of ``result.json``.

    Parameters
    ----------
    folder
        An existing folder.
    joint
        What is written.
    sources
        Names of the files that each log used.
    scores
        Metrics of each log by itself, and of both together.
    """
    own = []
    for name, replay, source, each in zip(
        LOG_FOLDERS, joint.replays, sources, scores[:2], strict=True
    ):
        (folder / name).mkdir()
        own.append(write_replay(folder / name, replay, source, each))
    true = [each.log.true_pose for each in joint.replays if each.log.true_pose is not None]
    paths: dict[str, Sequence[FloatArray]] = {**joint.paths()}
    if joint.is_joined and len(true) == len(joint.replays):
        paths["true"] = true
    # Of logs that are not joined, the picture shows the first one only.
    shown = joint.replays if joint.is_joined else joint.replays[:1]
    names = " and ".join(str(source["log"]) for source in sources[: len(shown)])
    beams = dict.fromkeys(len(each.log.robot.beams) for each in joint.replays)
    known = [each.log.true_pose for each in shown if each.log.true_pose is not None]
    drawn = {kind: each[: len(shown)] for kind, each in paths.items()}
    if len(known) == len(shown):
        drawn["true"] = known
    results = Results(
        times=[each.log.time for each in joint.replays],
        paths=paths,
        final=joint,
        picture=MapPicture.of(
            f"{names}, {' and '.join(map(str, beams))} beams, {joint.replays[0].config.preset}",
            joint.segments,
            drawn,
            grid=joint.grid,
            remark=joint.status.remark,
        ),
        content=_result(joint, sources, scores[2], own),
        unplaced=joint.unplaced,
        tables={} if joint.loops is None else {"loops.json": joint.loops},
    )
    return write_results(folder, results)


def _result(
    joint: JointReplay,
    sources: tuple[Source, Source],
    scores: dict[str, Any],
    own: list[dict[str, Any]],
) -> dict[str, Any]:
    replays = joint.replays
    duration = sum(float(np.ptp(each.log.time)) for each in replays)
    records = [each["record"] for each in own]
    statuses = {
        "status": joint.status.level,
        "status_reason": joint.status.reason,
        "status_chance": joint.status.chance,
        "status_note": "",
    }
    counts = {
        "landmarks": len(joint.segments),
        "refused_readings": sum(each.refused_readings for each in replays),
    }
    seconds = [each.smoothed.seconds for each in replays if each.smoothed is not None]
    cost = run_cost(
        duration,
        sum(each.wall_clock for each in replays),
        slam=np.concatenate([each.slam_ms for each in replays]),
    )
    return {
        "metrics": {**scores, **joint.figures, **statuses, **counts},
        "cost": {**cost, "smoothing_cpu_s": sum(seconds) + joint.seconds},
        "config": {
            "log": " and ".join(str(each["log"]) for each in sources),
            "logs": [each["log"] for each in sources],
            "relations": [each["relations"] for each in sources],
            "robot": asdict(replays[0].log.robot),
            "robots": [asdict(each.log.robot) for each in replays],
            "agent": asdict(replays[0].config),
        },
        "record": {
            "steps": sum(each["steps"] for each in records),
            "duration_s": duration,
            "driven_m": sum(each["driven_m"] for each in records),
            "places": [{"step": 0, "time_s": 0.0, **joint.record}],
        },
        "seed": None,
    }
