"""Renewal of the online estimate in long drives: the last minutes are smoothed while the robot
drives on.
"""

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.places.localisation import are_apart
from limslam_agent.record import Drive, Scan
from limslam_agent.slam.consistent.limits import ONE_WALL_GATE
from limslam_agent.slam.consistent.map_state import MapState
from limslam_agent.slam.core.front_end import yaw_of
from limslam_agent.slam.core.motion import unknown_of
from limslam_agent.slam.slam import ConsistentEstimator, Estimator, is_renewable
from limslam_agent.status.known_map import DECIDED, KnownMap
from limslam_agent.status.rays import rays_of
from limslam_agent.status.status import LARGE_CORRECTION
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose, inverse, wrap_angle
from limslam_env.interface import Observation

if TYPE_CHECKING:
    from limslam_agent.slam.line_graph.run import FilteredRun

LEAST_DRIVEN = 1.0
"""A robot that has hardly moved since the last renewal has nothing to smooth, m."""


def run_of(
    slam: Estimator, config: AgentConfig, scans: Sequence[Scan], **known: Any
) -> "FilteredRun":
    """Steps of a robot as the smoother takes them, with what else is ``known`` of the run."""
    # The kernels of the smoother load numba, which takes time that short drives do not need.
    from limslam_agent.slam.line_graph.run import FilteredRun

    seen = [scan.observation for scan in scans]
    ranges = np.array([scan.ranges for scan in scans])[:, None]
    of_slam: dict[str, Any] = {"associations": slam.associations, "closures": slam.closures}
    return FilteredRun(
        robot=slam.robot,
        noise=config.noise,
        wheels=np.array([each["wheels"] for each in seen], dtype=float)[:, None],
        ranges=ranges,
        usable=np.isfinite(ranges),
        poses=np.array([scan.pose for scan in scans])[:, None],
        covariances=np.array([scan.covariance for scan in scans])[:, None],
        sensor=slam.sensor,
        yaw=np.array([yaw_of(each) for each in seen])[:, None],
        wheel_variances=np.array([unknown_of(each) for each in seen])[:, None],
        **(of_slam | known),
    )


