"""Mapper: SLAM, the occupancy grid and pure odometry, without a policy."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.default_preset import DEFAULT_PRESET
from limslam_agent.config.presets import AgentConfig, preset, self_calibrating
from limslam_agent.grid.occupancy import GridView, OccupancyGrid
from limslam_agent.renewal import Renewal
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.slam import Extraction, LineSlam
from limslam_agent.status.contradictions import KnownMap
from limslam_agent.status.monitor import Sight, StatusMonitor
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose
from limslam_env.interface import Observation, RobotSpec

RESTART_WITHIN = 600
"""Number of first steps within which a mapper starts again when the SLAM finds constant errors of the odometry."""

TOO_FAST = 300.0
"""A wheel that travels this many times as far in a step as the robot's largest wheel speed allows is refused.

A jump of the odometry by a few metres is no such error: it makes the status ``lost``.
"""


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


class Mapper:
    """Estimates poses and builds the map for one robot, or for several robots that share one map.

    Each step runs the SLAM, watches whether its estimate can be trusted, updates the occupancy grid from the new poses,
    and integrates pure odometry for comparison. The mapper chooses no actions: agents, log replay and the observation
    wrappers all use this class.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage. The preset ``graph`` by default.
    start_pose
        Pose where the robot starts (3,): x (m), y (m), heading (rad). The origin by default. For n robots (n, 3).

    Attributes
    ----------
    slam
        The SLAM, with landmarks, loop closures and everything else that it knows.
    odometry
        Pose of each robot by odometry alone (n, 3), corrected for the known bias in the settings. Read-only; each
        step makes a new array.
    longest_travel
        Longest travel of a wheel in one step that is accepted, m: 300 times what the robot's largest wheel speed allows
        in a control period. Set it higher if observations may be farther apart than 300 control periods.
    slam_ms
        Wall-clock time that the SLAM took in the latest step, without the grid and the odometry, ms.
    on_restart
        Called before all observations so far are processed again, if set. The SLAM is then another object.

    Raises
    ------
    ValueError
        If a start pose has another shape or is not finite.
    """

    def __init__(
        self, robot: RobotSpec, config: AgentConfig | None = None, start_pose: FloatArray | None = None
    ) -> None:
        self.robot, self.config = robot, config or preset(DEFAULT_PRESET)
        self.longest_travel = TOO_FAST * robot.max_wheel_speed * robot.control_period
        self.on_restart: Callable[[], None] | None = None
        self.reset(np.zeros(3) if start_pose is None else start_pose)

    def reset(self, start_pose: FloatArray) -> None:
        """Forget the map and start again at a known pose (3,), or for n robots at the poses (n, 3).

        Raises
        ------
        ValueError
            If a start pose has another shape or is not finite.
        """
        starts = np.array(start_pose, dtype=float, ndmin=2)
        if starts.ndim != 2 or starts.shape[0] == 0 or starts.shape[1] != 3:
            raise ValueError(f"a start pose has the shape (3,), or (n, 3) for n robots, not {np.shape(start_pose)}")
        if not np.isfinite(starts).all():
            raise ValueError(f"start poses must be finite, not {starts.tolist()}")
        self.slam = LineSlam(self.robot, self.config, starts)
        self._grid = OccupancyGrid(self.config.grid)
        self._starts, self._early = starts, list[tuple[Observation, ...]]()
        self._extraction: Extraction | None = None
        self._watch_anew()
        self._renewal = Renewal(self.slam, self.config)
        self.odometry = starts.copy()
        self.odometry.setflags(write=False)
        self.slam_ms = 0.0

    def step(self, *observations: Observation) -> None:
        """Process one observation of each robot.

        Raises
        ------
        TypeError
            If an observation is not a dictionary.
        ValueError
            If there is not one observation for each robot, an observation has the wrong shape or reports no motion, a
            wheel travels farther than ``longest_travel``, or the map grows beyond all bounds.
        """
        for front, observation in zip(self.slam.robots, observations, strict=False):  # the SLAM checks their number
            front.check(observation)
            self._check_travel(observation)
        may_restart, self.slam_ms = self.slam.may_calibrate, 0.0
        motions = self._process(observations)
        self.odometry = np.array([compose(*each) for each in zip(self.odometry, motions, strict=True)])
        self.odometry.setflags(write=False)
        if may_restart and len(self._early) < RESTART_WITHIN:
            copies = ({name: np.array(value) for name, value in seen.items()} for seen in observations)
            self._early.append(cast("tuple[Observation, ...]", tuple(copies)))
            if not self.slam.may_calibrate:
                self._restart()

    def finish(self) -> None:
        """Use the readings that are still buffered. Call this after the last step."""
        self.slam.finish()

    @property
    def belief(self) -> Belief:
        """The belief of the first robot."""
        return self.beliefs[0]

    @property
    def beliefs(self) -> list[Belief]:
        """The belief of each robot. Later steps do not change it."""
        slam, grid = self.slam, self.grid
        poses, covariances, segments, statuses = slam.poses, self.covariances, slam.segments, self.statuses
        return [
            Belief(
                poses[number], covariances[number], front.ranges, segments, grid, np.delete(poses, number, axis=0),
                status=statuses[number],
            )
            for number, front in enumerate(slam.robots)
        ]  # fmt: skip

    @property
    def statuses(self) -> list[Status]:
        """Whether the estimate of each robot can be trusted."""
        return [monitor.status for monitor in self._monitors]

    @property
    def covariances(self) -> FloatArray:
        """Covariance of each robot's pose (n, 3, 3): that of the filter, and more while the robot is lost."""
        covariances = self.slam.covariances
        for number, monitor in enumerate(self._monitors):
            if monitor.status.level == "lost":
                covariances[number] += monitor.added_covariance
        return covariances

    @property
    def grid(self) -> GridView:
        """The occupancy grid that all robots share. Later steps do not change it."""
        view = self._grid.view
        values = view.values.copy()
        values.setflags(write=False)
        return GridView(view.low, view.cell, values)

    def snapshot(self) -> MapSnapshot:
        """The map and the poses now. Later steps do not change the snapshot."""
        slam = self.slam
        return MapSnapshot(slam.poses, self.covariances, self.odometry, slam.landmarks, slam.segments, self.grid)

    def _check_travel(self, observation: Observation) -> None:
        """Refuse wheel travel that the robot cannot drive in a step. The SLAM checks its shape and refuses NaN."""
        if "wheels" not in observation:
            return
        farthest = float(np.abs(np.asarray(observation["wheels"], dtype=float)).max(initial=0.0))
        if math.isfinite(farthest) and farthest > self.longest_travel:
            limit = f"{self.robot.max_wheel_speed:g} m/s for {self.robot.control_period:g} s"
            raise ValueError(
                f"a wheel travels {farthest:.3g} m in one step, but the robot drives at most {limit}: wheels must be "
                "metres since the last observation, not ticks or millimetres"
            )

    def _process(self, observations: tuple[Observation, ...]) -> list[FloatArray]:
        """Pass one observation of each robot through the SLAM, the monitors and the grid; the reported motions."""
        begin = time.perf_counter()
        self.slam.step(*observations)
        self.slam_ms += 1e3 * (time.perf_counter() - begin)
        motions, poses = self.slam.increments, self.slam.poses
        extraction, self._extraction = self._extraction, self.slam.last_extraction
        for number, motion in enumerate(motions):
            self._watch(number, poses[number], motion, is_busy=extraction is not self._extraction)
        for pose, front in zip(poses, self.slam.robots, strict=True):
            self._grid.update(pose, self.robot, front.ranges, front.measured)
        self._renew(observations[0])
        return motions

    def _renew(self, observation: Observation) -> None:
        """Smooth the last minutes and renew the estimate, if that is due and possible."""
        if not self._renewal.is_possible or "wheels" not in observation:
            return
        self._renewal.note(observation)
        self._renewal.renew_if_due(self._monitors[0].status.level)

    def _restart(self) -> None:
        """Process all observations again, by a filter that has estimated the odometry's calibration from the start.

        The filter that has just found out that it needs a calibration has mapped the first metres with large errors of
        the heading, and the linear correction of its state leaves errors of second order.
        """
        if self.on_restart is not None:
            self.on_restart()
        listener, early = self.slam.on_association, self._early
        self.slam = LineSlam(self.robot, self_calibrating(self.config), self._starts)
        self.slam.on_association, self._grid, self._early = listener, OccupancyGrid(self.config.grid), []
        self._watch_anew()
        self._renewal = Renewal(self.slam, self.config)
        for observations in early:
            self._process(observations)

    def _watch_anew(self) -> None:
        """Begin to monitor the estimate of each robot."""
        self._monitors = [StatusMonitor(self.robot, self.config.status, self.config.range_std) for _ in self._starts]
        self._extraction = None

    def _watch(self, number: int, pose: FloatArray, motion: FloatArray, *, is_busy: bool) -> None:
        """Tell a robot's monitor the motion and the readings of this step, and let it compare them if that is due."""
        monitor, slam, front = self._monitors[number], self.slam, self.slam.robots[number]
        sight = Sight(pose, front.ranges, front.measured, motion)
        if monitor.observe(sight, is_busy=is_busy):
            monitor.check(slam.covariances[number], KnownMap(slam.segments, self._grid.view))
