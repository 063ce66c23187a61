"""Two logs of one building, whose relative start is not known: each is replayed by itself, and then both are joined."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.occupancy import GridView
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.places.revisions import Unplaced
from limslam_agent.replay.joined_lines import NotJoined, grid_of, joined_by_lines
from limslam_agent.replay.replay import Replay, replay_log
from limslam_agent.replay.smoothing import draw_walls, ends_of, loop_records
from limslam_agent.replay.trust import path_signals
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.graph.point_links import point_cloud
from limslam_agent.slam.graph.smooth import GraphResult, Report, saying
from limslam_agent.slam.merging.chains import Chain, poses_of_both
from limslam_agent.slam.merging.merge import merge
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray, se2

NOT_JOINED = "the logs were not joined"
"""The beginning of the reason of the status of two logs that were not joined."""


@dataclass(frozen=True, eq=False)
class JointReplay:
    """The result of two logs.

    Attributes
    ----------
    replays
        Each log by itself.
    record
        The joining, or why the logs were not joined.
    poses
        Smoothed poses (n, 3) and (m, 3) of all events: in the frame of the first log, or each in its own frame.
    frame
        Pose (3,) of the second log's own frame in the frame of the first log; zero if it is unknown.
    landmarks, segments, grid
        The map; that of the first log if the logs were not joined.
    status
        Whether map and paths can be trusted.
    figures
        For ``result.json``.
    loops
        For ``loops.json``. None without the graph of local maps.
    seconds
        CPU time of the joining, s.
    """

    replays: tuple[Replay, Replay]
    record: dict[str, Any]
    poses: tuple[FloatArray, FloatArray]
    frame: FloatArray
    landmarks: list[Landmark]
    segments: FloatArray
    grid: GridView
    status: Status
    figures: dict[str, Any] = field(default_factory=dict)
    loops: list[dict[str, Any]] | None = None
    seconds: float = 0.0

    @property
    def is_joined(self) -> bool:
        """Whether both logs have one map, in the frame of the first log."""
        return bool(self.record["event"] == "joined")

    @property
    def unplaced(self) -> Unplaced | None:
        """The map of the second log in its own frame, if the logs were not joined."""
        if self.is_joined:
            return None
        other = self.replays[1]
        return Unplaced(0, other.segments, other.landmarks, other.grid)

    def online(self) -> tuple[FloatArray, FloatArray]:
        """Poses of all events as they were believed while driving, (n, 3) and (m, 3), in the frames of ``poses``."""
        return self.replays[0].estimated, se2.compose(self.frame, self.replays[1].estimated)

    def odometry(self) -> tuple[FloatArray, FloatArray]:
        """Poses of all events by odometry alone, (n, 3) and (m, 3), in the frames of ``poses``."""
        return self.replays[0].odometry, se2.compose(self.frame, self.replays[1].odometry)


def check_logs(logs: Sequence[RecordedLog], config: AgentConfig) -> None:
    """Refuse logs that cannot be joined.

    Raises
    ------
    ValueError
        If there are not two of them, they hold different kinds of odometry, or the settings do not smooth logs.
    """
    if len(logs) != 2:
        raise ValueError(f"{len(logs)} logs: one log is replayed, or two logs are joined")
    first, second = logs
    if (first.wheels is None) != (second.wheels is None):
        raise ValueError("one log has wheel travel and the other one odometry poses: both logs must have the same")
    if first.wheels is not None and first.robot != second.robot:
        raise ValueError("logs of wheel travel can be joined only if the same robot recorded both")
    if (config.smoothing if first.wheels is None else config.run_smoothing) is None:
        raise ValueError("two logs are joined by what is known at their end: this needs the preset graph")


def replay_logs(
    logs: Sequence[RecordedLog],
    config: AgentConfig,
    progress: Callable[[int], None] | None = None,
    report: Report = lambda _: None,
) -> JointReplay:
    """Map from each of two logs by itself, and join the maps if they fit together at one place only.

    Parameters
    ----------
    logs
        Two logs, of one robot or two robots.
    config
        Settings; those of the preset ``graph``.
    progress
        Called after each event with the number of events of both logs that are done.
    report
        Called at the start of each stage of the smoothing with the stage in words.

    Raises
    ------
    ValueError
        If the logs cannot be joined.
    """
    check_logs(logs, config)
    first = replay_log(logs[0], config, progress, saying("log 1", report))
    after = None if progress is None else lambda done: progress(len(logs[0]) + done)
    second = replay_log(logs[1], config, after, saying("log 2", report))
    begin = time.process_time()
    joint = joined((first, second), report)
    return replace(joint, seconds=time.process_time() - begin)


def joined(both: tuple[Replay, Replay], report: Report) -> JointReplay:
    """Join two replayed logs if their maps fit together at one place only."""
    if any(each.smoothed is None or each.smoothed.basis is None for each in both):
        return _apart(both, {"event": "not joined", "reason": "one of the logs could not be smoothed"})
    config = both[0].config
    if both[0].log.odometry is not None and config.smoothing is not None:
        return _joined_by_graph(both, config.smoothing, report)
    if any(each.places.unplaced is not None for each in both):
        return _apart(both, {"event": "not joined", "reason": "the robot of one log was lost at its end"})
    report("both logs, all poses and walls")
    found = joined_by_lines(both)
    if isinstance(found, NotJoined):
        return _apart(both, found.record)
    smoothed = found.smoothed
    return JointReplay(
        both, found.record, found.poses, found.frame, smoothed.landmarks, smoothed.segments, found.grid,
        found.status, {"smoothed_contradictions": smoothed.contradictions},
    )  # fmt: skip


def _apart(replays: tuple[Replay, Replay], record: dict[str, Any]) -> JointReplay:
    """Two logs that were not joined. The files of the first log's map are those of the result."""
    first = replays[0]
    one, other = (each.estimated if each.smoothed is None else each.smoothed.poses for each in replays)
    status = Status("unsure", f"{NOT_JOINED}: {record['reason']}")
    return JointReplay(replays, record, (one, other), np.zeros(3), first.landmarks, first.segments, first.grid, status)


