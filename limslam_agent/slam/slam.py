"""LineSlam: where the robots are and where the walls are, from a few beams and odometry."""

from collections.abc import Callable

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.config.published import PublishedConfig
from limslam_agent.slam.consistent.consistent import ConsistentEstimator
from limslam_agent.slam.core.diagnostics import AssociationRecord, Closure, Extraction, Waiting
from limslam_agent.slam.core.estimator import Estimator
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.motion import Factors, Motion, motion_of, resized
from limslam_agent.slam.core.teammates import may_hit_others
from limslam_agent.slam.published.published import PublishedEstimator
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import Observation, RobotSpec

__all__ = ["AssociationRecord", "Extraction", "LineSlam"]


class LineSlam:
    """The mapping half of the agent, for one robot or for several that share a map.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage; they say which estimator is used.
    start_pose
        Where the robot begins (3,), m, m, rad: the origin of the map unless it is message. Of several robots (n, 3).

    Attributes
    ----------
    robots
        The front end of each robot.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig, start_pose: FloatArray | None = None) -> None:
        self.robot, self.config = robot, config
        start = np.atleast_2d(np.zeros(3) if start_pose is None else start_pose)
        self.robots = [FrontEnd(robot) for _ in start]
        self._estimator = _estimator_of(robot, config, start)

    def step(self, *observations: Observation) -> None:
        """Take in one observation of each robot: predict, leave out beams on teammates, and use the others.

        Raises
        ------
        ValueError
            If an observation has the wrong shape or reports no motion, or there is not one for each robot.
        """
        if len(observations) != len(self.robots):
            raise ValueError(f"{len(observations)} observations for {len(self.robots)} robots")
        # Nothing is taken in before all of it can be.
        for front, observation in zip(self.robots, observations, strict=True):
            front.check(observation)
        motions = [self._motion(number, seen) for number, seen in enumerate(observations)]
        for number, (observation, motion) in enumerate(zip(observations, motions, strict=True)):
            self.robots[number].accept(observation)
            self._estimator.predict(motion, number)
        if len(self.robots) > 1:
            self._drop_beams_on_robots()
        for number, motion in enumerate(motions):
            self._estimator.measure(number, self.robots[number], motion)

    def finish(self) -> None:
        """Use the points that still wait: nothing more will come."""
        self._estimator.finish(self.robots)

    @property
    def pose(self) -> FloatArray:
        """The believed pose of the first robot (3,), m, m, rad."""
        return np.asarray(self.poses[0])

    @property
    def poses(self) -> FloatArray:
        """The believed poses of all robots (n, 3)."""
        return self._estimator.poses

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the first robot's pose (3, 3)."""
        return np.asarray(self.covariances[0])

    @property
    def covariances(self) -> FloatArray:
        """Covariance of each robot's pose (n, 3, 3)."""
        return self._estimator.covariances

    @property
    def segments(self) -> FloatArray:
        """The walls of the map (N, 4), m, in the world."""
        return self._estimator.segments

    @property
    def landmarks(self) -> list[Landmark]:
        """The walls of the map with all that is known of them."""
        return self._estimator.landmarks

    @property
    def all_landmarks(self) -> list[Landmark]:
        """The walls of the map, and those that are provisional, by number."""
        return self._estimator.all_landmarks

    @property
    def closures(self) -> list[Closure]:
        """Pairs of landmarks that were taken for one wall, in order."""
        return self._estimator.closures

    @property
    def last_extraction(self) -> Extraction | None:
        """What was found in the latest scan; None before the first."""
        return self._estimator.last_extraction

    @property
    def on_association(self) -> Callable[[AssociationRecord], None] | None:
        """Message what became of each observed line, for those who keep a record."""
        return self._estimator.on_association

    @on_association.setter
    def on_association(self, listener: Callable[[AssociationRecord], None] | None) -> None:
        self._estimator.on_association = listener

    @property
    def waiting(self) -> list[Waiting]:
        """Points that wait to become lines."""
        return self._estimator.waiting(self.robots)

    @property
    def factors(self) -> tuple[Factors, FloatArray] | None:
        """What the first robot's odometry is wrong by, and the covariance (3, 3); None where that is not estimated."""
        return self._estimator.factors(0)

    @property
    def ranges(self) -> FloatArray:
        """The first robot's latest readings (n_beams,), m."""
        return self.robots[0].ranges

    @property
    def measured(self) -> BoolArray:
        """Which of the first robot's readings (n_beams,) are new, finite, and from no other robot."""
        return self.robots[0].measured

    @property
    def refused_readings(self) -> int:
        """How many readings were not finite, since the start."""
        return sum(front.refused_readings for front in self.robots)

    def _motion(self, number: int, observation: Observation) -> Motion:
        motion = motion_of(observation, self.robot, self.config.noise, self.config.odometry)
        known = self._estimator.factors(number)
        return resized(motion, self.robot.axle, known[0]) if known else motion

    def _drop_beams_on_robots(self) -> None:
        poses, covariance = self._estimator.poses, self._estimator.joint_covariance
        for number, front in enumerate(self.robots):
            ranges = np.where(front.measured, front.ranges, self.robot.max_ranges)
            front.drop(
                may_hit_others(
                    number, ranges, poses, covariance, self.robot, self.config.range_std, self.config.team
                )
            )  # fmt: skip


def _estimator_of(robot: RobotSpec, config: AgentConfig, start: FloatArray) -> Estimator:
    """The estimator that the settings choose by their type, for robots at start poses (n, 3)."""
    settings, std = config.estimator, config.range_std
    if isinstance(settings, PublishedConfig):
        return PublishedEstimator(robot, settings, std, start)
    return ConsistentEstimator(robot, settings, std, start)
