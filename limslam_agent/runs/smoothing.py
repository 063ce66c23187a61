"""Scores of a smoothed path, and whether it can be trusted."""

import numpy as np

from limslam_agent.mapping.joining import NOT_YET_CONFIRMED
from limslam_agent.output.export import plain
from limslam_agent.runs.record import Episode
from limslam_agent.status.smoothed_status import lost_note, lost_since, smoothed_status
from limslam_agent.status.status import LEVELS, final_status_scores, worst
from limslam_env import metrics
from limslam_env.geometry import FloatArray


def final_status(episode: Episode) -> dict[str, str]:
    """The status of the smoothed path and map by the names in ``docs/metrics.md``; nothing if there are none."""
    online_statuses, smoothed = episode.snapshot.statuses, episode.smoothed
    if smoothed is None:
        return {}
    places = episode.places
    status = smoothed_status(
        smoothed.contradictions,
        episode.revised,
        (smoothed.poses, smoothed.covariances),
        while_driving=LEVELS[int(episode.levels.max())],
        lost_since=lost_since(episode.time, places.placed.stop),
    )
    if status.level == "ok" and NOT_YET_CONFIRMED in online_statuses:
        status = NOT_YET_CONFIRMED
    if status.level == "ok":
        status = places.doubt
    return final_status_scores(status, worst(online_statuses), lost_note(episode.time, episode.levels))


def smoothed_scores(episode: Episode, limit: float | None) -> dict[str, float | None]:
    """Metrics of the smoothed path, as means over the robots, and its ratio to the offline optimum's error (m)."""
    smoothed = episode.smoothed
    if smoothed is None:
        return {}
    each = [
        path_scores(*(rows[:, number] for rows in (episode.true, smoothed.poses, smoothed.covariances)))
        for number in range(episode.config.robots)
    ]
    scores = mean_scores(each)
    if episode.config.limit:
        ate = scores["ate_smoothed_m"]
        scores["smoothed_over_limit"] = ate / limit if ate is not None and limit else None
    return scores


def path_scores(true: FloatArray, smoothed: FloatArray, covariances: FloatArray | None) -> dict[str, float | None]:
    """Metrics of a smoothed path (n, 3) with covariances (n, 3, 3) against the truth (n, 3)."""
    errors = metrics.trajectory_metrics(true, smoothed)
    found: dict[str, float | None] = {
        "ate_smoothed_m": errors["ate_m"], "heading_smoothed_rmse_deg": errors["heading_rmse_deg"],
    }  # fmt: skip
    if covariances is not None:
        found["anees_smoothed"] = metrics.consistency_metrics(true, smoothed, covariances)["anees"]
    return plain(found)


def mean_scores(each: list[dict[str, float | None]]) -> dict[str, float | None]:
    """Means of several robots' scores. A mean is None if one robot has no value."""
    columns = {name: [scores[name] for scores in each] for name in each[0]}
    return {
        name: None
        if any(value is None for value in values)
        else float(np.mean([value for value in values if value is not None]))
        for name, values in columns.items()
    }
