"""Repeats a finished run from its own log, and records it for the inspector.

The observations of the log go through the same agent again. The agent is deterministic, so it
believes at each step what it believed in the run, which is checked against the trajectory in the
folder.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limslam_agent.config.presets import AgentConfig
from limslam_agent.inspect.columns import rounded
from limslam_agent.inspect.recorder import Recorder
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.output.finished_run import LOG, FinishedRun, FolderError
from limslam_agent.output.formats.content import read_readings
from limslam_agent.places.saved_map import SavedMap
from limslam_agent.runs.episode import policies_of, team_of, told_starts
from limslam_agent.runs.policies import FROM_OUTSIDE
from limslam_agent.runs.policy_file import is_file_policy
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.safe_files import read_limited
from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation, RobotSpec
from limslam_env.worlds.formats.loading import load_world

Progress = Callable[[int], None]
"""Called after each step with the number of steps that are done."""

SAME = 2e-6
"""Poses that differ by less than this, m and rad, are equal: the files of trajectories have six
digits.
"""

_LOOPS = "loops.json"
_GRAPH = "graph.json"


@dataclass(frozen=True, eq=False)
class Inspection:
    """A recording of a run: what the page holds, and the number of frames.

    ``difference`` is the largest one, m and rad, between the poses and those in the run's folder.
    None if there is no folder.
    """

    arrays: dict[str, NDArray[Any]]
    meta: dict[str, Any]
    frames: int
    difference: float | None


def inspect_run(config: RunConfig, run: FinishedRun, progress: Progress) -> Inspection:
    """Record a run in a simulated world from its folder."""
    readings = read_readings(run)
    if readings is None or not run.true:
        missing = LOG if readings is None else "trajectory_true.tum"
        raise FolderError(f"{run.folder}: there is no {missing}, so the run cannot be inspected")
    world = load_world(config.world)
    true = np.array(run.true).swapaxes(0, 1)
    # A tour or a driver cannot decide from the log alone, and the code in a file is not executed
    # again.
    is_repeated = not (config.policy in FROM_OUTSIDE or is_file_policy(config.policy))
    team = team_of(config, policies_of(config, world) if is_repeated else None)
    team.reset(told_starts(config, true[0]), config.seed)
    recorder = Recorder(team.mapper, len(run.time))
    for row, (ranges, wheels) in enumerate(zip(readings.ranges, readings.wheels, strict=True)):
        observed: list[Observation] = [
            {"ranges": seen, "wheels": moved} for seen, moved in zip(ranges, wheels, strict=True)
        ]
        if readings.yaw is not None:
            for observation, yaw in zip(observed, readings.yaw[row].tolist(), strict=True):
                observation["yaw"] = yaw
        team.observe(observed)
        if is_repeated:
            team.decide()
        recorder.note(
            run.time[row],
            _new(config.robot, ranges, row),
            team.policies if is_repeated else None,
            true[row],
        )
        progress(row + 1)
    team.finish()
    recorder.finish()
    if config.kidnap_at is not None:
        row = round(config.kidnap_at / config.robot.control_period)
        recorder.log.mark(
            min(row, len(run.time) - 1), "kidnap", "the robot is carried to another place"
        )
    return _inspection(recorder, team.mapper, run, world.edges)


def inspect_log(
    log: RecordedLog,
    config: AgentConfig,
    progress: Progress,
    run: FinishedRun | None = None,
    prior_map: SavedMap | None = None,
) -> Inspection:
    """Record the replay of a log, in the map of an earlier run where there is one.

    ``run`` is the folder of the replay, with what is known at its end. None for a log that was not
    replayed.
    """
    if run is not None and len(run.time) != len(log):
        raise FolderError(
            f"{run.folder}: has {len(run.time)} poses for the {len(log)} events of its log"
        )
    mapper = Mapper(log.robot, config, log.start_pose, prior_map=prior_map)
    mapper.longest_travel = float("inf")  # as in a replay
    recorder = Recorder(mapper, len(log))
    since = None if run is None else run.metrics.get("online_graph_from_s")
    handed_over = len(log)
    for row, observation in enumerate(log.observations()):
        mapper.step(observation)
        if since is not None and log.time[row] - log.time[0] >= since:
            handed_over = min(handed_over, row)
        seen = (
            log.ranges[row][None]
            if log.has_scan[row]
            else np.full((1, log.ranges.shape[1]), np.nan)
        )
        true = None if log.true_pose is None else log.true_pose[row][None]
        recorder.note(log.time[row], _new(log.robot, seen, row), true=true)
        progress(row + 1)
    mapper.finish()
    recorder.finish()
    if handed_over < len(log):
        recorder.log.mark(
            handed_over,
            "handover",
            "the filter is lost or doubtful, and the replay goes on with the online graph",
        )
    return _inspection(recorder, mapper, run, None, handed_over)


def _new(robot: RobotSpec, ranges: FloatArray, row: int) -> FloatArray:
    """The readings (n, b) of a step; NaN where a beam has measured nothing new."""
    return np.where(robot.measures(row), ranges, np.nan)


def _inspection(
    recorder: Recorder,
    mapper: Mapper,
    run: FinishedRun | None,
    edges: FloatArray | None,
    end: int | None = None,
) -> Inspection:
    """The inspection of a run whose folder has the poses of the filter before the row ``end``."""
    arrays = recorder.arrays()
    rows = np.array(recorder.frame_rows)
    meta = recorder.meta()
    if edges is not None:
        arrays["edges"] = edges.astype(np.float32)
    if run is None:
        return Inspection(arrays, {**meta, "check": ""}, len(rows), None)
    if run.smoothed:
        arrays["smoothed"] = np.array(run.smoothed).swapaxes(0, 1)[rows].astype(np.float32)
    arrays["final_walls"] = run.segments.astype(np.float32)
    start = float(run.time[0])
    meta["path_loops"] = _read(
        run.folder / _LOOPS, lambda told: [_loop(each, start) for each in told], []
    )
    meta["graph"] = _read(
        run.folder / _GRAPH, lambda told: _graph(told, start), {"key_poses": [], "local_maps": []}
    )
    difference = _difference(recorder, mapper, run, end)
    return Inspection(arrays, {**meta, "check": _words(difference)}, len(rows), difference)


def _difference(recorder: Recorder, mapper: Mapper, run: FinishedRun, end: int | None) -> float:
    """Largest difference between the poses of the recording and those in the folder, m and rad.

    The folder has the poses of a robot that had to find its place in an earlier map, or another
    robot, in the frame that was found later. They are compared from then on. From the row ``end``
    on, the folder has those of the online graph, which are not recorded.
    """
    rows = np.array(recorder.frame_rows)
    off = recorder.poses() - np.array(run.estimated).swapaxes(0, 1)[rows]
    off[..., 2] = (off[..., 2] + np.pi) % (2.0 * np.pi) - np.pi
    earlier = getattr(mapper, "earlier", None)
    since = len(earlier.poses) if earlier is not None else 0
    if mapper.prior_frame is not None:
        since = int(mapper.places.records[0]["step"])
    is_compared = (rows >= since) & (rows < (len(run.time) if end is None else end))
    return float(np.abs(off[is_compared]).max(initial=0.0))


def _words(difference: float) -> str:
    if difference <= SAME:
        return "The poses equal those in the folder of the run."
    return (
        f"The poses differ by up to {difference:.2g} (m, rad) from those in the folder: its "
        "version was another one."
    )


def _read(path: Path, found: Callable[[Any], Any], otherwise: Any) -> Any:
    """What a function finds in a JSON file of the smoother, or something else if there is no such
    file.
    """
    if not path.is_file():
        return otherwise
    try:
        return found(json.loads(read_limited(path)))
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise FolderError(f"{path}: is damaged: {error}") from error


def _graph(told: dict[str, Any], start: float) -> dict[str, Any]:
    """Times of key poses and of local maps, from the start, s."""
    return {
        name: rounded([time - start for time in told[key]], 3)
        for name, key in (("key_poses", "key_pose_times"), ("local_maps", "local_map_times"))
    }


def _loop(told: dict[str, Any], start: float) -> dict[str, Any]:
    return {
        "first": rounded(told["first_time"] - start, 3),
        "second": rounded(told["second_time"] - start, 3),
        "score": rounded(told["score"]),
        "reason": str(told["reason"]),
    }
