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
from limslam_agent.output.export import write_covariances
from limslam_agent.output.finished_run import COVARIANCES
from limslam_agent.output.map_picture import MapPicture
from limslam_agent.output.results import Results, write_results
from limslam_agent.output.summary import record_of, run_cost, sensor_record
from limslam_agent.places.saved_map import SavedMap
from limslam_agent.replay.hand_over import ESTIMATE, LogEstimate
from limslam_agent.replay.record import Replay, SelfCalibration
from limslam_agent.status.status import Status, final_status_scores, status_scores
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose


def replay_log(
    log: RecordedLog,
    config: AgentConfig,
    progress: Callable[[int], None] | None = None,
    report: Callable[[str], None] | None = None,
    prior_map: SavedMap | None = None,
) -> Replay:
    r"""Map from a log, event by event, as if the robot were driving now.

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

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from limslam_agent import preset, read_log, replay_log
    >>> rows = [f"{0.1 * i},{0.02 * i},0.0,0.0,0.8,1.1,0.9" for i in range(60)]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     table = Path(folder) / "drive.csv"
    ...     _ = table.write_text("t,x,y,theta,r_90,r_0,r_-90\n" + "\n".join(rows))
    ...     log = read_log(table)
    >>> replay = replay_log(log, preset("consistent"))
    >>> replay.estimated.shape
    (60, 3)
    """
    report = report or (lambda _: None)
    mapper = Mapper(log.robot, config, log.start_pose, prior_map=prior_map)
    mapper.longest_travel = math.inf  # a log may have gaps; its reader knows the times
    estimate = LogEstimate(mapper, log)
    begin = time.perf_counter()
    rows = np.empty(len(log), ESTIMATE)
    for number, observation in enumerate(log.observations()):
        rows[number] = estimate.step(observation)
        if progress is not None:
            progress(number + 1)
    mapper.finish()
    columns: dict[str, Any] = {
        name: np.ascontiguousarray(rows[name]) for name in ESTIMATE.names or ()
    }
    if mapper.prior_frame is not None:
        own = slice(mapper.places.records[0]["step"])
        for name in ("estimated", "odometry"):
            columns[name][own] = compose(mapper.prior_frame, columns[name][own])
    slam = mapper.slam
    calibration = slam.odometry_calibrations[0]
    replay = Replay(
        log=log,
        config=config,
        **columns,
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
    by_lines = mapper.prior_frame is None and log.wheels is not None
    associations = slam.associations
    closures = list(slam.closures)
    del estimate, mapper, slam, rows  # the smoothing needs their memory
    if log.odometry is not None and config.smoothing is not None:
        from limslam_agent.replay.smoothing import smoothed_by_graph

        return smoothed_by_graph(replay, config.smoothing, report)
    if by_lines and config.run_smoothing is not None:
        from limslam_agent.replay.smoothing import smoothed_by_lines

        report("all poses and walls")
        return smoothed_by_lines(replay, associations, closures, config.run_smoothing)
    return replay


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


def write_replay(
    folder: Path,
    replay: Replay,
    source: dict[str, str | None],
    scores: dict[str, Any],
    true_edges: FloatArray | None = None,
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
        Metrics of trajectory and map.
    true_edges
        True walls (k, 4), m, if they are known.
    """
    log = replay.log
    smoothed = replay.smoothed
    true = log.true_pose
    paths = {"est": [replay.estimated], "odometry": [replay.odometry]}
    if true is not None:
        paths["true"] = [true]
    figures = dict[str, Any]()
    tables = dict[str, Any]()
    of_smoothed = None
    if smoothed is not None:
        paths["smoothed"] = [smoothed.poses]
        figures = smoothed.figures
        tables = smoothed.tables
        if smoothed.covariances is not None:
            of_smoothed = smoothed.covariances[:, None]
    write_covariances(folder / COVARIANCES, replay.covariances[:, None], of_smoothed)
    metrics = {**scores, **_metrics(replay), **figures}
    shown = "smoothed_status" if "smoothed_status" in figures else "status"
    status = Status(metrics[shown], metrics[f"{shown}_reason"])
    results = Results(
        times=[log.time],
        paths=paths,
        final=replay,
        picture=MapPicture.of(
            f"{source['log']}, {len(log.robot.beams)} beams, {replay.config.preset}",
            replay.segments,
            paths,
            grid=replay.grid,
            remark=status.remark,
            true_edges=true_edges,
        ),
        content={
            "metrics": metrics,
            "cost": _cost(replay),
            "config": {**source, "robot": asdict(log.robot), "agent": asdict(replay.config)},
            "record": {
                **record_of(
                    log.time,
                    [replay.odometry if true is None else true],
                    [replay.odometry],
                    replay.places.records,
                ),
                **sensor_record(
                    replay.sensor, replay.beam_turns, replay.config.range_std, log.robot
                ),
            },
            "seed": None,
        },
        unplaced=replay.places.unplaced,
        tables=tables,
    )
    return write_results(folder, results)


def _metrics(replay: Replay) -> dict[str, Any]:
    """What a replay says of itself: calibration, status, hand-over and counts."""
    time = replay.log.time
    levels = replay.levels[:, None]
    smoothed = replay.smoothed
    metrics = replay.self_calibration.figures if replay.self_calibration else {}
    metrics |= status_scores(time, levels, replay.status)
    if smoothed is not None and smoothed.status is not None:
        metrics |= final_status_scores(smoothed.status, replay.status, time, levels)
    if replay.handed_over is not None:
        metrics["online_graph_from_s"] = float(time[replay.handed_over] - time[0])
    metrics["landmarks"] = len(replay.segments)
    metrics["refused_readings"] = replay.refused_readings
    return metrics


def _cost(replay: Replay) -> dict[str, Any]:
    """Time and memory that a replay took, for ``result.json``."""
    cost = run_cost(float(np.ptp(replay.log.time)), replay.wall_clock, slam=replay.slam_ms)
    if replay.job_ms.any():
        cost |= {"jobs": int((replay.job_ms > 0.0).sum()), "job_ms_max": float(replay.job_ms.max())}
    if replay.smoothed is not None:
        cost |= {"smoothing_cpu_s": replay.smoothed.seconds}
    return cost