def _joined_by_graph(replays: tuple[Replay, Replay], config: GraphConfig, report: Report) -> JointReplay:
    first, second = (_chain(each, config) for each in replays)
    found = merge(first, second, config, report)
    joint, chains = found.joint, (found.first, found.second)
    if joint is None:
        return _apart(replays, found.record)
    poses = poses_of_both(joint.trajectory, *chains)
    std, reach = (max(getattr(each.data, name) for each in chains) for name in ("range_std", "max_range"))
    landmarks = draw_walls(point_cloud(joint.keys, joint.trajectory, std), std)
    since = np.concatenate([each.data.time - each.data.time[0] for each in chains])
    signals = path_signals(joint, since, config, (reach, std), seam=len(chains[0].keys))
    frame = se2.compose(poses[1][0], se2.inverse(replays[1].log.start_pose))
    return JointReplay(
        replays, found.record, poses, frame, landmarks, ends_of(landmarks), grid_of(replays, poses),
        signals.status, signals.figures, _loops(joint, replays),
    )  # fmt: skip


def _chain(replay: Replay, config: GraphConfig) -> Chain:
    smoothed = replay.smoothed
    assert smoothed is not None  # noqa: S101 (the caller has looked)
    assert isinstance(smoothed.basis, GraphResult) and smoothed.data is not None  # noqa: PT018, S101
    return Chain.of(smoothed.data, smoothed.basis, config)


def _loops(joint: GraphResult, replays: tuple[Replay, Replay]) -> list[dict[str, Any]]:
    """All loops of both logs, with the log of each of their ends."""
    logs = (joint.keys.first_event[joint.chunk_keys] >= len(replays[0].log)).astype(int)
    records = loop_records(joint, np.concatenate([each.log.time for each in replays]))
    return [
        {"first_log": int(logs[verdict.loop.first]), "second_log": int(logs[verdict.loop.second]), **record}
        for verdict, record in zip(joint.verdicts, records, strict=True)
    ]
