"""What is known at the end of a run: the smoothed path, and the map that is drawn from it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from limslam_agent.grid.occupancy import GridView, drawn_grid
from limslam_agent.mapping.joining import NOT_YET_CONFIRMED
from limslam_agent.output.export import finite
from limslam_agent.places.revisions import revised
from limslam_agent.readings import as_readings
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.status.smoothed_status import lost_note, lost_since, smoothed_status
from limslam_agent.status.status import LEVELS, final_status_scores, worst
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose, inverse
from limslam_env.metrics import metrics

if TYPE_CHECKING:
    from limslam_agent.runs.episode import Episode
    from limslam_agent.slam.line_graph.smoother import SmoothedRun


@dataclass(frozen=True, eq=False)
class FinalMap:
    """The map of a finished run, from which its files, its picture and its scores are made.

    Attributes
    ----------
    segments
        Walls (k, 4), m, cut at doors and holes.
    landmarks
        The lines that the walls lie on, with covariances.
    grid
        Occupancy grid.
    poses
        The poses (t, n, 3) that the map was drawn from, m and rad.
    """

    segments: FloatArray
    landmarks: list[Landmark]
    grid: GridView
    poses: FloatArray


def smooth_episode(episode: "Episode") -> "SmoothedRun | None":
    """Smooth a run. The result is None if the settings do not ask for it, or if there is nothing to smooth.

    Only the associations of the consistent estimator can be smoothed.
    """
    agent, settings = episode.config.agent, episode.config.agent.run_smoothing
    # The smoother does not know the lines of an earlier map.
    if settings is None or episode.in_prior_map or episode.placed_robots < episode.config.robots:
        return None
    # The kernels of the smoother load numba, which takes time that other commands do not need.
    from limslam_agent.slam.line_graph.smoother import FilteredRun, smooth_run

    places = episode.places
    poses, covariances = revised(episode.estimated, episode.covariances, places.revisions)
    usable, unknown_start = ~episode.dropped, tuple[tuple[int, int], ...]()
    if episode.joined is not None:
        # The second robot's start is not known: it may be anywhere before its first step.
        usable[0, 1], unknown_start = False, ((1, 1),)
    run = FilteredRun(
        robot=episode.config.robot,
        noise=agent.noise,
        wheels=episode.wheels,
        ranges=episode.ranges,
        usable=usable,
        poses=poses,
        covariances=covariances,
        associations=episode.associations,
        closures=episode.closures,
        breaks=(*((0, step) for step in places.breaks), *unknown_start),
        slips=tuple((0, *part) for part in places.slips),
        sensor=episode.sensor,
    )
    found = smooth_run(run, settings, places.placed.stop)
    if found is not None and unknown_start:
        # What the second robot's pose was before its first step follows from the one after it.
        motion = compose(inverse(poses[1, 1]), poses[0, 1])
        found.poses[0, 1], found.covariances[0, 1] = compose(found.poses[1, 1], motion), found.covariances[1, 1]
    return found


def online_map(episode: "Episode") -> FinalMap:
    """The map as the robots knew it when the run stopped."""
    known = episode.snapshot
    # While a robot was lost, its poses were in a frame of their own.
    poses, _ = revised(episode.estimated, episode.covariances, episode.places.revisions)
    return FinalMap(known.segments, known.landmarks, known.grid, poses)


def final_map(episode: "Episode") -> FinalMap:
    """The map by all that is known at the end: drawn from the smoothed poses, if the run was smoothed."""
    smoothed, config = episode.smoothed, episode.config
    if smoothed is None:
        return online_map(episode)
    ranges = as_readings(episode.ranges, config.robot.min_ranges, config.robot.max_ranges)
    is_new = np.array([config.robot.measures(step) for step in range(len(ranges))])[:, None]
    measured = is_new & ~np.isnan(ranges) & ~episode.dropped
    used = episode.placed_steps
    grid = drawn_grid(config.agent.grid, smoothed.robot, smoothed.poses[used], ranges[used], measured[used])
    return FinalMap(smoothed.segments, smoothed.landmarks, grid, smoothed.poses)


def final_status(episode: "Episode") -> dict[str, str]:
    """The status of the smoothed path and map by the names in ``docs/metrics.md``; nothing if there are none."""
    online_statuses, smoothed = episode.snapshot.statuses, episode.smoothed
    if smoothed is None:
        return {}
    places = episode.places
    status = smoothed_status(
        smoothed.contradictions,
        revised(episode.estimated, episode.covariances, places.revisions),
        (smoothed.poses, smoothed.covariances),
        while_driving=LEVELS[int(episode.levels.max())],
        lost_since=lost_since(episode.time, places.placed.stop),
    )
    if status.level == "ok" and NOT_YET_CONFIRMED in online_statuses:
        status = NOT_YET_CONFIRMED
    if status.level == "ok":
        status = places.doubt
    return final_status_scores(status, worst(online_statuses), lost_note(episode.time, episode.levels))


def smoothed_scores(episode: "Episode", limit: float | None) -> dict[str, float | None]:
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
    return finite(found)


def mean_scores(each: list[dict[str, float | None]]) -> dict[str, float | None]:
    """Means of several robots' scores. A mean is None if one robot has no value."""
    columns = {name: [scores[name] for scores in each] for name in each[0]}
    return {
        name: None
        if any(value is None for value in values)
        else float(np.mean([value for value in values if value is not None]))
        for name, values in columns.items()
    }
