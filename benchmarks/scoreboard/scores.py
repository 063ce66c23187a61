"""Figures of a cell of the scoreboard, of the truth and of what the estimator says."""

from typing import Any

import numpy as np

from limslam_agent.output.export import plain
from limslam_agent.runs.results import over_robots
from limslam_agent.status.chance import TURNED
from limslam_agent.status.status import LEVELS
from limslam_env import metrics
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import transform_points, wrap_angle
from limslam_env.geometry.segment import distances
from limslam_env.interface import RobotSpec
from limslam_env.worlds.world import World

Scores = dict[str, Any]

WRONG = 0.5
"""A pose is wrong if it is farther off, m. While the status is ok, this is never right."""
WRONG_PATH = 0.6
"""A smoothed path is wrong if the root mean square of its aligned position errors is larger, m."""
RIGHT = 0.2
"""An alarm is false while the pose is not farther off, m."""


def faces(world: World, robot: RobotSpec, segments: FloatArray, alignment: FloatArray) -> Scores:
    """The share of the visible sides of obstacles, however short, that aligned segments (k, 4) are
    within 5 cm of.
    """
    points, _, owner = metrics.visible_samples(world, robot.radius, robot.reach, shortest=0.0)
    points = points[owner >= len(world.walls)]
    moved = transform_points(alignment, segments.reshape(-1, 2))
    if not len(points):
        return {}
    away = distances(points, moved.reshape(-1, 4)).min(axis=1, initial=np.inf)
    return {"faces_5cm": float(np.mean(away <= metrics.NEARER))}


def path_scores(
    true: FloatArray, poses: FloatArray, covariances: FloatArray | None, suffix: str
) -> Scores:
    """Errors of paths (t, n, 3) of n robots with covariances (t, n, 3, 3), as means over the
    robots.
    """

    def of_one(*columns: FloatArray) -> dict[str, float | None]:
        errors = metrics.trajectory_metrics(*columns[:2])
        found = {
            f"ate{suffix}_m": errors["ate_m"],
            f"ate{suffix}_aligned_m": errors["ate_aligned_m"],
            f"ate{suffix}_scaled_m": scaled_error(*columns[:2]),
        }
        nees = (
            {f"nees{suffix}": metrics.consistency_metrics(*columns)["anees"]}
            if len(columns) == 3
            else {}
        )
        return plain({**found, **nees})

    return over_robots(of_one, true, poses, *(() if covariances is None else (covariances,)))


def scaled_error(true: FloatArray, estimated: FloatArray) -> float:
    """The root mean square of the position errors of poses (n, 3), m, after alignment by a rigid
    motion and one scale.
    """
    alignment = metrics.rigid_alignment(true[:, :2], estimated[:, :2])
    target = true[:, :2] - true[:, :2].mean(axis=0)
    source = transform_points(alignment, estimated[:, :2])
    source -= source.mean(axis=0)
    spread = float((source**2).sum())
    scale = float((source * target).sum()) / spread if spread else 1.0
    return float(np.sqrt(((target - scale * source) ** 2).sum(axis=1).mean()))


def while_driving(
    time_s: FloatArray, true: FloatArray, estimated: FloatArray, levels: IntArray
) -> Scores:
    """How long poses (t, n, 3) were wrong although the status (t, n) was ok, and right although it
    was not, and how long it was ok, and off all the same: wrong, or turned too far, s.

    The times of several robots are added. Also the longest time that one was wrong without a break
    and the status ok.
    """
    errors = np.hypot(*(estimated - true)[..., :2].transpose(2, 0, 1))
    is_off = (errors > WRONG) | (np.abs(wrap_angle((estimated - true)[..., 2])) > TURNED)
    lasts = np.append(np.diff(time_s), 0.0)[:, None]
    is_ok = levels == LEVELS.index("ok")
    is_wrong = is_ok & (errors > WRONG)
    return {
        "wrong_ok_s": float((lasts * is_wrong).sum()),
        "longest_wrong_ok_s": max(_longest(lasts[:, 0], one) for one in is_wrong.T),
        "false_alarm_s": float((lasts * (~is_ok & (errors < RIGHT))).sum()),
        "ok_s": float((lasts * is_ok).sum()),
        "off_ok_s": float((lasts * (is_ok & is_off)).sum()),
    }


def _longest(lasts: FloatArray, holds: BoolArray) -> float:
    """The longest time for which something holds (t,) without a break, of steps that last (t,)."""
    total = np.append(0.0, np.cumsum(lasts))
    begins, ends = np.flatnonzero(np.diff(holds, prepend=0, append=0)).reshape(-1, 2).T
    return float((total[ends] - total[begins]).max(initial=0.0))


def at_the_end(level: str, true: FloatArray, poses: FloatArray) -> Scores:
    """The final status, and whether it is ok although a path (t, n, 3) is wrong."""
    errors = [
        metrics.trajectory_metrics(true[:, one], poses[:, one])["ate_aligned_m"]
        for one in range(true.shape[1])
    ]
    return {
        "status": level,
        "wrong_ok_end": int(level == "ok" and max(each or 0.0 for each in errors) > WRONG_PATH),
    }
