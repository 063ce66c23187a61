"""Maps from a recorded log, scores the result, and writes it to a folder."""

import math
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.config.presets import AgentConfig
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.logs.relations import Relations, relation_errors, summary
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.output.export import map_content, write_covariances, write_json, write_map
from limslam_agent.output.finished_run import COVARIANCES, UNPLACED
from limslam_agent.output.provenance import versions
from limslam_agent.output.summary import place_records, record_of, run_cost, turn_records
from limslam_agent.output.tum import write_paths
from limslam_agent.places.saved_map import SavedMap
from limslam_agent.replay.hand_over import LogEstimate
from limslam_agent.replay.record import Replay, SelfCalibration
from limslam_agent.slam.core.diagnostics import AssociationRecord, Closure
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.status import Status, final_status_scores, status_scores
from limslam_env.geometry.se2 import compose


def replay_log(
    log: RecordedLog,
    config: AgentConfig,
    progress: Callable[[int], None] | None = None,
    report: Callable[[str], None] | None = None,
    prior_map: SavedMap | None = None,
) -> Replay:
    """Map from a log, event by event, as if the robot were driving now.

    Parameters
    ----------
    log
        The log.
    config
        Settings.
    progress
        Called after each event with the number of events that are done.
    report
        Called at the start of each stage of the smoothing with the stage in words. Smoothing can
        take minutes.
    prior_map
        The map of an earlier run, in which the log begins at an unknown place. Only for logs of
        wheel travel.
    """
    report = report or (lambda _: None)
    mapper = Mapper(log.robot, config, log.start_pose, prior_map=prior_map)
    mapper.longest_travel = math.inf  # a log may have gaps; its reader knows the times
    estimate = LogEstimate(mapper, log)
    begin = time.perf_counter()
    rows = _estimated_rows(log, estimate, progress or (lambda _: None))
    mapper.finish()
    if mapper.prior_frame is not None:
        own = slice(mapper.places.records[0]["step"])
        for name in ("estimated", "odometry"):
            rows[name][own] = compose(mapper.prior_frame, rows[name][own])
    slam = mapper.slam
    calibration = slam.odometry_calibrations[0]
    replay = Replay(
        log=log,
        config=config,
        **rows,
        status=estimate.status,
        landmarks=slam.landmarks,
        segments=slam.segments,
        grid=mapper.grid,
        refused_readings=estimate.refused_readings - log.repeated,
        self_calibration=calibration and SelfCalibration(*calibration, log.robot.axle),
        wall_clock=time.perf_counter() - begin,
        places=estimate.places,
        handed_over=estimate.handed_over,
        beam_turns=slam.beam_turns,
        sensor=slam.sensor if isinstance(config.estimator, ConsistentConfig) else None,
    )
    # The line smoother does not know the lines of an earlier map.
    sees_all = mapper.prior_frame is None
    filtered = slam.associations, list(slam.closures)
    del estimate, mapper, slam  # the smoothing needs their memory
    return _smoothed(replay, filtered, report, by_lines=sees_all)


def _smoothed(
    replay: Replay,
    filtered: tuple[list[AssociationRecord], list[Closure]],
    report: Callable[[str], None],
    *,
    by_lines: bool,
) -> Replay:
    """The replay with its log smoothed, if its settings ask for it.

    ``filtered`` has the associations of the filter, and the landmarks that it merged.
    """
    log = replay.log
    config = replay.config
    if log.odometry is not None and config.smoothing is not None:
        from limslam_agent.replay.smoothing import smoothed_by_graph

        return smoothed_by_graph(replay, config.smoothing, report)
    if log.wheels is not None and config.run_smoothing is not None and by_lines:
        from limslam_agent.replay.smoothing import smoothed_by_lines

        report("all poses and walls")
        return smoothed_by_lines(replay, *filtered, config.run_smoothing)
    return replay


def _estimated_rows(
    log: RecordedLog, estimate: LogEstimate, progress: Callable[[int], None]
) -> dict[str, Any]:
    """What is estimated after each event of a log, by the names of the arrays in
    :class:`Replay`.
    """
    count = len(log)
    rows: dict[str, Any] = {
        "estimated": np.empty((count, 3)),
        "covariances": np.empty((count, 3, 3)),
        "odometry": np.empty((count, 3)),
        "levels": np.empty(count, dtype=np.int64),
        "slam_ms": np.empty(count),
        "job_ms": np.empty(count),
    }
    for number, observation in enumerate(log.observations()):
        for row, value in zip(rows.values(), estimate.step(observation), strict=True):
            row[number] = value
        progress(number + 1)
    return rows


def relation_scores(replay: Replay, relations: Relations) -> dict[str, Any]:
    """Errors of relative poses against known ones: of the estimate, of corrected odometry, and of
    odometry as recorded.
    """
    log = replay.log
    trajectories = {"": replay.estimated, "odometry_": replay.odometry}
    if replay.smoothed is not None:
        trajectories["smoothed_"] = replay.smoothed.poses
    if log.odometry is not None:
        trajectories["raw_odometry_"] = log.odometry
    scores: dict[str, Any] = {}
    for prefix, poses in trajectories.items():
        errors = relation_errors(relations, log.time, poses, log.odometry)
        scores |= {prefix + name: value for name, value in summary(errors).items()}
    return scores


