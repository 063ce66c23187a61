"""FrameMapper: SLAM, status monitors, occupancy grid and renewal, as long as the robots stay in one
frame.
"""

import time
from collections.abc import Sequence

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.drawing import ReadingDrawer
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.mapping.renewal import Renewal
from limslam_agent.record import Drive, Scan
from limslam_agent.slam.slam import Estimator, is_renewable
from limslam_agent.status.known_map import KnownMap
from limslam_agent.status.monitor import StatusMonitor
from limslam_agent.status.status import LARGE_CORRECTION
from limslam_env.geometry import FloatArray
from limslam_env.geometry.numbers import check_poses
from limslam_env.geometry.se2 import compose
from limslam_env.interface import Observation


class FrameMapper:
    """Processes the observations of all robots in one frame, with one map.

    Each step runs the SLAM, watches whether its estimates can be trusted, draws the readings into
    the occupancy grid, and renews estimate and grid if that is due.

    Attributes
    ----------
    slam, grid
        The SLAM and the occupancy grid. A renewal replaces the grid.
    monitors
        The monitor of each robot's estimate.
    drawers
        What draws each robot's readings into the grid, and knows how often the beams miss walls.
        Those of an earlier frame may be given.
    renewal
        What smooths the last minutes.
    slam_ms
        Wall-clock time that SLAM and renewal took in the latest step, without the grid, ms.
    """

    def __init__(
        self,
        slam: Estimator,
        grid: OccupancyGrid,
        config: AgentConfig,
        drives: Sequence[Drive],
        drawers: Sequence[ReadingDrawer] = (),
    ) -> None:
        self.slam = slam
        self.grid = grid
        self._config = config
        self._drives = drives
        self.slam_ms = 0.0
        self.drawers = drawers or self._new_drawers()
        self._places = slam.sensor.places
        self.begin_anew()

    def begin_anew(self) -> None:
        """Begin to monitor the estimate of each robot, and a new stretch that can be smoothed."""
        self.reset_monitors()
        self.renewal = Renewal(self.slam, self._config, self.grid, self._drives[0])

    def reset_monitors(self) -> None:
        """Forget all doubts about the estimates so far."""
        slam = self.slam
        self.monitors = [StatusMonitor(slam.robot, slam.sensor, drive) for drive in self._drives]

    def process(
        self, observations: Sequence[Observation], frame: int, *, may_renew: bool = True
    ) -> bool:
        """Process one observation of each robot.

        Parameters
        ----------
        frame
            Number of the frame: readings that the drawers hold back are forgotten when it changes.
        may_renew
            Whether the estimate may be renewed in this step.

        Returns
        -------
        Whether a renewal in this step has moved the path far: plans and copies made before mean
        nothing in the moved map.

        Raises
        ------
        ValueError
            If the estimate has left all bounds.
        """
        begin = time.perf_counter()
        slam = self.slam
        before = slam.poses
        last = slam.last_extraction
        slam.step(*observations)
        self.slam_ms = _ms_since(begin)
        check_poses("the estimated pose", slam.poses)
        self._follow_corrections(before)
        self._record(observations)
        for number in range(len(observations)):
            self._watch(number, is_busy=slam.last_extraction is not last)
        for pose, front, drawer in zip(slam.poses, slam.robots, self.drawers, strict=True):
            drawer.draw(self.grid, frame, pose, front.ranges, front.measured)
        if not self.renewal.is_possible or "wheels" not in observations[0]:
            return False
        begin = time.perf_counter()
        self.renewal.note()
        is_renewed = may_renew and self.renewal.renew_if_due()
        if is_renewed:
            self._take_renewed(is_moved=self.renewal.has_jumped)
        self.slam_ms += _ms_since(begin)
        return is_renewed and self.renewal.has_jumped

    def renew_lost(self) -> bool:
        """Renew the estimate of a robot that has just been lost, if that explains its readings;
        whether it was done.
        """
        is_renewed = self.renewal.renew_lost()
        if is_renewed:
            self._take_renewed(is_moved=True)
        return is_renewed

    def _new_drawers(self) -> Sequence[ReadingDrawer]:
        return [ReadingDrawer(self.slam.mounted) for _ in self.slam.robots]

    def _take_renewed(self, *, is_moved: bool) -> None:
        self.grid = self.renewal.grid
        if is_moved:
            self.reset_monitors()

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
            self._places = sensor.places
            self.drawers = self._new_drawers()
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
        steps = zip(self._drives, slam.robots, estimates, observations, strict=True)
        for drive, front, (pose, motion, covariance), seen in steps:
            ranges = np.where(front.measured, front.reported, np.nan)
            drive.scans.append(Scan(pose, ranges, motion, seen, covariance.copy()))

    def _watch(self, number: int, *, is_busy: bool) -> None:
        """Let a robot's monitor see the latest step, and compare the readings if that is due."""
        monitor = self.monitors[number]
        slam = self.slam
        if monitor.observe(is_busy=is_busy):
            monitor.sensor = slam.sensor
            counts = self._config.free_space_counts
            known = KnownMap(slam.segments, self.grid.view, slam.sensor, free_space_counts=counts)
            monitor.check(slam.covariances[number], known)
            if monitor.broken is not None and is_renewable(slam):
                slam.leave_out(monitor.broken)


def _ms_since(begin: float) -> float:
    """Wall-clock time since a reading of the clock (s), ms."""
    return 1e3 * (time.perf_counter() - begin)
