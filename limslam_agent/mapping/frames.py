"""Frames: SLAM, status monitors, occupancy grid and renewal in one frame after the other, and the
drives, which go through all of them.
"""

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from limslam_agent.config.presets import AgentConfig, self_calibrating
from limslam_agent.grid.drawing import ReadingDrawer
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.mapping.renewal import Renewal
from limslam_agent.record import Drive, Scan
from limslam_agent.slam.core.motion import OdometryCalibration
from limslam_agent.slam.slam import (
    ConsistentEstimator,
    Estimator,
    LineSlam,
    RangeSensor,
    is_renewable,
)
from limslam_agent.status.known_map import KnownMap
from limslam_agent.status.monitor import StatusMonitor
from limslam_agent.status.status import LARGE_CORRECTION
from limslam_env.geometry import FloatArray
from limslam_env.geometry.numbers import check_poses
from limslam_env.geometry.se2 import compose
from limslam_env.interface import Observation, RobotSpec


class Errors(NamedTuple):
    """What a SLAM has found out of odometry and sensor. The errors of a heading are a part of its
    state from the start.
    """

    sensor: RangeSensor  # the sensor as it is known now
    is_calibrated: list[bool]  # whether sizes of wheels and axle of each robot are corrected
    holds: list[list[float]]  # for how many steps the beams of each robot repeat their readings

    @classmethod
    def of(cls, slam: Estimator) -> "Errors":
        """The errors that a SLAM has found."""
        is_calibrated = [
            each is not None and isinstance(each[0], OdometryCalibration)
            for each in slam.odometry_calibrations
        ]
        return cls(slam.sensor, is_calibrated, [front.holds for front in slam.robots])


