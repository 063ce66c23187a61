"""What a replay has found: the estimate at each event, the map, and what is known at the end of the
log.
"""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.grid.occupancy import GridView
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.places.revisions import PlaceHistory
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.motion import Calibration, HeadingCalibration
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray, IntArray

if TYPE_CHECKING:
    from limslam_agent.slam.line_graph.smoother import FilteredRun
    from limslam_agent.slam.map_graph.key_poses import LogData
    from limslam_agent.slam.map_graph.stages import GraphResult


@dataclass(frozen=True, eq=False)
class SelfCalibration:
    """The systematic errors of the odometry that the filter has estimated during a replay.

    Attributes
    ----------
    factors, covariance
        Errors of wheels and axle, or of wheels and heading, and their covariance (3, 3).
    axle
        Axle of the robot's description, m.
    """

    factors: Calibration
    covariance: FloatArray
    axle: float

    @property
    def figures(self) -> dict[str, float]:
        """Values for ``result.json``: missing turn per metre, size of the wheels and of the axle,
        or size of the wheels, scale and drift of the heading, with standard deviations.
        """
        if isinstance(self.factors, HeadingCalibration):
            stds = HeadingCalibration(*np.sqrt(np.diag(self.covariance)).tolist())
            return {
                "self_calibration_scale": 1.0 + self.factors.size,
                "self_calibration_scale_std": stds.size,
                "self_calibration_yaw_scale": 1.0 + self.factors.scale,
                "self_calibration_yaw_scale_std": stds.scale,
                "self_calibration_yaw_drift_deg_per_s": math.degrees(self.factors.drift),
                "self_calibration_yaw_drift_std_deg_per_s": math.degrees(stds.drift),
            }
        turn = np.array([-1.0, 1.0, 0.0]) / self.axle
        size = np.array([0.5, 0.5, 0.0])
        values = np.array(self.factors)
        return {
            "self_calibration_turn_deg_per_m": math.degrees(turn @ values),
            "self_calibration_turn_std_deg_per_m": math.degrees(
                math.sqrt(turn @ self.covariance @ turn)
            ),
            "self_calibration_scale": 1.0 + float(size @ values),
            "self_calibration_scale_std": math.sqrt(size @ self.covariance @ size),
            "self_calibration_axle": 1.0 + self.factors.axle,
            "self_calibration_axle_std": math.sqrt(self.covariance[2, 2]),
        }

    @property
    def words(self) -> str:
        """One line for the screen."""
        if isinstance(self.factors, HeadingCalibration):
            scale, scale_std, _, _, drift, drift_std = self.figures.values()
            return (
                f"heading of the IMU: drift {drift:.3f} +- {drift_std:.3f} deg/s, scale of the "
                f"wheels {scale:.4f} +- {scale_std:.4f}, by the filter itself"
            )
        turn, turn_std, scale, scale_std, *_ = self.figures.values()
        return (
            f"{turn:.3f} +- {turn_std:.3f} deg/m, scale {scale:.4f} +- {scale_std:.4f}, by the "
            "filter itself"
        )


@dataclass(frozen=True, eq=False)
class Smoothed:
    """What is known at the end of a log."""

    poses: FloatArray  # (n, 3) of all events
    figures: dict[
        str, Any
    ]  # for ``result.json``: counts of loops, and what odometry was found to be wrong by
    # For ``loops.json``: each loop that was found, with the reason why it was kept or left out.
    # None from the line smoother, which finds loops by merging lines.
    loops: list[dict[str, Any]] | None
    seconds: float  # CPU time of the smoothing, s
    covariances: FloatArray | None = (
        None  # (n, 3, 3), of the poses; None from the graph of local maps
    )
    # Whether the smoothed path and map can be trusted. None from the graph, whose status is in
    # ``figures``.
    status: Status | None = None
    # What two logs are joined from: the graph of local maps, or the run of the line smoother
    basis: "GraphResult | FilteredRun | None" = field(default=None, repr=False)
    # What the graph of local maps has used of the log. None from the line smoother.
    data: "LogData | None" = field(default=None, repr=False)
    # For ``graph.json``: the times of the key poses and of the middles of the local maps. None from
    # the line smoother.
    graph: dict[str, list[float]] | None = None


@dataclass(frozen=True, eq=False)
class Replay:
    """The result of a replay, with a pose for every event of the log."""

    log: RecordedLog
    config: AgentConfig
    # estimated, odometry: poses (n, 3): the estimate, and odometry alone, corrected for its known
    # bias
    estimated: FloatArray
    odometry: FloatArray
    covariances: FloatArray  # (n, 3, 3), of the estimated poses
    # levels, status: status of the estimate at each event (n,), as an index into ``status.LEVELS``,
    # and at the end of the log
    levels: IntArray
    status: Status
    landmarks: list[Landmark]
    segments: FloatArray
    grid: GridView
    # number of readings that were skipped: no readings (NaN), and negative numbers
    refused_readings: int
    # Systematic odometry errors that the filter has estimated. None if this was not asked for.
    self_calibration: SelfCalibration | None
    # slam_ms, job_ms, wall_clock: cost of the SLAM for each event (n,), and of the jobs of the
    # online graph beside it (n,), ms; and cost of the whole replay, s
    slam_ms: FloatArray
    job_ms: FloatArray
    wall_clock: float
    places: PlaceHistory  # what happened when the robot was lost
    smoothed: Smoothed | None = (
        None  # what is known at the end of the log. None if the settings do not smooth it.
    )
    # The event from which on the online graph gives the estimate, since the filter is lost. None if
    # there is none.
    handed_over: int | None = None
    # By what each beam is turned to the left, and its standard deviation (n_beams, 2), rad; None if
    # no beam is
    beam_turns: FloatArray | None = None
    # How the sensor measures, as the filter has found out; None if it estimates nothing of the kind
    sensor: RangeSensor | None = None
