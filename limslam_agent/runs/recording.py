"""Films a run: each frame shows a picture of the truth beside what the recording of the run says
about the belief.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.inspect.recorder import Recorder
from limslam_agent.mapping.team import LimSlamTeam
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.status.status import worst
from limslam_agent.video.belief_frame import BeliefFrame, Event, HoughView
from limslam_agent.video.film import FPS, HEIGHT, WIDTH, Film
from limslam_agent.video.video import video_file
from limslam_env.envs.parallel_env import LimSlamParallelEnv
from limslam_env.worlds.formats.loading import load_world


class FilmedRun:
    """Adds frames to the film of a run.

    Parameters
    ----------
    film
        Gets the pictures.
    """

    def __init__(self, film: Film) -> None:
        self._film = film
        self._words = ""
        self._shown = 0  # events of the recording
        self._hough: HoughView | None = None

    def watch(
        self,
        recorder: Recorder,
        team: LimSlamTeam,
        env: LimSlamParallelEnv,
        time: float,
        coverage: float,
    ) -> None:
        """Add a frame of a step that was recorded, when one is due."""
        self._words = team.stop_reason or "the run's longest time is over"
        if self._film.is_due(time):
            truth = env.render()
            if truth is not None:
                self._film.add(truth, self._frame(recorder, team, time), coverage)

    def finish(self) -> None:
        """End the film with the reason why the run ended."""
        self._film.finish(self._words)

    def _frame(self, recorder: Recorder, team: LimSlamTeam, time: float) -> BeliefFrame:
        slam = team.slam
        snapshot = team.snapshot()
        marks = slam.all_landmarks
        grid = snapshot.grid
        events = recorder.log.events[self._shown :]
        self._shown = len(recorder.log.events)
        for event in events:
            if event["kind"] == "hough" and event["side"] != "none":
                self._hough = HoughView.of(event, event["row"] * slam.robot.control_period)
        return BeliefFrame(
            time=time,
            poses=snapshot.poses,
            covariances=snapshot.covariances,
            walls=marks,
            unsure=frozenset(mark.number + 1 for mark in marks)
            - {mark.number + 1 for mark in snapshot.landmarks},
            grid=grid,
            frontier=grid.centres(
                np.argwhere(frontier_cells(grid, team.config.policy.min_frontier))
            ),
            plans=snapshot.plans,
            goals=[getattr(policy, "goal", None) for policy in team.policies],
            new_goals=sorted({event["robot"] for event in events if event["kind"] == "goal"}),
            paths=list(recorder.poses()[..., :2].swapaxes(0, 1)),
            buffers=[each for each in slam.pending_points if each.side != "none"],
            hough=self._hough,
            events=[
                Event(event["kind"], event["wall"], event.get("other"), event.get("robot", 0))
                for event in events
                if event["kind"] in {"new", "again", "loop"}
            ],
            warning=worst(snapshot.statuses).words if snapshot.status != "ok" else "",
        )


@contextmanager
def filming(
    path: Path, config: RunConfig, title: str, *, force: bool = False
) -> Iterator[FilmedRun]:
    """The film of one run. The file appears when the context ends without an error."""
    corners = load_world(config.world).edges.reshape(-1, 2)
    with video_file(path, FPS, (WIDTH, HEIGHT), force=force) as writer:
        filmed = FilmedRun(Film(writer, corners.min(axis=0), corners.max(axis=0), title))
        yield filmed
        filmed.finish()
