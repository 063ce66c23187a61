"""Two logs of wheel travel as one run of the line smoother, in which the robot was carried away between the logs."""

from dataclasses import replace
from typing import Any

import numpy as np

from limslam_agent.places.localisation import KnownPlaces
from limslam_agent.replay.record import Replay
from limslam_agent.slam.graph.smooth import Report
from limslam_agent.slam.line_graph.smoother import FilteredRun, smooth_run
from limslam_agent.status.known_map import MATCH_COVARIANCE
from limslam_agent.status.smoothed_status import smoothed_status
from limslam_agent.status.status import LEVELS
from limslam_agent.two_logs.joint import JointReplay, Replays, frame_of, grid_of
from limslam_agent.two_logs.place import place_in, sensor_of
from limslam_env.geometry import BoolArray, FloatArray, se2

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
    run = joined_run(_run_of(replays[0]), _run_of(replays[1]), frame)
    smoothed = smooth_run(run, settings)
    if smoothed is None:
        return "the logs could not be smoothed together"
    seam = len(replays[0].log)
    poses = smoothed.poses[:seam, 0], smoothed.poses[seam:, 0]
    shifts = np.hypot(*(smoothed.poses - run.poses)[:, 0, :2].T)
    moved = max(float(np.sqrt((part**2).mean())) for part in (shifts[:seam], shifts[seam:]))
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


def joined_run(first: FilteredRun, second: FilteredRun, frame: FloatArray) -> FilteredRun:
    """Two runs of one robot, one after the other. Between them it was carried away.

    ``frame`` (3,) is the pose of the second run's frame in that of the first run.
    """
    seam = len(first.poses)
    second = replace(
        second,
        poses=se2.compose(frame, second.poses),
        covariances=se2.turned(second.covariances, float(frame[2])) + MATCH_COVARIANCE,
    )
    apart = 1 + max((record.landmark for record in first.associations), default=-1)
    associations = [
        replace(each, landmark=each.landmark + apart, readings=each.readings + np.array([seam, 0]))
        for each in second.associations
    ]
    closures = [
        replace(each, older=each.older + apart, younger=each.younger + apart, step=each.step + seam)
        for each in second.closures
    ]
    columns: dict[str, Any] = {
        name: np.concatenate((getattr(first, name), getattr(second, name)))
        for name in ("wheels", "ranges", "poses", "covariances")
    }
    longer = max((first, second), key=lambda each: len(each.poses))  # its readings say more about the sensor
    return FilteredRun(
        # Which readings of slow sensors are new is known by the steps of each run.
        robot=replace(first.robot, beams=tuple(replace(beam, period=1) for beam in first.robot.beams)),
        noise=first.noise,
        usable=np.concatenate((_new_readings(first), _new_readings(second))),
        associations=[*first.associations, *associations],
        closures=[*first.closures, *closures],
        breaks=(*first.breaks, (0, seam), *((0, step + seam) for _, step in second.breaks)),
        slips=(*first.slips, *((0, begin + seam, end + seam) for _, begin, end in second.slips)),
        sensor=longer.sensor,
        **columns,
    )


def _new_readings(run: FilteredRun) -> BoolArray:
    """Mask (t, 1, n_beams) of the readings of a run that may be used and that a slow sensor does not repeat."""
    is_new = np.array([run.robot.measures(run.first_step + row) for row in range(len(run.poses))])
    return np.asarray(run.usable & is_new[:, None])
