"""Maps from a recorded log, scores the result, and writes it to a folder."""

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.occupancy import GridView
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.logs.relations import Relations, relation_errors, summary
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.output.cost import run_cost
from limslam_agent.output.export import map_content, write_covariances, write_json, write_map
from limslam_agent.output.finished_run import COVARIANCES, UNPLACED
from limslam_agent.output.summary import place_records, record_of, turn_records
from limslam_agent.output.tum import write_tum
from limslam_agent.places.revisions import PlaceHistory
from limslam_agent.places.saved_map import SavedMap
from limslam_agent.replay.filter_estimate import FilterEstimate
from limslam_agent.slam.core.diagnostics import AssociationRecord, Closure
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.motion import OdometryCalibration
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.smoothed_status import lost_note
from limslam_agent.status.status import LEVELS, Status, final_status_scores, status_scores
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.se2 import compose

if TYPE_CHECKING:
    from limslam_agent.replay.smoothing import Smoothed


@dataclass(frozen=True, eq=False)
class SelfCalibration:
    """The systematic errors of the odometry that the filter has estimated during a replay.

    Attributes
    ----------
    factors, covariance
        Errors of wheels and axle, and their covariance (3, 3).
    axle
        Axle of the robot's description, m.
    """

    factors: OdometryCalibration
    covariance: FloatArray
    axle: float

    @property
    def figures(self) -> dict[str, float]:
        """Values for ``result.json``: missing turn per metre, size of the wheels and of the axle, with standard
        deviations.
        """
        turn, size = np.array([-1.0, 1.0, 0.0]) / self.axle, np.array([0.5, 0.5, 0.0])
        values = np.array(self.factors)
        return {
            "self_calibration_turn_deg_per_m": math.degrees(turn @ values),
            "self_calibration_turn_std_deg_per_m": math.degrees(math.sqrt(turn @ self.covariance @ turn)),
            "self_calibration_scale": 1.0 + float(size @ values),
            "self_calibration_scale_std": math.sqrt(size @ self.covariance @ size),
            "self_calibration_axle": 1.0 + self.factors.axle,
            "self_calibration_axle_std": math.sqrt(self.covariance[2, 2]),
        }

    @property
    def words(self) -> str:
        """One line for the screen."""
        figures = self.figures
        turn, scale = (
            (figures[f"self_calibration_{name}"], figures[f"self_calibration_{std}"])
            for name, std in (("turn_deg_per_m", "turn_std_deg_per_m"), ("scale", "scale_std"))
        )
        return f"{turn[0]:.3f} +- {turn[1]:.3f} deg/m, scale {scale[0]:.4f} +- {scale[1]:.4f}, by the filter itself"


