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
from limslam_env.messages import counted

if TYPE_CHECKING:
    from limslam_agent.slam.line_graph.run import FilteredRun
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
        degrees = math.degrees(1.0)
        if isinstance(self.factors, HeadingCalibration):
            forms = ("scale{}", "yaw_scale{}", "yaw_drift{}_deg_per_s")
            usual = (1.0, 1.0, 0.0)
            by_factors = np.diag([1.0, 1.0, degrees])
        else:
            forms = ("turn{}_deg_per_m", "scale{}", "axle{}")
            usual = (0.0, 1.0, 1.0)
            turn = degrees / self.axle
            by_factors = np.array([[-turn, turn, 0.0], [0.5, 0.5, 0.0], [0.0, 0.0, 1.0]])
        values = usual + by_factors @ np.array(self.factors)
        stds = np.sqrt(np.diag(by_factors @ self.covariance @ by_factors.T))
        figures = {}
        for form, value, std in zip(forms, values.tolist(), stds.tolist(), strict=True):
            figures[f"self_calibration_{form.format('')}"] = value
            figures[f"self_calibration_{form.format('_std')}"] = std
        return figures

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
    # For ``result.json``: counts of loops, and what odometry was found to be wrong by
    figures: dict[str, Any]
    seconds: float  # CPU time of the smoothing, s
    # What two logs are joined from: the graph of local maps, or the run of the line smoother
    basis: "GraphResult | FilteredRun" = field(repr=False)
    # Of the line smoother: covariances of the poses (n, 3, 3), and whether the smoothed path and
    # map can be trusted. The status of the graph is in ``figures``.
    covariances: FloatArray | None = None
    status: Status | None = None
    # Of the graph of local maps: what it has used of the log, and by their names files of JSON:
    # each loop with the reason why it was kept or left out, and the times of the key poses and of
    # the middles of the local maps. The line smoother finds loops by merging lines.
    data: "LogData | None" = field(default=None, repr=False)
    tables: dict[str, Any] = field(default_factory=dict)


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
    # What is known at the end of the log. None if the settings do not smooth it.
    smoothed: Smoothed | None = None
    # The event from which on the online graph gives the estimate, since the filter is lost or
    # doubtful. None if there is none.
    handed_over: int | None = None
    # By what each beam is turned to the left, and its standard deviation (n_beams, 2), rad; None if
    # no beam is
    beam_turns: FloatArray | None = None
    # How the sensor measures, as the filter has found out; None if it estimates nothing of the kind
    sensor: RangeSensor | None = None

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows."""
        from limslam_agent.output.drawing import map_png

        true = self.log.true_pose
        paths = {
            "est": [self.estimated],
            "odometry": [self.odometry],
            "true": [] if true is None else [true],
            "smoothed": [] if self.smoothed is None else [self.smoothed.poses],
        }
        title = f"{counted(len(self.segments), 'wall')}, {self.config.preset}"
        return map_png(title, self.segments, paths, grid=self.grid, remark=self.status.remark)
