"""Recovery of one robot that is lost: copies of its earlier estimate, its steps since then, and the search for its
place.

A robot that is lost goes on in a new local frame, with a map of its own. The earlier map is kept as it was before the
first doubt about the estimate. The local map is matched with the earlier map again and again, until two matches in
succession find the same place.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from limslam_agent.config.places import PlaceConfig
from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.grid.occupancy import GridView, OccupancyGrid
from limslam_agent.places.decision import CLEAN_MATCHES, Decision, agree, find_place, placed_covariance, runner_up
from limslam_agent.places.history import LoggedStep, StepLog, carried_at
from limslam_agent.places.matching import best_fits
from limslam_agent.places.place_map import PlaceMap, place_map
from limslam_agent.slam.slam import LineSlam
from limslam_agent.status.monitor import UNIFORM_HEADING
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose
from limslam_env.interface import RobotSpec


@dataclass(frozen=True, eq=False)
class KnownFrame:
    """SLAM and occupancy grid of one frame, as they were before a step.

    Attributes
    ----------
    step
        Number of the step.
    slam, grid
        The estimate, which nothing changes any more.
    """

    step: int
    slam: LineSlam
    grid: OccupancyGrid

    def copied(self) -> tuple[LineSlam, OccupancyGrid]:
        """SLAM and grid to go on with."""
        return self.slam.copied(), self.grid.copied()


@dataclass(eq=False)
class Absence:
    """A robot that is lost, or that has found its place and is not yet sure of it.

    Attributes
    ----------
    known
        The frame that it was lost from. None if its place was found in the map of an earlier run.
    first
        First step in the local frame.
    reason
        Why the robot is lost, in words.
    jump
        Standard deviation of the position at the beginning, m.
    driven, moved, sought
        Distance since the robot was lost, m, the same with turns, and the latter at the latest match.
    gone
        Poses (3,) in the local frame of its first steps, as far as the steps themselves are no longer kept.
    is_dated
        Whether the readings have said in which step the robot was carried away.
    place
        The map of the known frame.
    decisions
        All matches so far.
    placed, local
        Distance at which the robot found its place, m, and the local map at that time; None while it is lost.
    """

    known: KnownFrame | None
    first: int
    reason: str
    jump: float
    place: PlaceMap
    driven: float = 0.0
    moved: float = 0.0
    sought: float = 0.0
    gone: list[FloatArray] = field(default_factory=list)
    is_dated: bool = False
    decisions: list[tuple[int, Decision]] = field(default_factory=list)
    placed: float | None = None
    local: PlaceMap | None = None

    @property
    def is_placed(self) -> bool:
        """Whether the robot has found its place."""
        return self.placed is not None


class Placement(NamedTuple):
    """How a robot goes on in the frame that it was lost from.

    Attributes
    ----------
    step
        First step after the robot was carried away, of the steps that are kept.
    pose, covariance
        Its pose (3,) before that step, in the known frame, and the covariance (3, 3).
    local
        The local map that was matched.
    gone
        Pose (3,) and covariance (3, 3) in the known frame at each step before ``step`` since the robot was carried
        away, if it was lost for so long that these steps are no longer kept; empty otherwise.
    """

    step: int
    pose: FloatArray
    covariance: FloatArray
    local: PlaceMap
    gone: list[tuple[FloatArray, FloatArray]]

    @property
    def carried_at(self) -> int:
        """First step after the robot was carried away."""
        return self.step - len(self.gone)


class Recovery:
    """Follows the estimate of one robot, and finds its place again when it is lost.

    Parameters
    ----------
    robot, config
        Body and settings.
    places
        Settings of the search.

    Attributes
    ----------
    log
        The latest steps.
    absence
        What is known about a robot that is lost, or that is not yet sure of its place; None otherwise.
    breaks
        Steps before which the robot was carried away, in the frame that it has found again.
    records
        What happened, for ``result.json``.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig, places: PlaceConfig) -> None:
        self._robot, self._agent, self._config = robot, config, places
        self.log = StepLog()
        self._copies: list[KnownFrame] = []
        self.absence: Absence | None = None
        self.breaks: list[int] = []
        self.records: list[dict[str, Any]] = []
        self._arrival: Absence | None = None

    @property
    def is_lost(self) -> bool:
        """Whether the robot is in a local frame."""
        return self.absence is not None and not self.absence.is_placed

    @property
    def is_placed(self) -> bool:
        """Whether the robot has found its place in the frame that it was lost from, without being sure of it yet."""
        return self.absence is not None and self.absence.is_placed

    def status(self, own: Status) -> Status:
        """The status of the robot, whose own status in its frame is given."""
        found = self.absence or self._arrival
        if found is None:
            return own
        if not found.is_placed:
            return Status("lost", found.reason)
        if own.level != "ok":
            return own
        return Status("unsure", "the robot's place was found, and it is not confirmed yet")

    @property
    def added_covariance(self) -> FloatArray:
        """What has to be added to the covariance (3, 3) of the pose; zero if the robot is not lost."""
        if self.absence is None or self.absence.is_placed:
            return np.zeros((3, 3))
        limits, driven = self._agent.status.recovery, self.absence.driven
        position = self.absence.jump + min(limits.position_growth * driven, limits.position_limit)
        heading = min(limits.heading_growth * driven, UNIFORM_HEADING)
        return np.diag([position**2, position**2, heading**2])

    def note(self, step: LoggedStep, slam: LineSlam, grid: OccupancyGrid) -> None:
        """Keep a step of the robot, and now and then a copy of its estimate after it."""
        self.log.steps.append(step)
        absence = self.absence or self._arrival
        if absence is not None:
            x, y, turn = step.motion.tolist()
            absence.driven += math.hypot(x, y)
            absence.moved += math.hypot(x, y) + self._config.turn_length * abs(turn)
        if self.absence is not None:
            begin = self.log.begin
            gone = self.log.forget_before(self.log.end - self._config.longest)
            self.absence.gone += [step.pose for step in gone[max(self.absence.first - begin, 0) :]]
        elif not self._copies or self.log.end % self._config.checkpoint == 0:
            self._copies = [*self._copies, self._copy(slam, grid)][-self._config.checkpoints :]
            self.log.forget_before(self._copies[0].step)

    def forget_copies(self) -> None:
        """The estimate was renewed, and its earlier copies are worse."""
        self._copies = []

    def lose(
        self, status: Status, doubted: int, jump: float, slam: LineSlam, grid: OccupancyGrid, *, is_dated: bool = False
    ) -> None:
        """The robot is lost, and its estimate was doubtful for some steps.

        A robot that had found its place without being sure of it goes back to the frame as it was before. If the
        readings have said in which step the robot was carried away, the map until then is good.
        """
        first = self.log.end - 1 - doubted
        before, self._arrival = self.absence, None
        if before is None:
            margin = 1 if is_dated else self._config.margin
            old = [copy for copy in self._copies if copy.step <= first - margin]
            known = old[-1] if old else (self._copies[0] if self._copies else self._copy(slam, grid))
            view = known.grid.view
            self.absence = Absence(known, first, status.reason, jump, place_map(known.slam.segments, view))
            self.log.forget_before(known.step)
        else:
            if before.is_placed:
                self.breaks.pop()
            self.absence = replace(before, first=first, placed=None, local=None, gone=[])
        self.absence.first = max(self.absence.first, self.log.begin + 1)
        self.absence.is_dated = is_dated
        self.absence.sought = self.absence.moved + self._config.lost_first - self._config.lost_spacing
        self._copies = []
        self._note_event("lost", step=self.absence.first, reason=status.reason)

    def is_due(self) -> bool:
        """Whether the local map is to be matched now, or a place to be confirmed."""
        absence = self.absence or self._arrival
        spacing = self._config.lost_spacing if self.is_lost else self._config.spacing
        return absence is not None and absence.moved - absence.sought >= spacing

    def seek(self, segments: FloatArray, grid: GridView) -> Placement | None:
        """Match the local map with the known map. The placement if two matches in succession find the same place."""
        absence = self.absence
        assert absence is not None  # noqa: S101 (only lost robots seek)
        absence.sought = absence.moved
        local = place_map(segments, grid)
        decision = find_place(absence.place, local, self._config, CLEAN_MATCHES)
        absence.decisions.append((self.log.end - 1, decision))
        earlier = [found for step, found in absence.decisions[:-1] if step >= absence.first]
        if not earlier or not agree(earlier[-1], decision, local, self._config):
            return None
        return self._placement(absence, local, decision)

    def has_joined(self, placement: Placement) -> None:
        """The robot goes on in the known frame."""
        assert self.absence is not None  # noqa: S101
        self.absence.placed, self.absence.sought = self.absence.driven, self.absence.moved
        self.absence.local = placement.local
        self.breaks.append(placement.carried_at)
        self._note_event("found", step=self.log.end - 1, carried_at=placement.carried_at)

    def arrive(self, segments: FloatArray, grid: GridView) -> None:
        """The robot's place in the map of an earlier run was found by a local map, and has to be confirmed."""
        local = place_map(segments, grid)
        self._arrival = Absence(None, 0, "", 0.0, local, placed=0.0, local=local)

    def confirm(self, own: Status, segments: FloatArray, grid: GridView) -> None:
        """End an absence if nothing speaks against the place any more."""
        absence, config = self.absence or self._arrival, self._config
        assert absence is not None  # noqa: S101 (a place is to be confirmed)
        absence.sought = absence.moved
        driven = absence.driven - (absence.placed or 0.0)
        is_closed = driven >= config.far_confirmed or not frontier_cells(grid, self._agent.policy.min_frontier).any()
        if own.level != "ok" or driven < config.confirmed or not is_closed:
            return
        whole = place_map(segments, grid)
        assert absence.local is not None  # noqa: S101 (the robot has found its place)
        fits = best_fits(whole, absence.local, config)
        if fits and runner_up(fits, config) <= config.runner_up:
            self._note_event("confirmed", step=self.log.end - 1)
            self.absence = self._arrival = None

    def give_up(self) -> None:
        """The run is over, and the robot is still lost."""
        self._note_event("not found", step=self.log.end - 1)

    def _copy(self, slam: LineSlam, grid: OccupancyGrid) -> KnownFrame:
        return KnownFrame(self.log.end, slam.copied(), grid.copied())

    def _placement(self, absence: Absence, local: PlaceMap, decision: Decision) -> Placement:
        """Where the robot was before it was carried away, as far as its steps are kept."""
        assert decision.fit is not None  # noqa: S101 (an accepted decision has a fit)
        log, frame = self.log, decision.fit.pose
        last = max(absence.first - 1, log.begin)
        placed = log.driven_back(compose(frame, log[last].pose), last + 1)
        step = last + 1
        if absence.known is not None and log.begin == absence.known.step and not absence.is_dated:
            step = carried_at(
                log, placed, self._robot, absence.place.segments, self._agent.range_std,
                self._agent.status.contradictions,
            )  # fmt: skip
        pose = placed[step - 1 - log.begin]
        # If the first steps are gone, there is none before the robot was carried away.
        lost = [*absence.gone, log[log.begin].pose] if absence.gone else []
        poses = [pose, *(compose(frame, each) for each in lost)]
        covariances = [placed_covariance(local, decision, each, self._config) for each in poses]
        return Placement(step, pose, covariances[0], local, list(zip(poses[1:], covariances[1:], strict=True)))

    def _note_event(self, event: str, **details: Any) -> None:
        decisions = [] if self.absence is None else self.absence.decisions
        matches: dict[str, Any] = {"refused": sum(not each.is_accepted for _, each in decisions)} if decisions else {}
        if decisions and event != "lost":
            matches["match"] = decisions[-1][1].record
        self.records.append({"event": event, **details, **matches})
