"""Mapper: SLAM, the occupancy grid and pure odometry, without a policy.

What a step does within a frame is in :mod:`limslam_agent.mapping.frames`, and how a lost
robot changes frames in
:mod:`limslam_agent.mapping.recovery`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.config.presets import AgentConfig, preset
from limslam_agent.grid.occupancy import GridView, OccupancyGrid
from limslam_agent.mapping.frames import Errors, Frames
from limslam_agent.mapping.recovery import Recovery
from limslam_agent.places.other_map import NOT_YET_FOUND, Lookup
from limslam_agent.places.revisions import PlaceHistory, Unplaced
from limslam_agent.places.saved_map import SavedMap
from limslam_agent.record import Drive
from limslam_agent.slam.consistent.limits import RESTART_WITHIN
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_agent.slam.core.late_ranges import WaitingTravel, ahead
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.motion import check_travel, longest_travel
from limslam_agent.slam.slam import ConsistentEstimator, Estimator, LineSlam
from limslam_agent.status.chance import LIMIT
from limslam_agent.status.rays import wall_points
from limslam_agent.status.status import Status
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.numbers import check_poses, floats
from limslam_env.geometry.se2 import compose, inverse
from limslam_env.interface import Observation, RobotSpec
from limslam_env.messages import counted

MOST_RESTARTS = 6
"""A mapper begins again at most this often. Later estimates of the errors only act from then on."""

# ratio of the noise of ranges below which the mapper goes on: steps were weighed well enough
_SAME_NOISE = 1.5


@dataclass(frozen=True, eq=False)
class MapSnapshot:
    """The map and the poses at one moment. Later steps do not change a snapshot.

    Attributes
    ----------
    poses
        Estimated pose of each robot (n, 3) in the world frame: x (m), y (m), heading (rad).
    covariances
        Covariance of each estimated pose (n, 3, 3). It grows while a robot is lost.
    odometry
        Pose of each robot by odometry alone (n, 3).
    landmarks
        The walls of the map as lines with covariances.
    segments
        The walls of the map (N, 4) as x1, y1, x2, y2 in the world frame, m.
    grid
        Occupancy grid.

    Examples
    --------
    >>> import numpy as np
    >>> from limslam_agent import Mapper
    >>> from limslam_env import RobotSpec
    >>> mapper = Mapper(RobotSpec())
    >>> mapper.step({"ranges": np.full(6, 1.5), "wheels": np.zeros(2)})
    >>> snapshot = mapper.snapshot()
    >>> snapshot.poses.shape, snapshot.segments.shape
    ((1, 3), (0, 4))
    """

    poses: FloatArray
    covariances: FloatArray
    odometry: FloatArray
    landmarks: list[Landmark]
    segments: FloatArray
    grid: GridView

    @property
    def pose(self) -> FloatArray:
        """Pose of the first robot (3,)."""
        return np.asarray(self.poses[0])

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the first robot's pose (3, 3)."""
        return np.asarray(self.covariances[0])

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows."""
        from limslam_agent.output.drawing import map_png

        robots = {"est": [*self.poses[:, None]]}
        title = counted(len(self.segments), "wall")
        ellipses = [*self.covariances]
        return map_png(title, self.segments, robots, covariances=ellipses, grid=self.grid)


class Mapper:
    """Estimates poses and builds the map for one robot, or for several robots that share one map.

    Each step runs the SLAM, watches whether its estimate can be trusted, updates the occupancy grid
    from the new poses, and integrates pure odometry for comparison. The mapper chooses no actions:
    agents, log replay and the observation wrappers all use this class.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage. The preset ``graph`` by default.
    start_pose
        Pose where the robot starts (3,): x (m), y (m), heading (rad). The origin by default. For n
        robots (n, 3).
    prior_map
        The map of an earlier run (:func:`~limslam_agent.places.saved_map.read_saved_map`), in which
        the robot is at an unknown place. The robot begins in a frame of its own, at ``start_pose``.
        When its map fits into the earlier map in one place only, it goes on in the earlier map.

    Attributes
    ----------
    robot, config
        Body and beams, and settings.
    odometry
        Pose of each robot by odometry alone (n, 3), corrected for the known bias in the settings.
        Read-only; each step makes a new array.
    longest_travel
        Longest travel of a wheel in one step that is accepted, m: 300 times what the robot's
        largest wheel speed allows in a control period. Set it higher if observations may be farther
        apart than 300 control periods.
    is_apart
        Whether each robot maps in a frame of its own, since their relative starts are unknown.
    keeps_drives
        Whether all steps are kept, since somebody compares the drives of several mappers.
    prior_frame
        Pose (3,) of the robot's first frame in the frame of ``prior_map``; None until its place
        there is found.
    slam_ms
        Wall-clock time that the SLAM took in the latest step, without the grid and the odometry,
        ms.

    Raises
    ------
    ValueError
        If a start pose has another shape or is not finite, or an earlier map does not go with the
        other settings.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import limslam_env
    >>> from limslam_agent import Mapper, preset
    >>> env = gym.make("LimSlam-Env1-v0", sensor_noise=0.02).unwrapped
    >>> observation, info = env.reset(seed=0)
    >>> mapper = Mapper(env.robot, preset("consistent", env.nominal_noise), info["pose"])
    >>> for _ in range(50):
    ...     mapper.step(observation)
    ...     observation, *_ = env.step([0.5, 0.5])
    >>> mapper.finish()
    >>> mapper.belief.segments.shape[1]
    4
    """

    is_apart = False
    keeps_drives = False

    def __init__(
        self,
        robot: RobotSpec,
        config: AgentConfig | None = None,
        start_pose: FloatArray | None = None,
        *,
        prior_map: SavedMap | None = None,
    ) -> None:
        config = config or preset(DEFAULT_PRESET)
        if not isinstance(robot, RobotSpec) or not isinstance(config, AgentConfig):
            raise TypeError(
                "a mapper needs a RobotSpec and an AgentConfig, in this order, not "
                f"{type(robot).__name__} and {type(config).__name__}"
            )
        self.robot = robot
        self.config = config
        self._prior_map = prior_map
        self.longest_travel = longest_travel(robot)
        self.reset(np.zeros(3) if start_pose is None else start_pose)

    def reset(self, start_pose: FloatArray) -> None:
        """Forget the map and start again at a known pose (3,), or for n robots at the poses (n, 3).

        Raises
        ------
        ValueError
            If a start pose has another shape or is not finite.
        """
        poses = floats(start_pose)
        starts = np.atleast_2d(poses)
        if starts.ndim != 2 or starts.shape[0] == 0 or starts.shape[1] != 3:
            raise ValueError(
                f"a start pose has the shape (3,), or (n, 3) for n robots, not {poses.shape}"
            )
        check_poses("start poses", starts)
        self._starts = starts
        self._restarts = 0
        self._is_finished = False
        self.slam_ms = 0.0
        self._begin(LineSlam(self.robot, self.config, starts))

    def _begin(self, slam: Estimator) -> None:
        """Begin at the starts with an empty map."""
        self._frames = Frames(self.robot, self.config, slam)
        self._recovery = self._new_recovery()
        self._lookup: Lookup | None = None
        if self._prior_map is not None:
            self._lookup = Lookup(self._prior_map, self.robot, self.config, len(self._starts))
        self._unplaced: Unplaced | None = None
        self._first_steps = list[Sequence[Observation]]()
        self._errors = Errors.of(slam)
        self._waiting = WaitingTravel(len(self._starts), self.robot)
        self.prior_frame: FloatArray | None = None
        self._set_odometry(self._starts.copy())

    def step(self, *observations: Observation) -> None:
        """Process one observation of each robot.

        When the SLAM finds out in one of the first steps that odometry or sensor are not as
        specified, it has mapped the first metres with large errors of the heading, and the linear
        correction of its state leaves errors of second order. So all observations are processed
        again, by a filter that knows these errors from the start.

        Raises
        ------
        TypeError
            If an observation is not a dictionary.
        ValueError
            If there is not one observation for each robot, an observation has the wrong shape or
            reports no motion, a wheel travels farther than ``longest_travel``, or the map grows
            beyond all bounds.
        """
        for front, observation in zip(
            self.slam.robots, observations, strict=False
        ):  # the SLAM checks their number
            self.check(observation, front)
        spent = 0.0
        waiting: list[Sequence[Observation]] = [copied(observations)]
        while waiting:
            first_steps = self._first_steps
            frames = self._frames
            self._process(waiting.pop(0))
            spent += frames.slam_ms
            if self._first_steps is not first_steps:
                waiting[:0] = first_steps
        self.slam_ms = spent

    def _process(self, reported: Sequence[Observation]) -> None:
        """Process copies of the observations of a step, or begin again by what they have shown."""
        slam = self.slam
        observations = self._waiting.synchronous(reported, slam.sensor.delay)
        before = slam.last_extraction
        has_jumped = self._frames.process(observations)
        if isinstance(slam, ConsistentEstimator) and slam.last_extraction is not before:
            slam.correct_delay()
        self._set_odometry(np.array(list(map(compose, self.odometry, slam.increments))))
        if self._lookup is not None and self._lookup.is_open:
            self._lookup.drive(slam.increments[0])
        if self._is_to_restart(reported):
            self._restarts += 1
            self._begin(self._frames.slam_at(self._starts))
            return
        if self._recovery is not None and "wheels" in observations[0]:
            if has_jumped:
                self._recovery.move()
            self._recovery.follow()
        if self._lookup is not None and self._lookup.is_due:
            self._look_up(self._lookup)
        self._forget()

    def finish(self) -> None:
        """Use the readings that are still buffered. Call this after the last step; a second call
        does nothing.

        A robot that is still lost then gets the map back that it was lost from. There is no last
        search for its place: without further driving, a match would agree with the one before, and
        say nothing new.
        """
        if self._is_finished:
            return
        self._is_finished = True
        self.slam.finish()
        if self._lookup is not None and self._lookup.is_open:
            self._lookup.end("no match was good and unambiguous")
        if self._recovery is not None:
            self._unplaced = self._recovery.give_up()
            # The run may have ended because nothing is left to see, between two looks at the place.
            self._recovery.confirm()
        self.slam.finish()

    @property
    def slam(self) -> Estimator:
        """The SLAM, with landmarks, loop closures and everything else that it knows. Another frame
        has another SLAM.
        """
        return self._frames.slam

    @property
    def drive(self) -> Drive:
        """The recorded drive of the first robot."""
        return self._frames.drives[0]

    @property
    def frame(self) -> int:
        """Number of times that the frame of the poses has changed: a lost robot goes on in a local
        frame until it has found its place, and then in the earlier frame again. A renewal that
        moves the path far counts as well.
        """
        return self._frames.frame

    @property
    def map_number(self) -> int:
        """Number of the present map. A local frame has a map of its own; in the earlier frame, the
        number is as before.
        """
        return self._frames.map_number

    @property
    def belief(self) -> Belief:
        """The belief of the first robot."""
        return self.beliefs[0]

    @property
    def beliefs(self) -> list[Belief]:
        """The belief of each robot. Later steps do not change it."""
        slam = self.slam
        grid = self.grid
        poses = self.poses
        covariances = self.covariances
        segments = slam.segments
        statuses = self.statuses
        return [
            Belief(
                poses[number],
                covariances[number],
                front.ranges,
                segments,
                grid,
                np.delete(poses, number, axis=0),
                status=statuses[number],
                frame=self.frame,
                map_number=self.map_number,
                guesses=() if self._recovery is None else self._recovery.guesses,
            )
            for number, front in enumerate(slam.robots)
        ]

    @property
    def poses(self) -> FloatArray:
        """Estimated pose of each robot (n, 3), m and rad. Late ranges are those of an earlier
        pose.
        """
        poses = self.slam.poses
        travel = self._waiting.travel
        return ahead(poses, travel, self.robot.axle) if travel.any() else poses

    @property
    def dropped(self) -> list[BoolArray]:
        """The latest beams of each robot (n_beams,) that were ignored, since they may have hit a
        teammate.
        """
        return [front.dropped for front in self.slam.robots]

    @property
    def statuses(self) -> list[Status]:
        """Whether the estimate of each robot can be trusted."""
        found = [monitor.status for monitor in self._frames.monitors]
        found = found if self._recovery is None else [self._recovery.status(found[0])]
        is_open = self._lookup is not None and self._lookup.is_open
        return [NOT_YET_FOUND] if is_open and found[0].level == "ok" else found

    @property
    def places(self) -> PlaceHistory:
        """What happened when the robot was lost. Its unplaced map is known after :meth:`finish`."""
        recovery = self._recovery
        if recovery is None:
            return PlaceHistory()
        events = (() if self._lookup is None else self._lookup.events) + recovery.events
        is_suspicious = self._frames.monitors[0].mistaken >= LIMIT
        return PlaceHistory(events, self._unplaced, is_suspicious)

    @property
    def covariances(self) -> FloatArray:
        """Covariance of each robot's pose (n, 3, 3): that of the filter, and more while the robot
        is lost.
        """
        covariances = self.slam.covariances
        for number, monitor in enumerate(self._frames.monitors):
            if monitor.status.level == "lost":
                covariances[number] += monitor.added_covariance
        return (
            covariances if self._recovery is None else covariances + self._recovery.added_covariance
        )

    @property
    def grid(self) -> GridView:
        """The occupancy grid that all robots share. Later steps do not change it."""
        view = self._frames.grid.view
        values = view.values.copy()
        values.setflags(write=False)
        return GridView(view.low, view.cell, values)

    def snapshot(self) -> MapSnapshot:
        """The map and the poses now. Later steps do not change the snapshot."""
        slam = self.slam
        return MapSnapshot(
            self.poses, self.covariances, self.odometry, slam.landmarks, slam.segments, self.grid
        )

    def check(self, observation: Observation, front: FrontEnd | None = None) -> None:
        """Refuse an observation that :meth:`step` cannot process, of the first robot or of another
        one's front end.
        """
        (front or self.slam.robots[0]).check(observation)
        check_travel(observation, self.robot, self.longest_travel)

    def _is_to_restart(self, reported: Sequence[Observation]) -> bool:
        """Whether the SLAM has found errors of odometry or sensor in one of the first steps, which
        are kept.
        """
        if self.prior_frame is not None or len(self._first_steps) >= RESTART_WITHIN:
            return False
        slam = self.slam
        if not isinstance(slam, ConsistentEstimator):
            return False
        self._first_steps.append(reported)
        before = self._errors
        found = Errors.of(slam)
        reach = self.robot.reach
        ratio = found.sensor.usual_std(reach) / before.sensor.usual_std(reach)
        if max(ratio, 1.0 / ratio) < _SAME_NOISE:
            known = found.sensor._replace(std=before.sensor.std, growth=before.sensor.growth)
            found = found._replace(sensor=known)
        if found.sensor.broken != before.sensor.broken:
            self._restarts = 0  # what was found before may have been due to the broken beam
        if found.holds != before.holds:
            slam.forget_sensor()
            self._restarts = 0
            found = Errors.of(slam)
        self._errors = found
        return self._errors != before and self._restarts < MOST_RESTARTS

    def _new_recovery(self) -> Recovery | None:
        """What follows the estimate of a single robot, if it is to find its place again when it is
        lost.
        """
        is_followed = self.config.can_recover and len(self._starts) == 1
        return Recovery(self._frames) if is_followed else None

    def _look_up(self, lookup: Lookup) -> None:
        """Search the earlier map for the place, and go on in the earlier map if the place is
        clear.
        """
        if self._recovery is not None and self._recovery.events:
            lookup.end("the robot was lost before its place was found")
            return
        frames = self._frames
        found = lookup.seek(self.drive, self._starts[0], self.slam.sensor)
        if found is None:
            return
        self.prior_frame = compose(found.pose, inverse(self._starts[0]))
        slam = frames.slam_at(found.pose)
        assert isinstance(slam, ConsistentEstimator)  # noqa: S101 (others look nothing up)
        slam.know(lookup.saved.landmarks, lookup.saved.segments)
        slam.relocate(found.pose, found.covariance, ends=wall_points(found.rays))
        scans = self.drive.cut(0)
        frames.use(slam, OccupancyGrid.of(lookup.saved.grid, self.config.grid))
        frames.number_map(is_own=True)
        self._recovery = self._new_recovery()
        frames.process_again(scans)
        if self._recovery is not None:
            self._recovery.arrive(lookup.place, found.rays)
        self._set_odometry(compose(self.prior_frame, self.odometry))

    def _forget(self) -> None:
        """Forget the steps of the drives that nobody asks for any more."""
        if self.keeps_drives or (self._lookup is not None and self._lookup.is_open):
            return
        frames = self._frames
        for drive, monitor in zip(self._frames.drives, frames.monitors, strict=True):
            first = min(monitor.first, frames.renewal.first)
            if self._recovery is not None and "wheels" in drive.scans[-1].observation:
                first = min(first, self._recovery.begin)
            drive.forget_before(first)

    def _set_odometry(self, poses: FloatArray) -> None:
        self.odometry = poses
        self.odometry.setflags(write=False)


def copied(observations: Sequence[Observation]) -> tuple[Observation, ...]:
    """Copies of the observations of a step, which their sender cannot change any more."""
    copies = ({name: np.array(value) for name, value in seen.items()} for seen in observations)
    return cast("tuple[Observation, ...]", tuple(copies))
