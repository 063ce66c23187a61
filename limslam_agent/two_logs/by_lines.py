"""Two logs of wheel travel as one run of the line smoother with two robots."""

from dataclasses import replace

import numpy as np

from limslam_agent.places.localisation import KnownPlaces
from limslam_agent.replay.record import Replay
from limslam_agent.slam.graph.smooth import Report
from limslam_agent.slam.line_graph.smoother import FilteredRun, beside, smooth_with_unknown_start
from limslam_agent.status.known_map import MATCH_COVARIANCE
from limslam_agent.status.status import LEVELS, smoothed_status
from limslam_agent.two_logs.joint import JointReplay, Replays, frame_of, grid_of
from limslam_agent.two_logs.place import place_in, sensor_of
from limslam_env.geometry import FloatArray, se2

_FURTHEST = 0.4, np.radians(10.0)
"""The smoothed start of the second log, and the path of each log, differ by at most this from the match, m and rad."""


def joined_by_lines(replays: Replays, frame: FloatArray, report: Report) -> JointReplay | str:
    """Smooth two logs as one run, with the frame of the second one at about a pose (3,); or why they do not fit.

    The joining is taken back if the result is not ``ok``, if the place or a path moves far, or if the second log also
    fits in the shared map at a second place.
    """
    settings = replays[0].config.run_smoothing
    assert settings is not None  # noqa: S101 (the caller has looked)
    report("both logs, all poses and walls")
    second = _run_of(replays[1])
    second = replace(second, covariances=second.covariances + MATCH_COVARIANCE)
    run = beside(_run_of(replays[0]), second, frame)
    smoothed = smooth_with_unknown_start(run, settings)
    if smoothed is None:
        return "the logs could not be smoothed together"
    one, other = (len(each.log) for each in replays)
    poses = smoothed.poses[:one, 0], smoothed.poses[:other, 1]
    shifts = np.hypot(*(smoothed.poses - run.poses)[..., :2].T)
    moved = max(float(np.sqrt((part**2).mean())) for part in (shifts[0, :one], shifts[1, :other]))
    off = se2.between(frame, frame_of(replays[1], poses[1]))
    if float(np.hypot(*off[:2])) > _FURTHEST[0] or abs(float(off[2])) > _FURTHEST[1]:
        return "the readings lead away from the matched place"
    if moved > _FURTHEST[0]:
        return f"smoothing both logs together moves the path of one of them by {moved:.2f} m"
    status = smoothed_status(
        smoothed.contradictions, (run.poses, run.covariances), (smoothed.poses, smoothed.covariances),
        while_driving=LEVELS[int(max(each.levels.max() for each in replays))],
    )  # fmt: skip
    if status.level != "ok":
        return status.reason
    grid = grid_of(replays, poses, smoothed.robot)
    again = place_in(KnownPlaces(smoothed.segments, grid, sensor_of(replays[0])), replays[1], poses[1])
    if again.refusal:
        return again.refusal
    doubts = (each.places.doubt for each in replays)
    return JointReplay(
        replays, poses, smoothed.landmarks, smoothed.segments, grid,
        next((doubt for doubt in doubts if doubt.reason), status), {},
        {"smoothed_contradictions": smoothed.contradictions},
    )  # fmt: skip


def _run_of(replay: Replay) -> FilteredRun:
    """The run that a log was smoothed from, with its smoothed poses."""
    smoothed = replay.smoothed
    assert smoothed is not None and isinstance(smoothed.basis, FilteredRun)  # noqa: PT018, S101 (the caller has looked)
    return replace(smoothed.basis, poses=smoothed.poses[: len(smoothed.basis.poses), None])
