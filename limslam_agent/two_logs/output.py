"""The folder of two logs: each log's own results, and the map and the paths of both in one
frame.
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from limslam_agent.logs.relations import RelationErrors, Relations, relation_errors, summary
from limslam_agent.output.export import map_content, write_json, write_map
from limslam_agent.output.finished_run import UNPLACED
from limslam_agent.output.provenance import versions
from limslam_agent.output.summary import run_cost
from limslam_agent.output.tum import write_tum
from limslam_agent.replay.replay import write_replay
from limslam_agent.two_logs.joint import JointReplay

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
    for number, replay in enumerate(joint.replays):
        for kind, paths in joint.paths().items():
            write_tum(folder / f"trajectory_{kind}_{number}.tum", replay.log.time, paths[number])
    true = [
        (each.log.time, each.log.true_pose)
        for each in joint.replays
        if each.log.true_pose is not None
    ]
    if joint.is_joined and len(true) == len(joint.replays):
        for number, (time, poses) in enumerate(true):
            write_tum(folder / f"trajectory_true_{number}.tum", time, poses)
    write_map(folder, joint)
    if joint.unplaced is not None:
        write_json(folder / UNPLACED, map_content(joint.unplaced, "local"))
    if joint.loops is not None:
        write_json(folder / "loops.json", joint.loops)
    _draw(folder / "map.png", joint, sources)
    result = _result(joint, sources, scores[2], own)
    write_json(folder / "result.json", result)
    return result


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
        "versions": versions(),
        "seed": None,
    }


def _draw(path: Path, joint: JointReplay, sources: tuple[Source, Source]) -> None:
    """Draw the map with the paths of both logs; of the first log only if they are not joined."""
    from limslam_agent.output.drawing import MapPicture, draw_map

    count = 2 if joint.is_joined else 1
    names = " and ".join(str(each["log"]) for each in sources[:count])
    beams = " and ".join(
        str(number) for number in dict.fromkeys(len(each.log.robot.beams) for each in joint.replays)
    )
    true_paths = [
        each.log.true_pose[:, :2]
        for each in joint.replays[:count]
        if each.log.true_pose is not None
    ]
    online, odometry, smoothed = (
        [poses[:, :2] for poses in paths[:count]] for paths in joint.paths().values()
    )
    picture = MapPicture(
        f"{names}, {beams} beams, {joint.replays[0].config.preset}",
        joint.segments,
        smoothed,
        odometry,
        true=true_paths if len(true_paths) == count else [],
        grid=joint.grid,
        online=online,
        remark=joint.status.remark,
    )
    draw_map(path, picture)
