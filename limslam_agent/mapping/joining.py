"""JoiningMapper: two robots that do not know where they are relative to each other, until their
maps fit together.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import ndimage

from limslam_agent.belief import Belief
from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.grid.occupancy import GridView, OccupancyGrid
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.mapping.renewal import run_of
from limslam_agent.places.localisation import KnownPlaces
from limslam_agent.places.other_map import Meeting, OwnMap, may_have_met
from limslam_agent.places.revisions import PlaceHistory, Unplaced
from limslam_agent.slam.core.late_ranges import WaitingTravel
from limslam_agent.slam.slam import ConsistentEstimator, Estimator
from limslam_agent.status.status import Status
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import compose, inverse
from limslam_env.interface import Observation, RobotSpec

if TYPE_CHECKING:
    from limslam_agent.slam.line_graph.run import SmoothedRun

NOT_YET_JOINED = Status(
    "unsure", "the second robot's place relative to the first one is not known yet"
)
"""The status of the second robot before the maps of both robots fit together."""

NOT_YET_CONFIRMED = Status(
    "unsure", "the second robot's place relative to the first one is not confirmed yet"
)
"""The status of the second robot while a part of the building that was not seen yet may look like
its place.
"""

_POCKET = 4  # cells of an unknown region into which a robot fits

UNKNOWN = np.diag([100.0, 100.0, np.pi**2])
"""Covariance (3, 3) of an unknown place in a building, m and rad."""


class Earlier(NamedTuple):
    """The steps until two robots were joined, as they became known then, in the shared frame.

    Of robots that parted again: the steps until then, each in its own frame.

    Attributes
    ----------
    poses, covariances, odometry
        Poses of both robots (t, 2, 3), m and rad, their covariances (t, 2, 3, 3), and poses by
        odometry alone.
    """

    poses: FloatArray
    covariances: FloatArray
    odometry: FloatArray


class JoiningMapper(Mapper):
    """Maps with two robots. The pose at which the second robot starts is not known in the frame of
    the first one.

    Each robot maps in a frame of its own, and the frame of the first robot is the world frame. When
    both maps fit together in one place only, both drives are smoothed as one, and the robots go on
    as a team, with one SLAM that knows the smoothed map. Each of them also goes on in its own
    frame, until their place is confirmed or refuted there.

    Attributes
    ----------
    earlier
        The steps until the robots were joined or parted for the last time; None if they were never
        joined.

    Raises
    ------
    ValueError
        If the settings have no search for places.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig | None = None) -> None:
        super().__init__(robot, config, np.zeros((2, 3)))

    def reset(self, start_pose: FloatArray) -> None:
        """Forget everything. The poses (2, 3): the first robot's in the world, the second one's in
        its own frame.
        """
        self.is_apart = False
        self.earlier: Earlier | None = None
        super().reset(start_pose)
        if not self.config.can_recover or len(self._starts) != 2:
            raise ValueError(
                "unknown starts are for two robots with the preset graph or consistent"
            )
        self.is_apart = True
        self._meeting = Meeting(self.robot)
        # What ends in space that is known to be free may be the body of the other robot, and
        # contradicts no map.
        config = replace(self.config, free_space_counts=False)
        self._alone = [Mapper(self.robot, config, start) for start in self._starts]
        for mapper in self._alone:
            mapper.keeps_drives = True
        self._changes = 0  # number of times that the robots were joined or parted
        self._believed = list[Earlier]()  # what was believed in each step

    def step(self, *observations: Observation) -> None:
        """Process one observation of each robot; the errors are those of :meth:`Mapper.step`."""
        if len(observations) != 2:
            raise ValueError(f"{len(observations)} observations for 2 robots")
        if not all("wheels" in observation for observation in observations):
            raise ValueError("two robots whose starts are unknown have to report wheel travel")
        for mapper, observation in zip(self._alone, observations, strict=False):
            mapper.check(observation)
        if not self.is_apart:
            super().step(*observations)
        if self.is_apart or self._meeting.is_open:
            self._step_alone(observations)
        if self._meeting.is_due:
            self._compare()

    def finish(self) -> None:
        """Use the readings that are still buffered, and look once more whether the maps fit
        together.
        """
        for mapper in self._alone:
            mapper.finish()
        if self._meeting.is_open and self.is_apart:
            self._seek_other()
        if not self.is_apart:
            super().finish()
            if self._meeting.is_open:
                self._check_joining()
        if not self.is_apart:
            return
        self._follow_both()
        if self._meeting.is_open:
            is_lost = self._is_one_lost
            self._meeting.end("a robot is lost" if is_lost else "no match was good and unambiguous")
        other = self._alone[1]
        self._unplaced = Unplaced(0, other.slam.segments, other.slam.landmarks, other.grid)

    @property
    def slam(self) -> Estimator:
        """The SLAM that the robots share; that of the first robot while they are apart."""
        return self._alone[0].slam if self.is_apart else super().slam

    @property
    def frame(self) -> int:
        """Number of times that the frame of a robot has changed."""
        if not self.is_apart:
            return super().frame
        return self._changes + sum(each.frame for each in self._alone)

    @property
    def poses(self) -> FloatArray:
        """Estimated pose of each robot (2, 3), m and rad. That of the second robot is in its own
        frame at first.
        """
        return (
            np.concatenate([each.poses for each in self._alone]) if self.is_apart else super().poses
        )

    @property
    def dropped(self) -> list[BoolArray]:
        """The latest beams of each robot that were ignored, since they may have hit a teammate."""
        return [each.dropped[0] for each in self._alone] if self.is_apart else super().dropped

    @property
    def covariances(self) -> FloatArray:
        """Covariance of each robot's pose (2, 3, 3) in the first robot's frame."""
        return self._covariances_apart if self.is_apart else super().covariances

    @property
    def statuses(self) -> list[Status]:
        """Whether the estimate of each robot can be trusted."""
        found = [each.statuses[0] for each in self._alone] if self.is_apart else super().statuses
        if found[1].level == "ok" and (self.is_apart or self._meeting.is_open):
            found[1] = NOT_YET_JOINED if self.is_apart else NOT_YET_CONFIRMED
        return found

    @property
    def beliefs(self) -> list[Belief]:
        """The belief of each robot, in the frame in which it maps."""
        if not self.is_apart:
            return super().beliefs
        return [
            replace(mapper.belief, status=status, frame=self.frame)
            for mapper, status in zip(self._alone, self.statuses, strict=True)
        ]

    @property
    def grid(self) -> GridView:
        """The grid that the robots share; that of the first robot while they are apart."""
        return self._alone[0].grid if self.is_apart else super().grid

    @property
    def places(self) -> PlaceHistory:
        """How the search ended. The second robot's own map is known after :meth:`finish`, if it was
        not placed.
        """
        return PlaceHistory(self._meeting.events, self._unplaced)

    def _is_to_restart(self, reported: Sequence[Observation]) -> bool:
        """A team does not begin again, since its robots are not at their starts any more."""
        del reported
        return False

    def _step_alone(self, observations: Sequence[Observation]) -> None:
        """Let each robot go on in its own frame."""
        for mapper, observation in zip(self._alone, observations, strict=True):
            mapper.step(observation)
        if self._meeting.is_open:
            self._meeting.drive(np.array([each.slam.increments[0] for each in self._alone]))
            odometry = np.concatenate([each.odometry for each in self._alone])
            poses = np.concatenate([each.poses for each in self._alone])
            self._believed.append(Earlier(poses, self._covariances_apart, odometry))
        if self.is_apart:
            self._follow_both()
        else:
            self.slam_ms += sum(each.slam_ms for each in self._alone)

    @property
    def _covariances_apart(self) -> FloatArray:
        first, second = (each.covariances[0] for each in self._alone)
        return np.array([first, second + UNKNOWN])

    def _follow_both(self) -> None:
        """Take over what the robots know by themselves."""
        self.slam_ms = sum(each.slam_ms for each in self._alone)
        self._set_odometry(np.concatenate([each.odometry for each in self._alone]))

    def _compare(self) -> None:
        """Compare the maps of both robots."""
        if not self.is_apart:
            self._check_joining()
        elif self._is_one_elsewhere:
            self._meeting.end("a robot was carried away, or has begun a new map")
            for mapper in self._alone:
                mapper.keeps_drives = False
        else:
            self._seek_other()

    def _seek_other(self) -> None:
        """Search for the second robot in the map of the first one, and go on as a team if it fits
        in one place only.

        A lost robot is not in its map. The search goes on when both know their places again.
        """
        frame = None if self._is_one_lost else self._meeting.seek(self._own_maps)
        smoothed = None if frame is None else self._smoothed_together(frame)
        if smoothed is not None:
            self._join(smoothed)

    @property
    def _own_maps(self) -> list[OwnMap]:
        return [OwnMap(each.slam, each.grid, each.drive) for each in self._alone]

    @property
    def _is_one_elsewhere(self) -> bool:
        """Whether the wheels of a robot do not tell all its motions, or its map does not begin at
        its start.
        """
        places = [mapper.places for mapper in self._alone]
        return any(
            each.breaks
            or any(record["event"] in {"begun anew", "given up"} for record in each.records)
            for each in places
        )

    @property
    def _is_one_lost(self) -> bool:
        return any(mapper.statuses[0].level == "lost" for mapper in self._alone)

    def _join(self, smoothed: "SmoothedRun") -> None:
        """Go on in the map of both drives, smoothed as one."""
        poses = smoothed.poses
        start = poses[0, 1]
        slam = self._frames.slam_at(poses[-1])
        assert isinstance(slam, ConsistentEstimator)  # noqa: S101 (others are not joined)
        slam.know(smoothed.landmarks, smoothed.segments)
        slam.associations.extend(smoothed.associations)
        for number, front in enumerate(slam.robots):
            slam.relocate(poses[-1, number], smoothed.covariances[-1, number], number)
            front.step = len(poses) - 1
        grid = OccupancyGrid(self.config.grid)
        ranges = smoothed.ranges
        is_of_wall = np.isfinite(ranges) & ~may_have_met(poses, ranges, self.robot)
        grid.draw(smoothed.robot, smoothed.read_at, ranges, is_of_wall)
        self._frames.use(slam, grid)
        for front, mapper in zip(slam.robots, self._alone, strict=True):
            front.ticks = mapper.slam.robots[0].ticks
        self._waiting = WaitingTravel(2, self.robot)
        odometry = np.array([each.odometry for each in self._believed])
        odometry[:, 1] = compose(compose(start, inverse(self._starts[1])), odometry[:, 1])
        self.earlier = Earlier(poses, smoothed.covariances, odometry)
        self._set_odometry(odometry[-1])
        self._changes += 1
        self._frames.frame = self.frame
        self.is_apart = False
        self._meeting.has_joined(start)

    def _smoothed_together(self, frame: FloatArray) -> "SmoothedRun | None":
        """Both drives, smoothed as one, with the second robot's frame at about a pose (3,); None if
        that fails.
        """
        # The kernels of the smoother load numba, which takes time that other commands do not need.
        from limslam_agent.slam.line_graph.run import beside
        from limslam_agent.slam.line_graph.smoother import smooth_with_unknown_start

        first, second = (
            run_of(mapper.slam, self.config, mapper.drive.scans) for mapper in self._alone
        )
        run = beside(first, second, frame)
        usable = run.usable & ~may_have_met(run.poses, run.ranges, self.robot)
        return smooth_with_unknown_start(replace(run, usable=usable), self.config.run_smoothing)

    def _check_joining(self) -> None:
        """Confirm a joining, or take it back. The own map of a robot that is lost or elsewhere says
        nothing of it.
        """
        own_maps = [] if self._is_one_lost or self._is_one_elsewhere else self._own_maps
        grid = self.grid
        shared = KnownPlaces.of(self.slam, grid)
        is_complete = not leads_to_unseen(
            grid, self.poses[0], self.config.policy.min_frontier
        ).any()
        objection = self._meeting.objection(own_maps, shared, is_complete=is_complete)
        if objection:
            self._part(objection)
        elif not self._meeting.is_open:
            self._alone = []
            self._believed = []

    def _part(self, reason: str) -> None:
        """Take a joining back: each robot goes on with the map that it has by itself."""
        self.earlier = Earlier(*(np.array(each) for each in zip(*self._believed, strict=True)))
        self.is_apart = True
        self._changes += 1
        self._meeting.has_parted(reason)
        self._follow_both()


def leads_to_unseen(grid: GridView, pose: FloatArray, size: int) -> BoolArray:
    """Frontier cells (rows, columns) that may lead to a place of its own, in groups of at least
    ``size``.

    They are reachable from a pose (3,), not beside a wall, where a gap between two beams looks like
    a frontier, and beside an unknown region into which a robot fits.
    """
    unknown = np.pad(grid.unknown, 1, constant_values=True)
    regions, _ = ndimage.label(unknown)
    is_large = (unknown & (np.bincount(regions.ravel()) >= _POCKET)[regions])[1:-1, 1:-1]
    free, _ = ndimage.label(grid.free)
    row, column = grid.cells(pose[None, :2])[0]
    own = free == free[row, column] if free[row, column] else grid.free
    beside_wall = ndimage.binary_dilation(grid.occupied, np.ones((3, 3), dtype=bool))
    leads = ndimage.binary_dilation(is_large, border_value=1) & own & ~beside_wall
    return frontier_cells(grid, size, ~leads)