def _hand_over(replay: Replay) -> dict[str, float]:
    """When the online graph took over from the filter, for ``result.json``; empty if it did not."""
    time = replay.log.time
    event = replay.handed_over
    return {} if event is None else {"online_graph_from_s": float(time[event] - time[0])}


def write_replay(
    folder: Path, replay: Replay, source: dict[str, str | None], scores: dict[str, Any]
) -> dict[str, Any]:
    """Write trajectory, map, picture and result of a replay into a folder. Returns the content of
    ``result.json``.

    Parameters
    ----------
    folder
        An existing folder.
    replay
        What is written.
    source
        Names of the files that the replay used, such as ``log`` and ``relations``.
    scores
        Metrics of the trajectory.
    """
    log = replay.log
    smoothed = replay.smoothed
    _write_trajectories(folder, replay)
    if smoothed is not None and smoothed.loops is not None:
        write_json(folder / "loops.json", smoothed.loops)
    if smoothed is not None and smoothed.graph is not None:
        write_json(folder / "graph.json", smoothed.graph)
    if replay.places.unplaced is not None:
        write_json(folder / UNPLACED, map_content(replay.places.unplaced, "local"))
    write_map(folder, replay)
    statuses = _status_scores(replay)
    figures = {} if smoothed is None else smoothed.figures
    drawn = Status(
        figures.get("smoothed_status", statuses["status"]),
        figures.get("smoothed_status_reason", statuses["status_reason"]),
    )
    _draw_picture(
        folder,
        replay,
        f"{source['log']}, {len(log.robot.beams)} beams, {replay.config.preset}",
        drawn,
    )
    calibration = replay.self_calibration.figures if replay.self_calibration else {}
    counts = {"landmarks": len(replay.segments), "refused_readings": replay.refused_readings}
    record = record_of(
        log.time, [replay.odometry if log.true_pose is None else log.true_pose], [replay.odometry]
    )
    result = {
        "metrics": {**scores, **calibration, **statuses, **_hand_over(replay), **counts, **figures},
        "cost": _cost(replay),
        "config": {**source, "robot": asdict(log.robot), "agent": asdict(replay.config)},
        "record": {
            **record,
            "sensor": replay.sensor
            and replay.sensor.found(_specified(replay), log.robot.control_period),
            "beam_turns": turn_records(replay.beam_turns),
            "places": place_records(log.time, replay.places.records),
        },
        "versions": versions(),
        "seed": None,
    }
    write_json(folder / "result.json", result)
    return result


def _specified(replay: Replay) -> RangeSensor:
    return RangeSensor(replay.config.range_std, cone=replay.log.robot.cone)


def _write_trajectories(folder: Path, replay: Replay) -> None:
    """Write the paths of a replay with their covariances, and the true path if it is known."""
    smoothed = replay.smoothed
    paths = {"est": replay.estimated, "odometry": replay.odometry, "true": replay.log.true_pose}
    paths["smoothed"] = None if smoothed is None else smoothed.poses
    write_paths(
        folder,
        replay.log.time,
        {kind: [poses] for kind, poses in paths.items() if poses is not None},
    )
    of_smoothed = (
        None if smoothed is None or smoothed.covariances is None else smoothed.covariances[:, None]
    )
    write_covariances(folder / COVARIANCES, replay.covariances[:, None], of_smoothed)


def _status_scores(replay: Replay) -> dict[str, Any]:
    """The status while driving and at the end, for ``result.json``."""
    time = replay.log.time
    levels = replay.levels[:, None]
    smoothed = replay.smoothed
    scores = status_scores(time, levels, replay.status)
    if smoothed is not None and smoothed.status is not None:
        scores |= final_status_scores(smoothed.status, replay.status, time, levels)
    return scores


def _draw_picture(folder: Path, replay: Replay, title: str, status: Status) -> None:
    """Draw the map with the best path, and with the path that was estimated online if that is
    another one.
    """
    from limslam_agent.output.drawing import MapPicture, draw_map

    true = replay.log.true_pose
    smoothed = replay.smoothed
    path = replay.estimated if smoothed is None else smoothed.poses
    picture = MapPicture(
        title,
        replay.segments,
        [path[:, :2]],
        [replay.odometry[:, :2]],
        true=[] if true is None else [true[:, :2]],
        grid=replay.grid,
        online=[] if smoothed is None else [replay.estimated[:, :2]],
        remark=status.remark,
    )
    draw_map(folder / "map.png", picture)


def _cost(replay: Replay) -> dict[str, Any]:
    """Time and memory that a replay took, for ``result.json``."""
    cost = run_cost(float(np.ptp(replay.log.time)), replay.wall_clock, slam=replay.slam_ms)
    if replay.job_ms.any():
        cost |= {"jobs": int((replay.job_ms > 0.0).sum()), "job_ms_max": float(replay.job_ms.max())}
    if replay.smoothed is not None:
        cost |= {"smoothing_cpu_s": replay.smoothed.seconds}
    return cost
