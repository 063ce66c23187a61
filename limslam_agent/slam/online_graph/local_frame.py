"""The local frame: the last metres of driving, smoothed with the errors of odometry that are known so far.

The constant errors of odometry are estimated in each window anew. A window alone says little about them, and successive
windows overlap. The information of all windows is therefore added up, each with the share of driving that is new in it,
and the sum is the prior of the next window.
"""

from dataclasses import dataclass, replace

import numpy as np

from limslam_agent.config.graph import GraphConfig, OdometryErrorConfig, SmoothingConfig
from limslam_agent.slam.graph.key_poses import (
    ERRORS,
    KeyPoses,
    LogData,
    Trajectory,
    choose_keys,
    corrected,
    event_poses,
    joined_bias,
    odometry_trajectory,
)
from limslam_agent.slam.graph.local_smoothing import cautious_equations, motion_covariances, smooth_locally
from limslam_agent.slam.least_squares.normal_equations import NormalEquations
from limslam_env.geometry import FloatArray, IntArray

_ITERATIONS = SmoothingConfig(link_iterations=3, line_iterations=5)
"""Fewer iterations than for a whole log: the errors of odometry are nearly known, and a window is short."""


@dataclass(frozen=True, eq=False)
class OdometryErrors:
    """What is known of the constant errors of odometry: their mean (5,) and its information matrix (5, 5)."""

    mean: FloatArray
    information: FloatArray

    @classmethod
    def unknown(cls, config: OdometryErrorConfig) -> "OdometryErrors":
        """The prior of the settings."""
        stds = config.bias_std, config.scale_std, config.turn_gain_std, config.delay_std, config.direction_std
        return cls(np.zeros(ERRORS), np.diag(np.array(stds) ** -2.0))

    def prior(self, config: OdometryErrorConfig) -> OdometryErrorConfig:
        """The settings for odometry that is corrected for the mean errors: only what is unknown remains."""
        turn, scale, gain, delay, direction = np.sqrt(np.diag(np.linalg.inv(self.information))).tolist()
        return replace(
            config, bias_std=turn, scale_std=scale, turn_gain_std=gain, delay_std=delay, direction_std=direction
        )

    def after(self, remaining: FloatArray, information: FloatArray, share: float) -> "OdometryErrors":
        """What is known after a window.

        Parameters
        ----------
        remaining, information
            Estimate (5,) of the errors that remained in the window after the correction, and its information (5, 5)
            with the prior of the window.
        share
            Weight of the window's own information.
        """
        prior = np.diag(1.0 / np.diag(np.linalg.inv(self.information)))
        total = self.information + share * (information - prior)
        found = np.asarray(share * np.linalg.solve(total, information @ remaining))
        return OdometryErrors(joined_bias(self.mean, found), 0.5 * (total + total.T))


@dataclass(frozen=True, eq=False)
class LocalFrame:
    """A smoothed window, in the frame of its first event.

    Attributes
    ----------
    keys, trajectory
        The key poses of the window and their trajectory, for the corrected odometry.
    poses
        Poses (n, 3) of all events of the window.
    errors
        What is known of the errors of odometry after the window.
    """

    keys: KeyPoses
    trajectory: Trajectory
    poses: FloatArray
    errors: OdometryErrors
    _equations: NormalEquations

    def covariances(self, keys: IntArray) -> FloatArray:
        """Covariances (k - 1, 3, 3) of the motions between successive key poses ``keys`` (k,)."""
        return motion_covariances(self._equations, self.trajectory.poses, keys)


def smooth_window(data: LogData, errors: OdometryErrors, config: GraphConfig, share: float) -> LocalFrame | None:
    """Smooth a window of driving; None if it holds no two key poses or no points.

    ``share`` is the share of driving in the window that was in no earlier window.
    """
    config = replace(config, motion=errors.prior(config.motion), smoothing=_ITERATIONS)
    data = corrected(data, errors.mean)
    keys = choose_keys(data, config.keys)
    if len(keys) < 2 or not len(keys.point_key):
        return None
    trajectory = smooth_locally(keys, odometry_trajectory(keys, np.zeros(3)), config, data.range_std)
    equations = cautious_equations(keys, trajectory, config, data.range_std)
    columns = 3 * len(keys) + np.arange(ERRORS)
    information = np.linalg.inv(equations.covariances(columns[None], np.eye(ERRORS)[None])[0])
    after = errors.after(trajectory.bias, information, share)
    return LocalFrame(keys, trajectory, event_poses(keys, trajectory), after, equations)