@dataclass(frozen=True, eq=False)
class Replay:
    """The result of a replay, with a pose for every event of the log.

    Attributes
    ----------
    log
        The log that was replayed.
    config
        Settings.
    estimated, odometry
        Poses (n, 3): the estimate, and odometry alone, corrected for its known bias.
    covariances
        Covariances of the estimated poses (n, 3, 3).
    levels, status
        Status of the estimate at each event (n,), as an index into ``status.LEVELS``, and at the end of the log.
    landmarks, segments, grid
        The map.
    refused_readings
        Number of readings that were skipped: no readings (NaN), and negative numbers.
    self_calibration
        Systematic odometry errors that the filter has estimated. None if this was not asked for.
    beam_turns
        By what each beam is turned to the left, and its standard deviation (n_beams, 2), rad; None if no beam is.
    slam_ms, job_ms, wall_clock
        Cost of the SLAM for each event (n,), and of the jobs of the online graph beside it (n,), ms; and cost of the
        whole replay, s.
    places
        What happened when the robot was lost.
    sensor
        How the sensor measures, as the filter has found out; None if it estimates nothing of the kind.
    smoothed
        What is known at the end of the log. None if the settings do not smooth it.
    handed_over
        The event from which on the online graph gives the estimate, since the filter is lost. None if there is none.
    """

    log: RecordedLog
    config: AgentConfig
    estimated: FloatArray
    odometry: FloatArray
    covariances: FloatArray
    levels: IntArray
    status: Status
    landmarks: list[Landmark]
    segments: FloatArray
    grid: GridView
    refused_readings: int
    self_calibration: SelfCalibration | None
    slam_ms: FloatArray
    job_ms: FloatArray
    wall_clock: float
    places: PlaceHistory
    smoothed: "Smoothed | None" = None
    handed_over: int | None = None
    beam_turns: FloatArray | None = None
    sensor: RangeSensor | None = None


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
        Called at the start of each stage of the smoothing with the stage in words. Smoothing can take minutes.
    prior_map
        The map of an earlier run, in which the log begins at an unknown place. Only for logs of wheel travel.
    """
    report = report or (lambda _: None)
    mapper = Mapper(log.robot, config, log.start_pose, prior_map=prior_map)
    mapper.longest_travel = math.inf  # a log may have gaps; its reader knows the times
    estimate = _estimate(mapper, log, config)
    begin = time.perf_counter()
    rows = _estimated_rows(log, estimate, progress or (lambda _: None))
    mapper.finish()
    if mapper.prior_frame is not None:
        own = slice(mapper.places.records[0]["step"])
        for name in ("estimated", "odometry"):
            rows[name][own] = compose(mapper.prior_frame, rows[name][own])
    slam = mapper.slam
    replay = Replay(
        log=log,
        config=config,
        **rows,
        status=estimate.status,
        landmarks=slam.landmarks,
        segments=slam.segments,
        grid=mapper.grid,
        refused_readings=estimate.refused_readings,
        self_calibration=slam.odometry_calibration and SelfCalibration(*slam.odometry_calibration, log.robot.axle),
        wall_clock=time.perf_counter() - begin,
        places=estimate.places,
        handed_over=estimate.handed_over,
        beam_turns=slam.beam_turns,
        sensor=slam.sensor,
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
    log, config = replay.log, replay.config
    if log.odometry is not None and config.smoothing is not None:
        from limslam_agent.replay.smoothing import smoothed_by_graph

        return smoothed_by_graph(replay, config.smoothing, report)
    if log.wheels is not None and config.run_smoothing is not None and by_lines:
        from limslam_agent.replay.smoothing import smoothed_by_lines

        report("all poses and walls")
        return smoothed_by_lines(replay, *filtered, config.run_smoothing)
    return replay


def _estimated_rows(log: RecordedLog, estimate: FilterEstimate, progress: Callable[[int], None]) -> dict[str, Any]:
    """What is estimated after each event of a log, by the names of the arrays in :class:`Replay`."""
    count = len(log)
    rows: dict[str, Any] = {
        "estimated": np.empty((count, 3)), "odometry": np.empty((count, 3)), "covariances": np.empty((count, 3, 3)),
        "levels": np.empty(count, dtype=np.int64), "slam_ms": np.empty(count), "job_ms": np.empty(count),
    }  # fmt: skip
    for number, observation in enumerate(log.observations()):
        estimate.step(observation)
        rows["estimated"][number], rows["covariances"][number] = estimate.pose, estimate.covariance
        rows["odometry"][number], rows["levels"][number] = estimate.odometry, LEVELS.index(estimate.status.level)
        rows["slam_ms"][number], rows["job_ms"][number] = estimate.slam_ms, estimate.job_ms
        progress(number + 1)
    return rows


def _estimate(mapper: Mapper, log: RecordedLog, config: AgentConfig) -> FilterEstimate:
    """What gives the estimate while a log is replayed. Importing the graph takes long."""
    if log.odometry is None or config.smoothing is None:
        return FilterEstimate(mapper)
    from limslam_agent.replay.hand_over import HandedOverEstimate

    return HandedOverEstimate(mapper, log, config.smoothing)


def relation_scores(replay: Replay, relations: Relations) -> dict[str, Any]:
    """Errors of relative poses against known ones: of the estimate, of corrected odometry, and of odometry as
    recorded.
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
    time, event = replay.log.time, replay.handed_over
    return {} if event is None else {"online_graph_from_s": float(time[event] - time[0])}


