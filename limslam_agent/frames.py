"""Frames: the frames in which robots map one after the other, and steps that are processed again in them."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from limslam_agent.config.presets import AgentConfig, self_calibrating
from limslam_agent.frame_mapper import FrameMapper
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.places.history import StepLog
from limslam_agent.slam.slam import LineSlam, RangeSensor
from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation, RobotSpec


class ProcessedAgain(NamedTuple):
    """Stored steps that were processed again.

    Attributes
    ----------
    poses, covariances
        Poses (t, n, 3), m and rad, and covariances (t, n, 3, 3) of the robots after each step.
    was_lost
        Whether a robot was lost after any of the steps.
    """

    poses: FloatArray
    covariances: FloatArray
    was_lost: bool


class Frames:
    """The present frame of one robot or several, with its SLAM and grid, and what is known in every frame.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage.

    Attributes
    ----------
    slam_ms
        Wall-clock time that the SLAM took in the latest step, without the grid and the odometry, ms.
    frame
        Number of times that the frame of the poses has changed: a lost robot goes on in a local frame until it has
        found its place, and then in the earlier frame again. A renewal that moves the path far counts as well.
    map_number
        Number of the present map. A local frame has a map of its own; in the earlier frame, the number is as before.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig) -> None:
        self.robot, self.config = robot, config

    def _begin(self, slam: LineSlam) -> None:
        """Begin with an empty map in the first frame."""
        self._present = FrameMapper(slam, OccupancyGrid(self.config.grid), self.config)
        self.frame = self.map_number = self._own_map = self._maps = 0
        self.slam_ms = 0.0

    @property
    def slam(self) -> LineSlam:
        """The SLAM, with landmarks, loop closures and everything else that it knows. Another frame has another SLAM."""
        return self._present.slam

    def _found(self) -> tuple[RangeSensor | None, list[bool]]:
        """The sensor as it is known now, and whether the odometry of each robot is corrected."""
        return self.slam.sensor, [found is not None for found in self.slam.odometry_calibrations]

    def _slam_at(self, starts: FloatArray) -> LineSlam:
        """A SLAM with an empty map and robots at these poses, with what is known of odometry and sensor."""
        sensor, is_calibrated = self._found()
        config = self_calibrating(self.config) if any(is_calibrated) else self.config
        return LineSlam(self.robot, config, starts, sensor)

    def _use(self, slam: LineSlam, grid: OccupancyGrid) -> None:
        """Go on with another SLAM and grid, in another frame, with what is known of odometry and sensor."""
        slam.learn_from(self.slam)
        self._present = FrameMapper(slam, grid, self.config, self._present.drawers)
        self.frame, self.map_number = self.frame + 1, self._own_map

    def _number_map(self, *, is_own: bool) -> None:
        """Give a new map its number. The robot never goes back to a map from before its own map."""
        self._maps += 1
        self.map_number, self._own_map = self._maps, self._maps if is_own else self._own_map

    def _process_again(self, steps: Iterable[Sequence[Observation]]) -> ProcessedAgain:
        """Process stored observations, one of each robot in each step, in the present frame."""
        poses, covariances, was_lost = list[FloatArray](), list[FloatArray](), False
        for observations in steps:
            # The caller has later steps already, which a renewal would not move.
            self._present.process(observations, self.frame, may_renew=False)
            self.slam_ms += self._present.slam_ms
            poses.append(self.slam.poses)
            covariances.append(self.slam.covariances)
            was_lost = was_lost or any(monitor.status.level == "lost" for monitor in self._present.monitors)
        count = len(self.slam.robots)
        return ProcessedAgain(
            np.array(poses).reshape(-1, count, 3), np.array(covariances).reshape(-1, count, 3, 3), was_lost
        )

    def _replay(self, log: StepLog, begin: int, end: int) -> ProcessedAgain:
        """Process the logged steps from ``begin`` to before ``end`` again, and log their new poses."""
        again = self._process_again((log[number].observation,) for number in range(begin, end))
        log.move(begin, again.poses[:, 0])
        return again
