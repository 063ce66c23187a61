"""The estimate while a log is replayed, by the filter of a mapper."""

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.places.revisions import PlaceHistory
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation


def is_handed_over(log: RecordedLog, config: AgentConfig, status: Status) -> bool:
    """Whether the online graph takes over from the filter with this status in the replay of a log."""
    return log.odometry is not None and config.smoothing is not None and status.level == "lost"


class FilterEstimate:
    """What the filter of a mapper believes after each event."""

    def __init__(self, mapper: Mapper) -> None:
        self._mapper = mapper
        self.handed_over: int | None = None
        """The event from which on the online graph gives the estimate. None if there is no such event."""
        self.job_ms = 0.0
        """Time that a job beside the step of the last event took, ms."""

    def step(self, observation: Observation) -> None:
        """Process the next event."""
        self._mapper.step(observation)

    @property
    def pose(self) -> FloatArray:
        """The pose (3,)."""
        return self._mapper.slam.pose

    @property
    def covariance(self) -> FloatArray:
        """Covariance (3, 3) of the pose."""
        return np.asarray(self._mapper.covariances[0])

    @property
    def odometry(self) -> FloatArray:
        """The pose (3,) by odometry alone."""
        return np.asarray(self._mapper.odometry[0])

    @property
    def status(self) -> Status:
        """Whether the pose can be trusted."""
        return self._mapper.statuses[0]

    @property
    def slam_ms(self) -> float:
        """Time that the step took, ms, without the job beside it."""
        return self._mapper.slam_ms

    @property
    def places(self) -> PlaceHistory:
        """What happened when the robot was lost."""
        return self._mapper.places

    @property
    def refused_readings(self) -> int:
        """Number of readings that were skipped."""
        return self._mapper.slam.refused_readings