def write_replay(
    folder: Path, replay: Replay, source: dict[str, str | None], scores: dict[str, Any], versions: dict[str, str]
) -> dict[str, Any]:
    """Write trajectory, map, picture and result of a replay into a folder. Returns the content of ``result.json``.

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
    versions
        Versions of the libraries.
    """
    log, smoothed = replay.log, replay.smoothed
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
    _draw_picture(folder, replay, f"{source['log']}, {len(log.robot.beams)} beams, {replay.config.preset}", drawn)
    calibration = replay.self_calibration.figures if replay.self_calibration else {}
    counts = {"landmarks": len(replay.segments), "refused_readings": replay.refused_readings}
    record = record_of(log.time, [replay.odometry if log.true_pose is None else log.true_pose], [replay.odometry])
    result = {
        "metrics": {**scores, **calibration, **statuses, **_hand_over(replay), **counts, **figures},
        "cost": _cost(replay),
        "config": {**source, "robot": asdict(log.robot), "agent": asdict(replay.config)},
        "record": {
            **record,
            "sensor": replay.sensor and replay.sensor.found(_specified(replay), log.robot.control_period),
            "beam_turns": turn_records(replay.beam_turns),
            "places": place_records(log.time, replay.places.records),
        },
        "versions": versions,
        "seed": None,
    }
    write_json(folder / "result.json", result)
    return result


def _specified(replay: Replay) -> RangeSensor:
    return RangeSensor(replay.config.range_std, cone=replay.log.robot.cone)


def _write_trajectories(folder: Path, replay: Replay) -> None:
    """Write the paths of a replay with their covariances, and the true path if it is known."""
    time, smoothed = replay.log.time, replay.smoothed
    write_tum(folder / "trajectory_est.tum", time, replay.estimated)
    write_tum(folder / "trajectory_odometry.tum", time, replay.odometry)
    if smoothed is not None:
        write_tum(folder / "trajectory_smoothed.tum", time, smoothed.poses)
    if replay.log.true_pose is not None:
        write_tum(folder / "trajectory_true.tum", time, replay.log.true_pose)
    of_smoothed = None if smoothed is None or smoothed.covariances is None else smoothed.covariances[:, None]
    write_covariances(folder / COVARIANCES, replay.covariances[:, None], of_smoothed)


def _status_scores(replay: Replay) -> dict[str, Any]:
    """The status while driving and at the end, for ``result.json``."""
    time, levels, smoothed = replay.log.time, replay.levels[:, None], replay.smoothed
    scores = status_scores(time, levels, replay.status)
    if smoothed is not None and smoothed.status is not None:
        scores |= final_status_scores(smoothed.status, replay.status, lost_note(time, levels))
    return scores


def _draw_picture(folder: Path, replay: Replay, title: str, status: Status) -> None:
    """Draw the map with the best path, and with the path that was estimated online if that is another one."""
    from limslam_agent.output.drawing import MapPicture, draw_map

    true, smoothed = replay.log.true_pose, replay.smoothed
    path = replay.estimated if smoothed is None else smoothed.poses
    picture = MapPicture(
        title, replay.segments, [path[:, :2]], [replay.odometry[:, :2]], true=[] if true is None else [true[:, :2]],
        grid=replay.grid, online=[] if smoothed is None else [replay.estimated[:, :2]], remark=status.remark,
    )  # fmt: skip
    draw_map(folder / "map.png", picture)


def _cost(replay: Replay) -> dict[str, Any]:
    """Time and memory that a replay took, for ``result.json``."""
    cost = run_cost(float(np.ptp(replay.log.time)), replay.wall_clock, slam=replay.slam_ms)
    if replay.job_ms.any():
        cost |= {"jobs": int((replay.job_ms > 0.0).sum()), "job_ms_max": float(replay.job_ms.max())}
    if replay.smoothed is not None:
        cost |= {"smoothing_cpu_s": replay.smoothed.seconds}
    return cost
