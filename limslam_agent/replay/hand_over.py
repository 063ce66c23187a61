"""The estimate while a log is replayed: by the filter, and by the online graph once the filter is
lost or doubtful.

The filter is far better than the graph where its model holds: walls are straight, beams are short,
and odometry is as noisy as stated. Where its model does not hold, it is doubtful within metres. Its
path is bent soon, and once it is lost in a log of odometry poses, it does not find its place again.
The online graph goes on then. Up to that event, the graph has processed the same events beside the
filter.
"""

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from limslam_agent.logs.odometry_breaks import OdometryBreak, breaks_in_words
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.mapping.mapper import Mapper
from limslam_agent.places.revisions import PlaceHistory
from limslam_agent.slam.core.motion import motion_of
from limslam_agent.status.chance import chance_off, in_words, planar_covariance
from limslam_agent.status.status import LEVELS, Status, judged
from limslam_env.geometry.se2 import compose
from limslam_env.interface import Observation

if TYPE_CHECKING:
    from limslam_agent.slam.map_graph.online import OnlineGraph


ESTIMATE = np.dtype(
    [
        # the pose (3,), m, m, rad, its covariance, and the pose by odometry alone
        ("estimated", float, 3),
        ("covariances", float, (3, 3)),
        ("odometry", float, 3),
        ("levels", np.int64),  # the status, as an index into ``status.LEVELS``
        # time that the step took, ms, and that of a job beside it
        ("slam_ms", float),
        ("job_ms", float),
    ]
)
"""What is believed after an event."""


class LogEstimate:
    """What the filter of a mapper believes, and, in a log of poses, what the online graph believes
    once it is the better one.

    Attributes
    ----------
    handed_over
        The event from which on the online graph gives the estimate. None if there is no such event.
    """

    _graph: "OnlineGraph | None" = None

    def __init__(self, mapper: Mapper, log: RecordedLog) -> None:
        self._mapper = mapper
        self._log = log
        self._number = -1
        self._odometry = log.start_pose
        self._refused = 0
        self._breaks = {each.row: each for each in log.breaks}
        self._passed: OdometryBreak | None = None
        self.handed_over: int | None = None
        config = mapper.config
        if log.odometry is not None and config.smoothing is not None:
            # Importing the graph takes long.
            from limslam_agent.replay.smoothing import log_data
            from limslam_agent.slam.map_graph.online import OnlineGraph

            self._data = log_data(log, log.odometry, config.range_std)
            self._graph = OnlineGraph(self._data, log.start_pose, config.smoothing)

    @property
    def status(self) -> Status:
        """Whether the pose can be trusted: by the filter, or by the covariance of the online
        graph.
        """
        if self._graph is None or self.handed_over is None:
            found = self._mapper.statuses[0]
            if self._passed is None or found.level != "ok":
                return found
            return Status("unsure", breaks_in_words((self._passed,)))
        covariance = planar_covariance(self._graph.position_std)
        chance = float(chance_off(covariance))
        return judged(chance, in_words(chance, covariance, "the position in the map"))

    @property
    def places(self) -> PlaceHistory:
        """What happened when the robot was lost. The online graph needs no earlier map."""
        return self._mapper.places if self.handed_over is None else PlaceHistory()

    @property
    def refused_readings(self) -> int:
        """Number of readings that were skipped."""
        return self._mapper.slam.refused_readings + self._refused

    def step(self, observation: Observation) -> tuple[Any, ...]:
        """Process the next event, by the filter until the graph goes on, and by the graph.
        Returns the values of an ``ESTIMATE``.
        """
        mapper = self._mapper
        graph = self._graph
        spent = 0.0
        job = 0.0
        if self.handed_over is None:
            mapper.step(observation)
            self._odometry = np.asarray(mapper.odometry[0])
            spent = mapper.slam_ms
        else:
            motion = motion_of(
                observation, mapper.robot, mapper.config.noise, mapper.config.odometry
            )
            self._odometry = compose(self._odometry, motion.increment)
            self._refused += int(
                np.count_nonzero(~(np.asarray(observation.get("ranges", ())) >= 0.0))
            )
        self._number += 1
        passed = self._breaks.get(self._number)
        self._passed = passed or self._passed
        if graph is not None:
            begin = time.perf_counter()
            data = self._data
            number = self._number
            graph.step(
                float(data.time[number]),
                self._odometry,
                data.ranges[number],
                data.hit[number],
                None if passed is None else passed.stds,
            )
            job = graph.job_ms
            spent += 1e3 * (time.perf_counter() - begin) - job
            # The filter does not find its place again after a motion that nobody knows.
            if self.handed_over is None and (passed is not None or self._is_graph_better(graph)):
                self.handed_over = number
        if graph is None or self.handed_over is None:
            pose = mapper.slam.pose
            covariance = mapper.covariances[0]
        else:
            pose = graph.pose
            covariance = graph.covariance
        level = LEVELS.index(self.status.level)
        return pose, covariance, self._odometry, level, spent, job

    def _is_graph_better(self, graph: "OnlineGraph") -> bool:
        """Whether the filter is lost, or doubtful although the graph has a local map."""
        level = self._mapper.statuses[0].level
        return level == "lost" or (level == "unsure" and graph.places is not None)
