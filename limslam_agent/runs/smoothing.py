"""The smoothed path of a recorded run: the estimate of every pose by all that was known at the run's end."""

from typing import TYPE_CHECKING

import numpy as np

from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.config.smoother import SmootherConfig
from limslam_env.geometry import FloatArray
from limslam_env.metrics import metrics

if TYPE_CHECKING:
    from limslam_agent.runs.episode import Episode
    from limslam_agent.slam.line_graph.smoother import SmoothedRun


def smooth_episode(episode: "Episode") -> "SmoothedRun | None":
    """Smooth a run. Only the associations of the consistent estimator are smoothed; other runs give None."""
    agent = episode.config.agent
    if not isinstance(agent.estimator, ConsistentConfig):
        return None
    # The kernels of the smoother load numba, which takes time that other commands do not need.
    from limslam_agent.slam.line_graph.smoother import FilteredRun, smooth_run

    run = FilteredRun(
        robot=episode.config.robot,
        noise=agent.noise,
        wheels=episode.wheels,
        ranges=episode.ranges,
        usable=~episode.dropped,
        poses=episode.estimated,
        covariances=episode.covariances,
        associations=episode.associations,
        closures=episode.closures,
    )
    return smooth_run(run, SmootherConfig(calibrate=agent.estimator.self_calibration.calibrate))


def smoothed_scores(episode: "Episode", limit: float | None) -> dict[str, float | None]:
    """Metrics of the smoothed path, as means over the robots, and its ratio to the offline optimum's error (m)."""
    smoothed = episode.smoothed
    if smoothed is None:
        return {}
    each = [
        _path_scores(*(rows[:, number] for rows in (episode.true, smoothed.poses, smoothed.covariances)))
        for number in range(episode.config.robots)
    ]
    names = ("ate_smoothed_m", "heading_smoothed_rmse_deg", "anees_smoothed")
    scores = {name: _mean([row[index] for row in each]) for index, name in enumerate(names)}
    if episode.config.limit:
        ate = scores["ate_smoothed_m"]
        scores["smoothed_over_limit"] = ate / limit if ate is not None and limit else None
    return scores


def _path_scores(true: FloatArray, smoothed: FloatArray, covariances: FloatArray) -> list[float | None]:
    errors = metrics.trajectory_metrics(true, smoothed)
    return [
        errors["ate_m"],
        errors["heading_rmse_deg"],
        metrics.consistency_metrics(true, smoothed, covariances)["anees"],
    ]


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None and np.isfinite(value)]
    return float(np.mean(known)) if len(known) == len(values) else None
