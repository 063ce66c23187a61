"""Films a run: each frame shows a picture of the truth beside a picture of the belief."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.slam.slam import Extraction, LineSlam
from limslam_agent.status.status import worst
from limslam_agent.team import LimSlamTeam
from limslam_agent.video.belief_frame import BeliefFrame, BufferView, Event, HoughView, hough_view
from limslam_agent.video.film import FPS, SPEED, Film
from limslam_agent.video.video import VideoWriter
from limslam_env.envs.parallel_env import LimSlamParallelEnv
from limslam_env.geometry import FloatArray
from limslam_env.worlds.formats.loading import load_world


class Recorder:
    """Watches a run and films it.

    Parameters
    ----------
    film
        Gets the pictures.
    """

    def __init__(self, film: Film) -> None:
        self._film = film
        self._events: list[Event] = []
        self._slam: LineSlam | None = None
        self._associations = self._closures = 0
        self._extraction: Extraction | None = None
        self._hough: HoughView | None = None
        self._paths: list[list[FloatArray]] = []
        self._words = ""

    def watch(self, team: LimSlamTeam, env: LimSlamParallelEnv, time: float, coverage: float) -> None:
        """Note a step, and add a frame to the film when one is due."""
        if not self._paths:
            self._paths = [[] for _ in team.names]
        for path, pose in zip(self._paths, team.slam.poses, strict=True):
            path.append(pose[:2])
        self._look(team.slam)
        self._words = team.stop_reason or "the run's longest time is over"
        if self._film.is_due(time):
            truth = env.render()
            if truth is not None:
                self._film.add(truth, self._frame(team, time), coverage)

    def finish(self) -> None:
        """End the film with the reason why the run ended."""
        self._film.finish(self._words)

    def _look(self, slam: LineSlam) -> None:
        if self._slam is not None and slam is not self._slam:  # the robot goes on in another frame
            self._associations, self._closures = len(slam.associations), len(slam.closures)
        for record in slam.associations[self._associations :]:
            self._events.append(Event("new" if record.is_new else "again", record.landmark + 1, robot=record.robot))
        for closure in slam.closures[self._closures :]:
            self._events.append(Event("loop", closure.younger + 1, closure.older + 1))
        self._slam, self._associations, self._closures = slam, len(slam.associations), len(slam.closures)
        last, hough = slam.last_extraction, slam.config.estimator.hough
        if last is None or last is self._extraction or last.side == "none":
            return
        self._extraction = last
        self._hough = hough_view(
            last.points, last.lines, last.ends, last.pose, time=last.step * slam.robot.control_period,
            side=last.side, robot=last.robot, r_step=max(hough.r_step, 3.0 * slam.config.range_std),
            threshold=hough.min_votes,
        )  # fmt: skip

    def _frame(self, team: LimSlamTeam, time: float) -> BeliefFrame:
        slam, snapshot = team.slam, team.snapshot()
        marks, grid = slam.all_landmarks, snapshot.grid
        confirmed = {mark.number for mark in snapshot.landmarks}
        events, self._events = self._events, []
        return BeliefFrame(
            time=time,
            poses=snapshot.poses,
            covariances=snapshot.covariances,
            segments=np.array([mark.ends.ravel() for mark in marks]).reshape(-1, 4),
            lines=np.array([(mark.r, mark.theta) for mark in marks]).reshape(-1, 2),
            line_covariances=np.array([mark.covariance for mark in marks]).reshape(-1, 2, 2),
            numbers=tuple(mark.number + 1 for mark in marks),
            unsure=frozenset(mark.number + 1 for mark in marks if mark.number not in confirmed),
            grid_low=grid.low,
            grid_cell=grid.cell,
            grid_values=grid.values,
            frontier=grid.centres(np.argwhere(frontier_cells(grid, team.config.policy.min_frontier))),
            plans=snapshot.plans,
            goals=[getattr(policy, "goal", None) for policy in team.policies],
            paths=[np.array(path) for path in self._paths],
            buffers=_buffers(slam),
            hough=self._hough,
            events=events,
            warning=worst(snapshot.statuses).words if snapshot.status != "ok" else "",
        )


def _buffers(slam: LineSlam) -> list[BufferView]:
    return [
        BufferView(each.robot, each.side, each.points, each.enough, each.new)
        for each in slam.pending_points
        if each.side != "none"
    ]


@contextmanager
def filming(
    path: Path, config: RunConfig, title: str, *, force: bool = False, speed: float = SPEED
) -> Iterator[Recorder]:
    """A recorder for one run, ``speed`` times as fast as the run. The file appears when the context ends without an
    error.

    Raises
    ------
    ValueError
        If such a video cannot be written.
    """
    corners = load_world(config.world).edges.reshape(-1, 2)
    with VideoWriter(path, FPS, force=force) as writer:
        recorder = Recorder(Film(writer, corners.min(axis=0), corners.max(axis=0), title, speed=speed))
        yield recorder
        recorder.finish()
