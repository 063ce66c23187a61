"""Frames: the frames in which robots map one after the other, and what is known in all of them."""

from collections.abc import Sequence
from typing import NamedTuple

from limslam_agent.config.presets import AgentConfig, self_calibrating
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.mapping.frame_mapper import FrameMapper
from limslam_agent.record import Drive, Scan
from limslam_agent.slam.core.motion import OdometryCalibration
from limslam_agent.slam.slam import (
    ConsistentEstimator,
    Estimator,
    LineSlam,
    RangeSensor,
    is_renewable,
)
from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation, RobotSpec


class Errors(NamedTuple):
    """What a SLAM has found out of odometry and sensor. The errors of a heading are a part of its
    state from the start.
    """

    sensor: RangeSensor  # the sensor as it is known now
    is_calibrated: list[bool]  # whether sizes of wheels and axle of each robot are corrected
    holds: list[list[float]]  # for how many steps the beams of each robot repeat their readings

    @classmethod
    def of(cls, slam: Estimator) -> "Errors":
        """The errors that a SLAM has found."""
        is_calibrated = [
            each is not None and isinstance(each[0], OdometryCalibration)
            for each in slam.odometry_calibrations
        ]
        return cls(slam.sensor, is_calibrated, [front.holds for front in slam.robots])


class Frames:
    """The present frame of one robot or several, and their drives.

    Attributes
    ----------
    robot, config
        Body and beams, and settings.
    drives
        The recorded drive of each robot.
    present
        SLAM, grid and monitors of the present frame.
    frame
        Number of times that the frame of the poses has changed: a lost robot goes on in a local
        frame until it has found its place, and then in the earlier frame again. A renewal that
        moves the path far counts as well.
    map_number, own_map
        Number of the present map, and of the map outside of local frames. A local frame has a map
        of its own; in the earlier frame, the number is as before.
    slam_ms
        Wall-clock time that the SLAM took in the latest step, without the grid and the odometry,
        ms.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig, slam: Estimator) -> None:
        self.robot = robot
        self.config = config
        self.drives = [Drive() for _ in slam.robots]
        self.present = FrameMapper(slam, OccupancyGrid(config.grid), config, self.drives)
        self.frame = self.map_number = self.own_map = self._maps = 0
        self.slam_ms = 0.0

    @property
    def followed(self) -> ConsistentEstimator:
        """The SLAM of a robot that finds its place again when it is lost."""
        slam = self.present.slam
        assert is_renewable(slam)  # noqa: S101 (no other one is followed)
        return slam

    def slam_at(self, starts: FloatArray) -> Estimator:
        """A SLAM with an empty map and robots at these poses, with what is known of odometry and
        sensor.
        """
        present = self.present.slam
        found = Errors.of(present)
        config = self_calibrating(self.config) if any(found.is_calibrated) else self.config
        slam = LineSlam(self.robot, config, starts, found.sensor)
        for front, known in zip(slam.robots, present.robots, strict=False):
            front.know_repeats(known)
            if found.sensor.delay:  # it cannot find them in travel that waits
                front.ticks = known.ticks
        return slam

    def use(self, slam: Estimator, grid: OccupancyGrid) -> None:
        """Go on with another SLAM and grid, in another frame, with what is known of odometry and
        sensor.
        """
        slam.learn_from(self.present.slam)
        self.present = FrameMapper(slam, grid, self.config, self.drives, self.present.drawers)
        self.frame += 1
        self.map_number = self.own_map

    def number_map(self, *, is_own: bool) -> None:
        """Give a new map its number. The robot never goes back to a map from before its own map."""
        self._maps += 1
        self.map_number = self._maps
        if is_own:
            self.own_map = self._maps

    def process(self, observations: Sequence[Observation]) -> bool:
        """Process one observation of each robot; whether a renewal has moved the path far."""
        has_jumped = self.present.process(observations, self.frame)
        self.slam_ms = self.present.slam_ms
        self.frame += has_jumped
        return has_jumped

    def process_again(self, scans: Sequence[Scan]) -> None:
        """Process steps that were cut from the drive of the only robot, in the present frame."""
        for scan in scans:
            # The caller has later steps already, which a renewal would not move.
            self.present.process((scan.observation,), self.frame, may_renew=False)
            self.slam_ms += self.present.slam_ms
