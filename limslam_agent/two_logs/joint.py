"""The result of two logs, joined or apart."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_agent.places.revisions import Unplaced
from limslam_agent.replay.record import Replay
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray, se2

Replays = tuple[Replay, Replay]


@dataclass(frozen=True, eq=False)
class JointReplay:
    """The result of two logs."""

    replays: Replays  # each log by itself
    # Smoothed poses (n, 3) and (m, 3) of all events: in the frame of the first log, or each in its
    # own frame
    poses: tuple[FloatArray, FloatArray]
    # landmarks, segments, grid: the map; that of the first log if the logs were not joined
    landmarks: list[Landmark]
    segments: FloatArray
    grid: GridView
    status: Status  # whether map and paths can be trusted
    record: dict[str, Any]  # the joining, or why the logs were not joined
    figures: dict[str, Any] = field(default_factory=dict)  # for the metrics of ``result.json``
    loops: list[dict[str, Any]] | None = (
        None  # for ``loops.json``. None without the graph of local maps.
    )
    seconds: float = 0.0  # CPU time of the joining, s

    @property
    def is_joined(self) -> bool:
        """Whether both logs have one map, in the frame of the first log."""
        return bool(self.record["event"] == "joined")

    @property
    def frame(self) -> FloatArray:
        """Pose (3,) of the second log's own frame in the frame of ``poses``."""
        return frame_of(self.replays[1], self.poses[1]) if self.is_joined else np.zeros(3)

    @property
    def unplaced(self) -> Unplaced | None:
        """The map of the second log in its own frame, if the logs were not joined."""
        other = self.replays[1]
        return None if self.is_joined else Unplaced(0, other.segments, other.landmarks, other.grid)

    def paths(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Poses of all events, (n, 3) and (m, 3), in the frames of ``poses``.

        They are by the names of their files: as they were believed while driving, by odometry
        alone, and smoothed.
        """
        one, other = self.replays
        return {
            "est": (one.estimated, se2.compose(self.frame, other.estimated)),
            "odometry": (one.odometry, se2.compose(self.frame, other.odometry)),
            "smoothed": self.poses,
        }


def frame_of(replay: Replay, poses: FloatArray) -> FloatArray:
    """Pose (3,) of a log's own frame in the frame of poses (n, 3) of its events."""
    return se2.compose(poses[0], se2.inverse(replay.log.start_pose))