class Frames:
    """The present frame of one robot or several, with one map, and their drives.

    Each step runs the SLAM, watches whether its estimates can be trusted, draws the readings into
    the occupancy grid, and renews estimate and grid if that is due.

    Attributes
    ----------
    robot, config
        Body and beams, and settings.
    drives
        The recorded drive of each robot.
    slam, grid
        The SLAM and the occupancy grid of the present frame. A renewal replaces the grid.
    monitors
        The monitor of each robot's estimate.
    renewal
        What smooths the last minutes.
    frame
        Number of times that the frame of the poses has changed: a lost robot goes on in a local
        frame until it has found its place, and then in the earlier frame again. A renewal that
        moves the path far counts as well.
    map_number, own_map
        Number of the present map, and of the map outside of local frames. A local frame has a map
        of its own; in the earlier frame, the number is as before.
    slam_ms
        Wall-clock time that SLAM and renewal took in the latest step, without the grid, ms.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig, slam: Estimator) -> None:
        self.robot = robot
        self.config = config
        self.drives = [Drive() for _ in slam.robots]
        self.frame = self.map_number = self.own_map = self._maps = 0
        self.slam_ms = 0.0
        self.slam = slam
        self.grid = OccupancyGrid(config.grid)
        self._begin_drawing()
        self.begin_anew()

    def begin_anew(self) -> None:
        """Begin to monitor the estimate of each robot, and a new stretch that can be smoothed."""
        self.reset_monitors()
        self.renewal = Renewal(self.slam, self.config, self.grid, self.drives[0])

    def reset_monitors(self) -> None:
        """Forget all doubts about the estimates so far."""
        sensor = self.slam.sensor
        self.monitors = [StatusMonitor(self.robot, sensor, drive) for drive in self.drives]

    @property
    def followed(self) -> ConsistentEstimator:
        """The SLAM of a robot that finds its place again when it is lost."""
        slam = self.slam
        assert is_renewable(slam)  # noqa: S101 (no other one is followed)
        return slam

    def slam_at(self, starts: FloatArray) -> Estimator:
        """A SLAM with an empty map and robots at these poses, with what is known of odometry and
        sensor.
        """
        found = Errors.of(self.slam)
        config = self_calibrating(self.config) if any(found.is_calibrated) else self.config
        slam = LineSlam(self.robot, config, starts, found.sensor)
        for front, known in zip(slam.robots, self.slam.robots, strict=False):
            front.know_repeats(known)
            if found.sensor.delay:  # it cannot find them in travel that waits
                front.ticks = known.ticks
        return slam

    def use(self, slam: Estimator, grid: OccupancyGrid) -> None:
        """Go on with another SLAM and grid, in another frame, with what is known of odometry and
        sensor.
        """
        slam.learn_from(self.slam)
        self.slam = slam
        self.grid = grid
        self._places = slam.sensor.places
        self.begin_anew()
        self.frame += 1
        self.map_number = self.own_map

    def number_map(self, *, is_own: bool) -> None:
        """Give a new map its number. The robot never goes back to a map from before its own map."""
        self._maps += 1
        self.map_number = self._maps
        if is_own:
            self.own_map = self._maps

    def process(self, observations: Sequence[Observation]) -> bool:
        """Process one observation of each robot.

        Returns
        -------
        Whether a renewal in this step has moved the path far: plans and copies made before mean
        nothing in the moved map.

        Raises
        ------
        ValueError
            If the estimate has left all bounds.
        """
        self.slam_ms = 0.0
        self._map(observations)
        begin = time.perf_counter()
        is_renewed = self.renewal.renew_if_due()
        has_jumped = is_renewed and self.renewal.has_jumped
        if is_renewed:
            self.grid = self.renewal.grid
        if has_jumped:
            self.reset_monitors()
            self.frame += 1
        self.slam_ms += _ms_since(begin)
        return has_jumped

    def process_again(self, scans: Sequence[Scan]) -> None:
        """Process steps that were cut from the drive of the only robot, in the present frame."""
        for scan in scans:
            # The caller has later steps already, which a renewal would not move.
            self._map((scan.observation,))

    def renew_lost(self) -> bool:
        """Renew the estimate of a robot that has just been lost, if that explains its readings;
        whether it was done.
        """
        is_renewed = self.renewal.renew_lost()
        if is_renewed:
            self.grid = self.renewal.grid
            self.reset_monitors()
            self.frame += self.renewal.has_jumped
        return is_renewed

    def _begin_drawing(self) -> None:
        """Begin to find out how often the beams miss walls, with the beams at their places."""
        slam = self.slam
        self._places = slam.sensor.places
        self._drawers = [ReadingDrawer(slam.mounted) for _ in slam.robots]

    def _map(self, observations: Sequence[Observation]) -> None:
        """Estimate poses and map by one observation of each robot."""
        begin = time.perf_counter()
        slam = self.slam
        before = slam.poses
        last = slam.last_extraction
        slam.step(*observations)
        self.slam_ms += _ms_since(begin)
        check_poses("the estimated pose", slam.poses)
        self._follow_corrections(before)
        self._record(observations)
        for number in range(len(observations)):
            self._watch(number, is_busy=slam.last_extraction is not last)
        for pose, front, drawer in zip(slam.poses, slam.robots, self._drawers, strict=True):
            drawer.draw(self.grid, self.frame, pose, front.ranges, front.measured)
        if self.renewal.is_possible:
            self.renewal.note(observations[0])

    def _follow_corrections(self, before: FloatArray) -> None:
        """See to it that monitors and grid know what the SLAM has corrected since the poses
        ``before`` (n, 3): the map, or where the beams are and point.
        """
        sensor = self.slam.sensor
        off = self.slam.poses - compose(before, np.array(self.slam.increments))
        if np.hypot(off[:, 0], off[:, 1]).max() > LARGE_CORRECTION:
            for monitor in self.monitors:  # that of one robot has moved the map of all
                monitor.forget_map()
        if sensor.places != self._places:
            self._begin_drawing()
            self.grid = self.renewal.draw_again()
        known = self.monitors[0].sensor.turns
        if sensor.turns != known and not known:
            self.reset_monitors()
        elif sensor.turns != known:
            # A further correction may be due to readings at a wrong place, and must not erase the
            # doubts that these readings have raised.
            for monitor in self.monitors:
                monitor.sensor = sensor

    def _record(self, observations: Sequence[Observation]) -> None:
        """Record the step that the SLAM has just processed."""
        slam = self.slam
        estimates = zip(slam.poses, slam.increments, slam.covariances, strict=True)
        steps = zip(self.drives, slam.robots, estimates, observations, strict=True)
        for drive, front, (pose, motion, covariance), seen in steps:
            ranges = np.where(front.measured, front.reported, np.nan)
            drive.scans.append(Scan(pose, ranges, motion, seen, covariance.copy()))

    def _watch(self, number: int, *, is_busy: bool) -> None:
        """Let a robot's monitor see the latest step, and compare the readings if that is due."""
        monitor = self.monitors[number]
        slam = self.slam
        if monitor.observe(is_busy=is_busy):
            monitor.sensor = slam.sensor
            counts = self.config.free_space_counts
            known = KnownMap(slam.segments, self.grid.view, slam.sensor, free_space_counts=counts)
            monitor.check(slam.covariances[number], known)
            if monitor.broken is not None and is_renewable(slam):
                slam.leave_out(monitor.broken)


def _ms_since(begin: float) -> float:
    """Wall-clock time since a reading of the clock (s), ms."""
    return 1e3 * (time.perf_counter() - begin)