class Renewal:
    """The drive of a robot since its estimate was last renewed, and the estimate at that time.

    The filter cannot take back a wrong association, and a wrong one is only a matter of time. The
    smoother can. So the stretch since the last renewal is smoothed every few minutes, and early
    when a robot is lost. Then only the map remains of the stretch, so that memory and time do not
    grow with the length of a drive.

    The occupancy grid stays where it was drawn when the filter corrects poses and walls. A renewal
    draws it again.

    It begins after the first observation, with the grid that the caller draws.

    Attributes
    ----------
    grid
        The occupancy grid, in which the readings of a renewed stretch are drawn at the smoothed
        poses.
    has_jumped
        Whether the last renewal has moved the path far. The poses of the drive are moved then.
    is_possible
        Whether estimates of this SLAM can be renewed at all.
    """

    def __init__(
        self, slam: Estimator, config: AgentConfig, grid: OccupancyGrid, drive: Drive
    ) -> None:
        self._slam = cast(ConsistentEstimator, slam)  # others are not renewed
        self._config = config
        self._drive = drive
        self.grid = grid
        self.has_jumped = False
        self._first_grid = grid
        self._start: MapState | None = None
        # numbers of those before the stretch
        self._first = self._associations = self._closures = self._first_step = 0
        wanted = config.renewal is not None and config.run_smoothing is not None
        self.is_possible = wanted and is_renewable(slam)

    @property
    def first(self) -> int:
        """Number of the step with whose estimate the stretch begins; the next one without it."""
        return self._drive.end if self._start is None else self._first

    def note(self, observation: Observation) -> None:
        """Note that the SLAM has processed the latest step. A step by odometry ends the stretch,
        since the smoother takes wheels.
        """
        if "wheels" not in observation:
            self._start = None
        elif self._start is None:
            self._begin()

    def renew_if_due(self) -> bool:
        """Renew the estimate some minutes after the last time; whether it was renewed."""
        settings = self._config.renewal
        waited = (self._drive.end - self.first) * self._slam.robot.control_period
        if settings is None or self._start is None or waited < settings.period:
            return False
        is_renewed = self._renew()
        self._begin()
        return is_renewed

    def renew_lost(self) -> bool:
        """Renew the estimate of a robot that has just been lost, if that explains its readings;
        whether it was renewed.

        The smoother can take back a wrong association. The readings that contradict the estimate
        then no longer do so.
        """
        if not self.is_possible or self._start is None or not self._renew(is_expected=False):
            return False
        self._begin()
        return True

    def draw_again(self) -> OccupancyGrid:
        """Draw the grid again since the stretch began, with the readings as they are corrected
        now.
        """
        scans = self._scans
        if scans:
            self.grid = self._drawn(scans)
        return self.grid

    @property
    def _scans(self) -> list[Scan]:
        """The steps of the stretch, whose readings the estimate at its beginning does not know."""
        return self._drive.since(self.first + 1)

    def _renew(self, *, is_expected: bool = True) -> bool:
        """Renew the estimate and the grid, if the stretch can be smoothed and fits the map; whether
        it was done.
        """
        found = self._smoothed()
        if found is None:
            return False
        state, smoothed = found
        believed = self._scans
        trial = self._slam.copied()
        trial.renew(copy.deepcopy(state))
        # The joining with the map from before moves the stretch as a whole.
        moved = compose(trial.pose, inverse(smoothed[-1]))
        scans = [
            scan._replace(pose=compose(moved, pose))
            for scan, pose in zip(believed, smoothed[1:], strict=True)
        ]
        grid = self._drawn(scans)
        # A renewal of a lost robot, or one that moves the pose far and by more than the filter
        # states, must explain the readings better. After any other one, they may fit worse, but not
        # clearly.
        gain = self._fit(trial, grid, scans) - self._fit(self._slam, self.grid, believed)
        if gain < (-DECIDED if is_expected and self._expects(trial.pose) else DECIDED):
            return False
        self._slam.renew(state)
        self.grid = grid
        off = np.array([now.pose - then.pose for now, then in zip(scans, believed, strict=True)])
        self.has_jumped = bool(np.hypot(*off[:, :2].T).max() > LARGE_CORRECTION)
        if self.has_jumped or not is_expected:
            self._drive.replace(self.first + 1, scans)
        self._drive.scans[-1] = self._drive.scans[-1]._replace(pose=self._slam.pose)
        return True

    def _expects(self, pose: FloatArray) -> bool:
        """Whether a pose (3,) is near the present estimate, or no farther away than that states."""
        if not are_apart(pose, self._slam.pose, np.zeros(2)):
            return True
        off = pose - self._slam.pose
        off[2] = wrap_angle(off[2])
        return bool(off @ np.linalg.solve(self._slam.covariance, off) <= ONE_WALL_GATE)

    def _drawn(self, scans: Sequence[Scan]) -> OccupancyGrid:
        """The grid from before the stretch, with the readings of the stretch."""
        grid = self._first_grid.copied()
        slam = self._slam
        ranges = slam.sensor.corrected(np.array([scan.ranges for scan in scans]), slam.robot)
        poses = np.array([scan.pose for scan in scans])
        grid.draw(slam.mounted, poses[:, None], ranges[:, None], np.isfinite(ranges)[:, None])
        return grid

    def _fit(self, slam: Estimator, grid: OccupancyGrid, scans: Sequence[Scan]) -> float:
        """How well the latest readings fit a map: by the likelihood ratio of their contradictions.

        A stretch that was joined wrongly with the map from before passes through walls of that map.
        """
        sensor = slam.sensor
        rays = rays_of(scans, slam.robot, sensor)
        return KnownMap(slam.segments, grid.view, sensor).fit_here(rays).log_ratio_on_map

    def _begin(self) -> None:
        """Begin a new stretch at the present estimate, which the last observation led to."""
        self._first = self._drive.end - 1
        self._start = self._slam.map_state
        self._first_step = self._slam.robots[0].step
        self._associations = len(self._slam.associations)
        self._closures = len(self._slam.closures)
        self._first_grid = self.grid.copied()

    def _smoothed(self) -> tuple[MapState, FloatArray] | None:
        """The state by all readings of the stretch, and its poses (t, 3); None if the stretch
        cannot be smoothed.
        """
        from limslam_agent.slam.line_graph.renewal import renewed

        slam = self._slam
        settings = self._config.run_smoothing
        if self._start is None or settings is None:
            return None
        if slam.odometry_calibrations[0] is not None:
            settings = replace(settings, calibrate="always")
        stretch = run_of(
            slam,
            self._config,
            self._drive.since(self.first),
            associations=slam.associations[self._associations :],
            closures=slam.closures[self._closures :],
            first_step=self._first_step,
            ticks=slam.robots[0].ticks[None],
        )
        if np.abs(stretch.wheels[1:]).sum() < 2.0 * LEAST_DRIVEN:
            return None
        # The estimate at the beginning knows the readings of the first row.
        stretch.usable[0] &= self._first_step == 0
        stretch.poses[0] = self._start.pose
        return renewed(self._start, stretch, settings)
