"""A replayed log smoothed after its end, and the map drawn from the smoothed poses.

A log of odometry poses is smoothed by the graph of local maps, a log of wheel travel by the line
smoother.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice, pairwise
from typing import Any

import numpy as np

from limslam_agent.config.graph import GraphConfig, WallLineConfig
from limslam_agent.config.smoother import SmootherConfig
from limslam_agent.grid.occupancy import GridView, OccupancyGrid
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.places.revisions import revised
from limslam_agent.replay.record import Replay, Smoothed
from limslam_agent.replay.trust import PathSignals, path_signals
from limslam_agent.slam.core.diagnostics import AssociationRecord, Closure
from limslam_agent.slam.core.line_fit import fit_line
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.line_graph.run import FilteredRun, SmoothedRun
from limslam_agent.slam.line_graph.smoother import smooth_run
from limslam_agent.slam.map_graph.key_poses import LogData
from limslam_agent.slam.map_graph.loops import KEPT
from limslam_agent.slam.map_graph.point_links import PointCloud, point_cloud
from limslam_agent.slam.map_graph.reversing import reversed_distance, with_reversing
from limslam_agent.slam.map_graph.stages import GraphResult, Report, by_odometry, rounds
from limslam_agent.slam.map_graph.wall_lines import lines_in
from limslam_agent.status.status import lost_since, smoothed_status
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import distance
from limslam_env.interface import RobotSpec

# The finished map is searched as one window, so it needs finer bins, and more lines, than a few
# metres of driving.
_DRAWN_LINES = WallLineConfig(
    tolerance=0.12, angle_bin=math.radians(1.0), min_points=8, min_length=0.4, max_gap=0.6
)


_MORE_ROUNDS = 2  # of a doubtful path


def smoothed_by_graph(
    replay: Replay, config: GraphConfig, report: Report = lambda _: None
) -> Replay:
    """The replay of a log of odometry poses with its log smoothed, and with the map drawn from the
    smoothed poses.

    ``report`` is called with each stage of the smoothing, in words.
    """
    log = replay.log
    begin = time.process_time()
    recorded = log_data(log, replay.odometry, replay.config.range_std)
    data = with_reversing(recorded, config)
    found, signals = trusted_path(data, log.start_pose, config, report)
    landmarks = draw_walls(point_cloud(found.keys, found.trajectory), data.range_std)
    metres, places = reversed_distance(recorded, data)
    smoothed = Smoothed(
        found.poses,
        {
            **_figures(found),
            "smoothed_reversed_m": metres,
            "smoothed_reversed_places": places,
            **signals.figures,
        },
        time.process_time() - begin,
        found,
        data=data,
        tables={"loops.json": loop_records(found, log.time), "graph.json": _times(found, log.time)},
    )
    # The graph takes the sensor to be as specified, whatever the filter has found.
    return replace(
        replay,
        landmarks=landmarks,
        segments=ends_of(landmarks),
        grid=draw_grid([replay], [found.poses]),
        smoothed=smoothed,
        beam_turns=None,
        sensor=None,
    )


def trusted_path(
    data: LogData, start: FloatArray, config: GraphConfig, report: Report = lambda _: None
) -> tuple[GraphResult, PathSignals]:
    """The smoothed log with its signals.

    As long as it is doubtful, there are more rounds, and the path is taken that is off least
    likely, which may be that of odometry.
    """
    since = data.time - data.time[0]
    found = []
    for path in islice(rounds(data, start, config, report), 1 + _MORE_ROUNDS):
        found.append((path, path_signals(path, since)))
        if found[-1][1].status.level == "ok":
            return found[-1]
    path, covariance = by_odometry(found[0][0], start)
    found.append((path, replace(path_signals(path, since), covariance=covariance)))
    return min(found, key=lambda each: (round(each[1].status.chance, 2), each[1].position_std))


def ends_of(landmarks: list[Landmark]) -> FloatArray:
    """Ends (k, 4) of the walls, m."""
    return np.array([mark.ends.ravel() for mark in landmarks]).reshape(-1, 4)


def log_data(log: RecordedLog, odometry: FloatArray, range_std: float) -> LogData:
    """What the graph needs of a log, with ``odometry`` (n, 3) in the frame of the estimate."""
    robot = log.robot
    ranges = log.ranges.astype(np.float64)
    hit = log.has_scan[:, None] & (ranges > robot.too_near) & (ranges < robot.too_far)
    reach = float(robot.max_ranges.max())
    return LogData(
        log.time,
        odometry,
        ranges,
        hit,
        robot.beam_origins,
        robot.beam_angles,
        reach,
        range_std,
        np.array([each.row for each in log.breaks], dtype=np.int64),
        np.array([each.stds for each in log.breaks]).reshape(-1, 3),
    )


def draw_walls(cloud: PointCloud, range_std: float) -> list[Landmark]:
    """Walls through the final points: Hough lines, fitted by least squares, and cut where there are
    gaps.
    """
    spans = np.array([[0, len(cloud.places)]])
    lines = lines_in(cloud.places, cloud.normals, cloud.good, spans, _DRAWN_LINES)
    borders = np.searchsorted(lines.lines, np.arange(len(lines.angles) + 1))
    landmarks = []
    for number, (low, high) in enumerate(pairwise(borders)):
        places = cloud.places[lines.points[low:high]]
        fit = fit_line(places, 1.0)
        std = max(range_std, float(np.std(distance(fit.line, places))))
        r, theta = fit.line.tolist()
        covariance = std**2 * fit.covariance
        landmarks.append(Landmark(r, theta, covariance, fit.ends, len(places), number))
    return landmarks


def smoothed_by_lines(
    replay: Replay,
    associations: list[AssociationRecord],
    closures: list[Closure],
    config: SmootherConfig,
) -> Replay:
    """The replay of a log of wheel travel with its log smoothed, and with the map drawn from the
    smoothed poses.

    Parameters
    ----------
    replay
        The log as the filter saw it.
    associations, closures
        The filter's associations and merged landmarks, in order.

    Returns
    -------
    Replay
        The replay as it was if there is nothing to smooth.
    """
    log = replay.log
    begin = time.process_time()
    places = replay.places
    placed = replay.places.placed.stop
    poses, covariances = revised(
        replay.estimated[:, None], replay.covariances[:, None], places.revisions
    )
    assert log.wheels is not None  # noqa: S101 (the caller chooses the smoother by it)
    run = FilteredRun(
        robot=log.robot,
        noise=replay.config.noise,
        wheels=log.wheels[:, None],
        ranges=log.ranges[:, None].astype(np.float64),
        usable=np.broadcast_to(log.has_scan[:, None, None], (len(log), 1, log.ranges.shape[1])),
        poses=poses,
        covariances=covariances,
        associations=associations,
        closures=closures,
        breaks=tuple((0, step) for step in places.breaks),
        slips=tuple((0, *part) for part in places.slips),
        sensor=replay.sensor,
        yaw=None if log.yaw is None else log.yaw[:, None],
        wheel_variances=None if log.wheel_variances is None else log.wheel_variances[:, None],
    )
    found = smooth_run(run, config, placed)
    if found is None:
        return replay
    status = smoothed_status(
        found.contradictions, found.covariances, lost_since=lost_since(log.time, placed)
    )
    if status.level == "ok":
        status = places.doubt
    smoothed = Smoothed(
        found.poses[:, 0],
        _line_figures(found, has_heading=run.headings is not None),
        time.process_time() - begin,
        run.synchronous.until(placed),
        covariances=found.covariances[:, 0],
        status=status,
    )
    return replace(
        replay,
        landmarks=found.landmarks,
        segments=found.segments,
        grid=draw_grid([replay], [found.read_at[:placed, 0]], found.robot, found.ranges),
        smoothed=smoothed,
    )


def draw_grid(
    replays: Sequence[Replay],
    paths: Sequence[FloatArray],
    robot: RobotSpec | None = None,
    corrected: FloatArray | None = None,
) -> GridView:
    """The occupancy grid of the first readings of logs from their poses (n, 3), by their robot or
    by one like it.

    The readings (t, k, n_beams), m, of the k logs may have been ``corrected``.
    """
    grid = OccupancyGrid(replays[0].config.grid)
    for number, (replay, poses) in enumerate(zip(replays, paths, strict=True)):
        log = replay.log
        rows = np.flatnonzero(log.has_scan[: len(poses)])
        readings = log.ranges if corrected is None else corrected[:, number]
        ranges = readings[rows, None].astype(np.float64)
        measured = np.isfinite(ranges)
        if replay.sensor is not None:
            measured[..., list(replay.sensor.broken)] = False
        grid.draw(robot or log.robot, poses[rows, None], ranges, measured)
    return grid.view


def _line_figures(found: SmoothedRun, *, has_heading: bool) -> dict[str, Any]:
    known = found.calibration
    one, two, three, bias, scale = [0.0] * 5 if known is None else known[0].tolist()
    if has_heading:
        figures = {
            "smoothed_wheels": 1.0 + one,
            "smoothed_yaw_scale": 1.0 + two,
            "smoothed_yaw_drift_deg_per_s": math.degrees(three),
        }
    else:
        figures = {
            "smoothed_left_wheel": 1.0 + one,
            "smoothed_right_wheel": 1.0 + two,
            "smoothed_axle": 1.0 + three,
        }
    return {
        **figures,
        "smoothed_range_bias_m": bias,
        "smoothed_range_scale": 1.0 + scale,
    }


def _figures(found: GraphResult) -> dict[str, Any]:
    reasons = [loop.reason for loop in found.loops]
    turn, scale, gain, delay, direction = found.errors.tolist()
    return {
        "smoothed_kind": found.kind,
        "smoothed_turn_deg_per_m": math.degrees(turn),
        "smoothed_scale": 1.0 + scale,
        "smoothed_turn_gain": 1.0 + gain,
        "smoothed_delay_s": delay,
        "smoothed_direction_deg": math.degrees(direction),
        "loops_found": len(reasons),
        "loops_kept": reasons.count(KEPT),
        "loops_by_reason": {reason: reasons.count(reason) for reason in sorted(set(reasons))},
    }


def _times(found: GraphResult, time: FloatArray) -> dict[str, list[float]]:
    """Times of the key poses and of the middles of the local maps, s."""
    keys = time[found.keys.first_event]
    return {
        "key_pose_times": keys.tolist(),
        "local_map_times": keys[found.chunk_keys].tolist(),
    }


def loop_records(found: GraphResult, time: FloatArray) -> list[dict[str, Any]]:
    """All loops for ``loops.json``, with the times (n,) of all events, s."""
    times = time[found.keys.first_event[found.chunk_keys]]
    return [
        {
            "first_time": float(times[loop.first]),
            "second_time": float(times[loop.second]),
            "relative": [round(float(value), 6) for value in loop.relative],
            "score": round(loop.score, 4),
            "reason": loop.reason,
        }
        for loop in found.loops
    ]
