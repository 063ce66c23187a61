"""Renewal of the online estimate in long drives: the last minutes are smoothed while the robot
drives on.
"""

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.places.localisation import is_far
from limslam_agent.slam.consistent.limits import ONE_WALL_GATE
from limslam_agent.slam.consistent.map_state import MapState
from limslam_agent.slam.core.front_end import yaw_of
from limslam_agent.slam.core.motion import unknown_of
from limslam_agent.slam.slam import ConsistentEstimator, Estimator, is_renewable
from limslam_agent.status.known_map import DECIDED, DRIFT, KnownMap
from limslam_agent.status.rays import Sight, rays_of
from limslam_agent.status.status import LARGE_CORRECTION
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import compose, inverse, wrap_angle
from limslam_env.interface import Observation

LEAST_DRIVEN = 1.0
"""A robot that has hardly moved since the last renewal has nothing to smooth, m."""


class Renewal:
    """The observations of a robot since its estimate was last renewed, and the estimate at that
    time.

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
        Whether the last renewal has moved the path far.
    poses
        Poses (3,) of the robot in the steps of the last stretch that was renewed, by all its
        readings.
    covariances
        Covariances (3, 3) that the filter stated in these steps.
    is_possible
        Whether estimates of this SLAM can be renewed at all.
    """

    def __init__(self, slam: Estimator, config: AgentConfig, grid: OccupancyGrid) -> None:
        self._slam = cast(ConsistentEstimator, slam)  # others are not renewed
        self._config = config
        self.grid = grid
        self.has_jumped = False
        self._first_grid = grid
        self.poses = list[FloatArray]()
        self.covariances = list[FloatArray]()
        self._rows: list[
            tuple[FloatArray, FloatArray, BoolArray, FloatArray, FloatArray, float, list[float]]
        ] = []
        self._start: MapState | None = None
        self._associations = self._closures = self._first_step = (
            0  # numbers of those before the stretch
        )
        wanted = config.renewal is not None and config.run_smoothing is not None
        self.is_possible = wanted and is_renewable(slam)

    def note(self, observation: Observation) -> None:
        """Store an observation that the SLAM has just processed."""
        if self._start is None:
            self._begin()
        front = self._slam.robots[0]
        travel = np.asarray(observation["wheels"], dtype=float)
        self._rows.append(
            (
                travel,
                front.reported,
                front.measured,
                self._slam.pose,
                self._slam.covariance,
                yaw_of(observation),
                unknown_of(observation),
            )
        )

    def renew_if_due(self) -> bool:
        """Renew the estimate some minutes after the last time; whether it was renewed."""
        settings = self._config.renewal
        waited = len(self._rows) * self._slam.robot.control_period
        if settings is None or not self._rows or waited < settings.period:
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
        if not self.is_possible or not self._rows or not self._renew(is_expected=False):
            return False
        self._begin()
        return True

    def _renew(self, *, is_expected: bool = True) -> bool:
        """Renew the estimate and the grid, if the stretch can be smoothed and fits the map; whether
        it was done.
        """
        found = self._smoothed()
        if found is None:
            return False
        state, smoothed = found
        trial = self._slam.copied()
        trial.renew(copy.deepcopy(state))
        # The joining with the map from before moves the stretch as a whole.
        moved = compose(trial.pose, inverse(smoothed[-1]))
        poses = [compose(moved, pose) for pose in smoothed[1:]]
        grid = self._drawn(poses)
        believed = [row[3] for row in self._rows[1:]]
        # A renewal of a lost robot, or one that moves the pose far and by more than the filter
        # states, must explain the readings better. After any other one, they may fit worse, but not
        # clearly.
        gain = self._fit(trial, grid, poses) - self._fit(self._slam, self.grid, believed)
        if gain < (-DECIDED if is_expected and self._expects(trial.pose) else DECIDED):
            return False
        self._slam.renew(state)
        self.grid = grid
        self.poses = poses
        self.covariances = [row[4] for row in self._rows[1:]]
        self.has_jumped = bool(
            np.hypot(*(np.array(poses) - np.array(believed))[:, :2].T).max() > LARGE_CORRECTION
        )
        return True

    def _expects(self, pose: FloatArray) -> bool:
        """Whether a pose (3,) is near the present estimate, or no farther away than that states."""
        off = pose - self._slam.pose
        off[2] = wrap_angle(off[2])
        if not is_far(off, np.zeros(2), *DRIFT):
            return True
        return bool(off @ np.linalg.solve(self._slam.covariance, off) <= ONE_WALL_GATE)

    def draw_again(self) -> OccupancyGrid:
        """Draw the grid again since the stretch began, with the readings as they are corrected
        now.
        """
        if len(self._rows) > 1:
            self.grid = self._drawn([row[3] for row in self._rows[1:]])
        return self.grid

    def _drawn(self, poses: Sequence[FloatArray]) -> OccupancyGrid:
        """The grid from before the stretch, with the readings of the stretch at poses (3,)."""
        grid = self._first_grid.copied()
        _, ranges, measured, *_ = zip(*self._rows[1:], strict=True)
        grid.draw(
            self._slam.mounted,
            np.array(poses)[:, None],
            self._slam.sensor.corrected(np.array(ranges), self._slam.robot)[:, None],
            np.array(measured)[:, None],
        )
        return grid

    def _fit(self, slam: Estimator, grid: OccupancyGrid, poses: Sequence[FloatArray]) -> float:
        """How well the latest readings, at poses (3,), fit a map: by the likelihood ratio of their
        contradictions.

        A stretch that was joined wrongly with the map from before passes through walls of that map.
        """
        sensor = slam.sensor
        _, ranges, measured, *_ = zip(*self._rows[1:], strict=True)
        steps = [
            Sight(*each) for each in zip(poses, np.where(measured, ranges, np.nan), strict=True)
        ]
        rays = rays_of(steps, slam.robot, sensor)
        return KnownMap(slam.segments, grid.view, sensor).fit_here(rays).is_on_map

    def _begin(self) -> None:
        """Begin a new stretch at the present estimate, which the last observation led to, if there
        was one.
        """
        self._rows = self._rows[-1:]
        self._start, self._first_step = self._slam.map_state, self._slam.robots[0].step
        self._associations, self._closures = len(self._slam.associations), len(self._slam.closures)
        self._first_grid = self.grid.copied()

    def _smoothed(self) -> tuple[MapState, FloatArray] | None:
        """The state by all readings of the stretch, and its poses (t, 3); None if the stretch
        cannot be smoothed.
        """
        # The kernels of the smoother load numba, which takes time that short drives do not need.
        from limslam_agent.slam.line_graph.renewal import renewed
        from limslam_agent.slam.line_graph.smoother import FilteredRun

        wheels, ranges, usable, poses, covariances, yaw, unknown = (
            np.array(each) for each in zip(*self._rows, strict=True)
        )
        settings = self._config.run_smoothing
        if settings is not None and self._slam.odometry_calibrations[0] is not None:
            settings = replace(settings, calibrate="always")
        if self._start is None or settings is None or np.abs(wheels[1:]).sum() < 2.0 * LEAST_DRIVEN:
            return None
        # The estimate at the beginning knows the readings of the first row.
        usable[0] &= self._first_step == 0
        poses[0] = self._start.pose
        stretch = FilteredRun(
            robot=self._slam.robot,
            noise=self._config.noise,
            wheels=wheels[:, None],
            ranges=ranges[:, None],
            usable=usable[:, None],
            poses=poses[:, None],
            covariances=covariances[:, None],
            associations=self._slam.associations[self._associations :],
            closures=self._slam.closures[self._closures :],
            first_step=self._first_step,
            sensor=self._slam.sensor,
            ticks=self._slam.robots[0].ticks[None],
            yaw=yaw[:, None],
            wheel_variances=unknown[:, None],
        )
        return renewed(self._start, stretch, settings)
