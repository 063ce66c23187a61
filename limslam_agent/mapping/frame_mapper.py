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
from limslam_agent.slam.core.diagnostics import Extraction
from limslam_agent.slam.slam import Estimator, is_renewable
from limslam_agent.status.known_map import KnownMap
from limslam_agent.status.monitor import StatusMonitor
from limslam_agent.status.rays import Sight
from limslam_agent.status.status import LARGE_CORRECTION
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
        drawers: Sequence[ReadingDrawer] = (),
    ) -> None:
        self.slam = slam
        self.grid = grid
        self._config = config
        self.slam_ms = 0.0
        self.drawers = drawers or self._new_drawers()
        self._places = slam.sensor.places
        self.begin_anew()

    def begin_anew(self) -> None:
        """Begin to monitor the estimate of each robot, and a new stretch that can be smoothed."""
        self.reset_monitors()
        self._extraction: Extraction | None = None
        self.renewal = Renewal(self.slam, self._config, self.grid)

    def reset_monitors(self) -> None:
        """Forget all doubts about the estimates so far."""
        slam = self.slam
        self.monitors = [StatusMonitor(slam.robot, slam.sensor) for _ in slam.robots]

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
        before = self.slam.poses
        self.slam.step(*observations)
        self.slam_ms = _ms_since(begin)
        check_poses("the estimated pose", self.slam.poses)
        off = self.slam.poses - compose(before, np.array(self.slam.increments))
        if (
            np.hypot(off[:, 0], off[:, 1]).max() > LARGE_CORRECTION
        ):  # of one robot, and so the map of all has moved
            for monitor in self.monitors:
                monitor.forget_map()
        known = self.monitors[0].sensor
        sensor = self.slam.sensor
        if sensor.places != self._places:
            self._places, self.drawers = sensor.places, self._new_drawers()
            self.grid = self.renewal.draw_again()
        if sensor.turns != known.turns:
            # The beams point elsewhere than was known. A further correction may be due to readings
            # at a wrong place, and must not erase the doubts that these readings have raised.
            if known.turns:
                for monitor in self.monitors:
                    monitor.sensor = sensor
            else:
                self.reset_monitors()
        last = self._extraction
        self._extraction = self.slam.last_extraction
        for number in range(len(self.monitors)):
            self._watch(number, observations[number], is_busy=last is not self._extraction)
        for pose, front, drawer in zip(
            self.slam.poses, self.slam.robots, self.drawers, strict=True
        ):
            drawer.draw(self.grid, frame, pose, front.ranges, front.measured)
        return self._renew(observations[0], may_renew=may_renew)

    def renew_lost(self) -> bool:
        """Renew the estimate of a robot that has just been lost, if that explains its readings;
        whether it was done.
        """
        is_renewed = self.renewal.renew_lost()
        if is_renewed:
            self.grid = self.renewal.grid
            self.reset_monitors()
        return is_renewed

    def _new_drawers(self) -> Sequence[ReadingDrawer]:
        return [ReadingDrawer(self.slam.mounted) for _ in self.slam.robots]

    def _watch(self, number: int, observation: Observation, *, is_busy: bool) -> None:
        """Tell a robot's monitor the motion and the readings of this step, and let it compare them
        if that is due.
        """
        monitor = self.monitors[number]
        slam = self.slam
        front = self.slam.robots[number]
        sight = Sight.of(front, slam.poses[number], slam.increments[number], observation)
        if monitor.observe(sight, is_busy=is_busy):
            monitor.sensor = slam.sensor
            counts = self._config.free_space_counts
            known = KnownMap(slam.segments, self.grid.view, slam.sensor, free_space_counts=counts)
            monitor.check(slam.covariances[number], known)
            if monitor.broken is not None and is_renewable(slam):
                slam.leave_out(monitor.broken)

    def _renew(self, observation: Observation, *, may_renew: bool) -> bool:
        """Smooth the last minutes, if that is due; whether that has moved the path far."""
        renewal = self.renewal
        if not renewal.is_possible or "wheels" not in observation:
            return False
        begin = time.perf_counter()
        renewal.note(observation)
        is_renewed = may_renew and renewal.renew_if_due()
        if is_renewed:
            self.grid = renewal.grid
            if renewal.has_jumped:
                self.reset_monitors()
        self.slam_ms += _ms_since(begin)
        return is_renewed and renewal.has_jumped


def _ms_since(begin: float) -> float:
    """Wall-clock time since a reading of the clock (s), ms."""
    return 1e3 * (time.perf_counter() - begin)
