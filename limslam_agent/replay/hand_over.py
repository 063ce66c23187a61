"""The estimate while a log is replayed: by the filter, and by the online graph once the filter is lost.

The filter is far better than the graph where its model holds: walls are straight, beams are short, and odometry is as
noisy as stated. Once it is lost in a log of odometry poses, it does not find its place again. The online graph goes on
then. Up to that event, the graph has processed the same events beside the filter.
"""

import time

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.places.revisions import PlaceHistory
from limslam_agent.replay.filter_estimate import FilterEstimate, is_handed_over
from limslam_agent.replay.smoothing import log_data
from limslam_agent.replay.trust import MOST_STD
from limslam_agent.slam.core.motion import motion_of
from limslam_agent.slam.online_graph.online_graph import Beams, OnlineGraph
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose
from limslam_env.interface import Observation


class HandedOverEstimate(FilterEstimate):
    """What the filter believes until it is lost, and the online graph from then on.

    Parameters
    ----------
    mapper
        The mapper with the filter.
    log
        A log of odometry poses.
    config
        Settings of the graph.
    """

    def __init__(self, mapper: Mapper, log: RecordedLog, config: GraphConfig) -> None:
        super().__init__(mapper)
        assert log.odometry is not None  # noqa: S101 (the caller chooses by it)
        self._log, self._data = log, log_data(log, log.odometry, mapper.config.range_std)
        data = self._data
        self._graph = OnlineGraph(
            Beams(data.origins, data.angles, data.max_range, data.range_std), log.start_pose, config
        )
        self._number, self._odometry, self._ms, self._refused = -1, log.start_pose, 0.0, 0

    def step(self, observation: Observation) -> None:
        """Process the next event, by the filter as long as it is not lost, and by the graph."""
        if self.handed_over is None:
            super().step(observation)
            self._odometry, self._ms = super().odometry, super().slam_ms
        else:
            mapper = self._mapper
            motion = motion_of(observation, mapper.robot, mapper.config.noise, mapper.config.odometry)
            self._odometry, self._ms = compose(self._odometry, motion.increment), 0.0
            self._refused += int(np.count_nonzero(~(np.asarray(observation.get("ranges", ())) >= 0.0)))
        self._number += 1
        self._step_graph(self._number)
        if self.handed_over is None and is_handed_over(self._log, self._mapper.config, super().status):
            self.handed_over = self._number

    def _step_graph(self, number: int) -> None:
        begin, data = time.perf_counter(), self._data
        self._graph.step(float(data.time[number]), self._odometry, data.ranges[number], data.hit[number])
        self.job_ms = self._graph.job_ms
        self._ms += 1e3 * (time.perf_counter() - begin) - self.job_ms

    @property
    def pose(self) -> FloatArray:
        """The pose (3,)."""
        return super().pose if self.handed_over is None else self._graph.pose

    @property
    def covariance(self) -> FloatArray:
        """Covariance (3, 3) of the pose."""
        return super().covariance if self.handed_over is None else self._graph.covariance

    @property
    def odometry(self) -> FloatArray:
        """The pose (3,) by odometry alone."""
        return self._odometry

    @property
    def status(self) -> Status:
        """Whether the pose can be trusted: by the filter, or by the covariance of the online graph."""
        if self.handed_over is None:
            return super().status
        std = self._graph.position_std
        return Status("unsure", f"the position in the map may be {std:.1f} m off") if std > MOST_STD else Status()

    @property
    def slam_ms(self) -> float:
        """Time that the step took, ms, without the job beside it."""
        return self._ms

    @property
    def places(self) -> PlaceHistory:
        """What happened when the robot was lost. The online graph needs no earlier map."""
        return super().places if self.handed_over is None else PlaceHistory()

    @property
    def refused_readings(self) -> int:
        """Number of readings that were skipped."""
        return super().refused_readings + self._refused
