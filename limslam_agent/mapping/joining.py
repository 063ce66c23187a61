"""JoiningMapper: two robots that do not know where they are relative to each other, until their maps fit together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.grid.occupancy import GridView
from limslam_agent.mapping.mapper import MOST_RESTARTS, Mapper
from limslam_agent.places.history import LoggedStep, copied
from limslam_agent.places.localisation import KnownPlaces
from limslam_agent.places.meeting import Meeting
from limslam_agent.places.revisions import PlaceHistory, Unplaced
from limslam_agent.slam.slam import LineSlam
from limslam_agent.status.status import Status, worst
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import compose, inverse
from limslam_env.interface import Observation, RobotSpec

NOT_YET_JOINED = Status("unsure", "the second robot's place relative to the first one is not known yet")
"""The status of the second robot before the maps of both robots fit together."""

NOT_YET_CONFIRMED = Status("unsure", "the second robot's place relative to the first one is not confirmed yet")
"""The status of the second robot while a part of the building that was not seen yet may look like its place."""


UNKNOWN = np.diag([100.0, 100.0, np.pi**2])
"""Covariance (3, 3) of an unknown place in a building, m and rad."""


@dataclass(frozen=True, eq=False)
class Joined:
    """The steps until two robots were joined, by what was known then, in the shared frame.

    Of robots that parted again: the steps since they were joined, each in its own frame.

    Attributes
    ----------
    begin
        Number of the first step.
    poses, covariances, odometry
        Poses of both robots (t, 2, 3), m and rad, their covariances (t, 2, 3, 3), and poses by odometry alone.
    """

    begin: int
    poses: FloatArray
    covariances: FloatArray
    odometry: FloatArray


class JoiningMapper(Mapper):
    """Maps with two robots. The pose at which the second robot starts is not known in the frame of the first one.

    Each robot maps in a frame of its own, and the frame of the first robot is the world frame. When both maps fit
    together in one place only, all observations so far are processed again by one SLAM with a shared map, and the
    robots go on as a team.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage. The preset ``graph`` by default.

    Attributes
    ----------
    joined
        The steps until the robots were joined; None before, and after a joining was taken back.
    parted
        The steps from a joining until it was taken back, as the robots know them by themselves; None without it.

    Raises
    ------
    ValueError
        If the settings have no search for places.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig | None = None) -> None:
        super().__init__(robot, config, np.zeros((2, 3)))

    def reset(self, start_pose: FloatArray) -> None:
        """Forget everything. The poses (2, 3): the first robot's in the world, the second one's in its own frame."""
        self._apart: list[Mapper] | None = None
        self.joined: Joined | None = None
        self.parted: Joined | None = None
        super().reset(start_pose)
        if not self.config.can_recover or len(self._starts) != 2:
            raise ValueError("unknown starts are for two robots with the preset graph or consistent")
        self._own, self._meeting = self._starts, Meeting(self.robot)
        self._apart = self._alone = self._separate_mappers()
        self._steps, self._odometry = list[tuple[Observation, ...]](), list[FloatArray]()

    def step(self, *observations: Observation) -> None:
        """Process one observation of each robot; the errors are those of :meth:`Mapper.step`."""
        if self._apart is None:
            super().step(*observations)
            self._meeting.drive(self.slam.increments)
            if self._meeting.is_doubtful:
                self._keep(observations)
                self._check_joining()
            return
        if len(observations) != len(self._apart):
            raise ValueError(f"{len(observations)} observations for {len(self._apart)} robots")
        for mapper, observation in zip(self._apart, observations, strict=True):
            mapper.check(observation)
        for mapper, observation in zip(self._apart, observations, strict=True):
            mapper.step(observation)
        self._follow_both(self._apart)
        motions = [mapper.slam.increments[0] for mapper in self._apart]
        if self._meeting.is_open:
            self._keep(observations)
            seen = zip(observations, self._apart, motions, strict=True)
            self._meeting.note([LoggedStep.of(each, mapper.slam, motion) for each, mapper, motion in seen])
        self._meeting.drive(motions)
        if self._meeting.is_due:
            self._seek_other(self._apart)

    def finish(self) -> None:
        """Use the readings that are still buffered, and look once more whether the maps fit together."""
        if self._apart is None:
            super().finish()
            if self._meeting.is_doubtful:
                self._check_joining(is_over=True)
            if self._apart is None:
                return
        for mapper in self._apart:
            mapper.finish()
        if self._meeting.is_open and self._seek_other(self._apart):
            super().finish()
            return
        self._follow_both(self._apart)
        if self._meeting.is_open:
            is_lost = self._is_one_lost(self._apart)
            self._meeting.end("a robot is lost" if is_lost else "no match was good and unambiguous")
        other = self._apart[1]
        self._unplaced = Unplaced(0, other.slam.segments, other.slam.landmarks, other.grid)

    @property
    def is_apart(self) -> bool:
        """Whether each robot still maps in a frame of its own."""
        return self._apart is not None

    @property
    def slam(self) -> LineSlam:
        """The SLAM that the robots share; at first that of the first robot."""
        return super().slam if self._apart is None else self._apart[0].slam

    @property
    def poses(self) -> FloatArray:
        """Estimated pose of each robot (2, 3), m and rad. That of the second robot is in its own frame at first."""
        return super().poses if self._apart is None else np.array([mapper.slam.pose for mapper in self._apart])

    @property
    def dropped(self) -> list[BoolArray]:
        """The latest beams of each robot that were ignored, since they may have hit a teammate."""
        return super().dropped if self._apart is None else [mapper.dropped[0] for mapper in self._apart]

    @property
    def covariances(self) -> FloatArray:
        """Covariance of each robot's pose (2, 3, 3) in the first robot's frame."""
        if self._apart is None:
            return super().covariances
        first, second = (mapper.covariances[0] for mapper in self._apart)
        return np.array([first, second + UNKNOWN])

    @property
    def statuses(self) -> list[Status]:
        """Whether the estimate of each robot can be trusted."""
        is_doubtful, note = self._meeting.is_doubtful, NOT_YET_JOINED if self.is_apart else NOT_YET_CONFIRMED
        first, second = super().statuses if self._apart is None else [mapper.statuses[0] for mapper in self._apart]
        return [first, note if second.level == "ok" and (self.is_apart or is_doubtful) else second]

    @property
    def beliefs(self) -> list[Belief]:
        """The belief of each robot, in the frame in which it maps."""
        if self._apart is None:
            return super().beliefs
        statuses = self.statuses
        return [
            replace(mapper.belief, status=status, frame=self.frame)
            for mapper, status in zip(self._apart, statuses, strict=True)
        ]

    @property
    def grid(self) -> GridView:
        """The grid that the robots share; at first that of the first robot."""
        return super().grid if self._apart is None else self._apart[0].grid

    @property
    def places(self) -> PlaceHistory:
        """How the search ended. The second robot's own map is known after :meth:`finish`, if it was not placed."""
        return PlaceHistory(unplaced=self._unplaced, records=list(self._meeting.records))

    def _follow_both(self, apart: Sequence[Mapper]) -> None:
        """Take over what the robots know by themselves."""
        changes = 0 if self.parted is None else 2  # the shared frame came and went
        self.frame = changes + sum(mapper.frame for mapper in apart)
        self.slam_ms = sum(mapper.slam_ms for mapper in apart)
        self.odometry = np.concatenate([mapper.odometry for mapper in apart])
        self.odometry.setflags(write=False)

    def _seek_other(self, apart: list[Mapper]) -> bool:
        """Search for the second robot in the map of the first one, and go on as a team if it fits in one place only.

        The result is whether they are a team now.

        A lost robot is not in its map. Robots that do not know of each other are easily lost when they meet, because
        the body of the other robot contradicts the map. The search goes on when both know their places again.
        """
        if self._is_one_lost(apart):
            return False
        if any(_has_left_its_path(mapper.places) for mapper in apart):
            self._meeting.end("a robot was carried away, or has begun a new map")
            return False
        found = self._meeting.seek([each.slam for each in apart], [each.grid for each in apart], self._own[1])
        return found is not None and self._join(apart, *found)

    def _is_one_lost(self, apart: Sequence[Mapper]) -> bool:
        return any(mapper.statuses[0].level == "lost" for mapper in apart)

    def _join(self, apart: list[Mapper], start: FloatArray, covariance: FloatArray) -> bool:
        """Process all steps again with a shared map; the second robot starts at a pose (3,) that a match has found.

        If the readings of one robot contradict the map of the other one, both stay apart, and the result is False.
        """
        starts, odometry = np.array([self._own[0], start]), np.array(self._odometry)
        slam = LineSlam(self.robot, self.config, starts)
        slam.relocate(start, covariance, robot=1)
        self._apart = None
        self._start_at(starts, slam)
        self._restarts = MOST_RESTARTS  # the robots are not at their starts any more
        again = self._process_again(self._steps)
        if again.was_lost:
            self._apart = apart
            self._follow_both(apart)
            self._meeting.refuse("the readings contradict the shared map")
            return False
        self.slam_ms, self._frame_of_second = 0.0, compose(start, inverse(self._own[1]))
        odometry[:, 1] = compose(self._frame_of_second, odometry[:, 1])
        self.joined = Joined(0, again.poses, again.covariances, odometry)
        self.odometry = odometry[-1]
        self.frame = 1 + sum(mapper.frame for mapper in apart)
        self._meeting.has_joined(start)
        self._forget_steps()
        return True

    def _separate_mappers(self) -> list[Mapper]:
        """Mappers that begin at the robots' own starts.

        What ends in space that is known to be free may be the body of the other robot, and contradicts no map.
        """
        config = replace(self.config, free_space_counts=False)
        return [Mapper(self.robot, config, start) for start in self._own]

    def _keep(self, observations: Sequence[Observation]) -> None:
        """Keep the observations of a step: they are processed again at a joining, or when it is taken back."""
        self._steps.append(copied(observations))
        self._odometry.append(self.odometry)

    def _forget_steps(self) -> None:
        self._steps, self._odometry = [], []

    def _check_joining(self, *, is_over: bool = False) -> None:
        """Confirm a joining, or take it back if a robot is lost in the shared map or if another place fits as well."""
        level = worst(super().statuses).level
        if level == "lost":
            self._part("the readings contradict the shared map")
        elif level == "ok" and (is_over or self._meeting.is_to_be_confirmed):
            is_complete = not frontier_cells(self.grid, self.config.policy.min_frontier).any()
            whole = KnownPlaces(self.slam.segments, self.grid, self.slam.range_sensor)
            ambiguity = self._meeting.confirm(whole, is_complete=is_complete)
            if ambiguity and is_complete:
                self._part(ambiguity)
        if not self._meeting.is_doubtful:
            self._alone = []
            self._forget_steps()

    def _part(self, reason: str) -> None:
        """Take a joining back: each robot goes on with the map that it had by itself, and with its steps since then."""
        assert self.joined is not None  # noqa: S101 (the robots are a team)
        poses, covariances = list[FloatArray](), list[FloatArray]()
        begin, self.joined, self._apart = len(self.joined.poses), None, self._alone
        for observations in self._steps:
            for mapper, observation in zip(self._alone, observations, strict=True):
                mapper.step(observation)
            poses.append(self.poses)
            covariances.append(self.covariances)
        odometry = np.array(self._odometry)
        odometry[:, 1] = compose(inverse(self._frame_of_second), odometry[:, 1])
        self.parted = Joined(begin, np.array(poses), np.array(covariances), odometry)
        self._meeting.take_back(reason)
        self._forget_steps()
        self._follow_both(self._alone)


def _has_left_its_path(places: PlaceHistory) -> bool:
    """Whether a robot's wheels do not tell all its motions, or its map does not begin at its start."""
    return bool(places.breaks) or any(record["event"] == "begun anew" for record in places.records)
