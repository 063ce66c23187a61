"""The latest observations of a robot, and the step at which it was most likely carried away."""

from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from limslam_agent.config.status import ContradictionConfig
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.slam import LineSlam
from limslam_agent.status.contradictions import expected_ranges
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose, inverse
from limslam_env.interface import Observation, RobotSpec

_WORST = 3.0  # standard deviations: largest residual that counts
_CHANGE = 0.10  # m: a reading seldom changes by more in a step in which the robot is not carried away


@dataclass(frozen=True, eq=False)
class LoggedStep:
    """One step of a robot.

    Attributes
    ----------
    observation
        What the robot observed.
    pose, motion
        The pose (3,) that was estimated, and the motion (3,) that the odometry reported, in the frame before it.
    ranges
        Readings (n_beams,), m. They are NaN where there is no new reading.
    """

    observation: Observation
    pose: FloatArray
    motion: FloatArray
    ranges: FloatArray

    @classmethod
    def of(cls, observation: Observation, slam: LineSlam, motion: FloatArray) -> "LoggedStep":
        """The step that a SLAM of one robot has just processed."""
        front = slam.robots[0]
        kept = cast("Observation", {name: np.array(value) for name, value in observation.items()})
        return cls(kept, slam.pose, motion, np.where(front.measured, front.ranges, np.nan))


@dataclass(eq=False)
class StepLog:
    """Consecutive steps of a robot.

    Attributes
    ----------
    begin
        Number of the first step that is kept.
    steps
        The steps.
    """

    begin: int = 0
    steps: list[LoggedStep] = field(default_factory=list)

    @property
    def end(self) -> int:
        """Number of the next step."""
        return self.begin + len(self.steps)

    def __getitem__(self, number: int) -> LoggedStep:
        return self.steps[number - self.begin]

    def since(self, number: int) -> list[LoggedStep]:
        """The steps from a number on, as far as they are kept."""
        return self.steps[max(number - self.begin, 0) :]

    def forget_before(self, number: int) -> list[LoggedStep]:
        """Remove the steps before a number; the removed steps.

        The last two steps always stay: a local frame begins at the pose after the first one kept, with the step after.
        """
        gone = self.steps[: max(min(number, self.end - 2) - self.begin, 0)]
        self.steps, self.begin = self.steps[len(gone) :], self.begin + len(gone)
        return gone

    @property
    def largest_correction(self) -> float:
        """By how much the estimator has moved a pose in one step beyond the reported motion, at most, m."""
        poses, motions = (np.array([getattr(step, name) for step in self.steps]) for name in ("pose", "motion"))
        off = poses[1:, :2] - compose(poses[:-1], motions[1:])[:, :2]
        return float(np.hypot(*off.T).max(initial=0.0))

    def put_before(self, number: int, pose: FloatArray) -> None:
        """Let the steps before ``number`` lead to a pose (3,) by the odometry alone."""
        for at, each in enumerate(self.driven_back(pose, number)):
            self.steps[at] = replace(self.steps[at], pose=each)

    def driven_back(self, pose: FloatArray, number: int) -> FloatArray:
        """Poses (m, 3) after each step from the first one kept to the one before ``number``, by the odometry alone.

        The last of them is ``pose`` (3,).
        """
        poses = [pose]
        for step in reversed(self.steps[1 : number - self.begin]):
            poses.append(compose(poses[-1], inverse(step.motion)))
        return np.array(poses[::-1])


def carried_at(
    log: StepLog,
    placed: FloatArray,
    robot: RobotSpec,
    segments: FloatArray,
    sensor: RangeSensor,
    config: ContradictionConfig,
) -> int:
    """The first step after a robot was carried away: earlier readings fit the poses that were believed, later ones fit
    the poses by which it was placed again.

    Parameters
    ----------
    log
        The steps. The robot was carried away after the first of them, and before the step after the last placed one.
    placed
        Poses (m, 3) of the first m steps of the log if the robot had been carried away before them.
    segments
        Walls of the map (k, 4), m.
    sensor
        How ranges are measured.
    """
    steps = log.steps[: len(placed)]
    ranges = np.array([step.ranges for step in steps])
    costs = [
        _misfits(poses, ranges, robot, segments, sensor, config)
        for poses in (np.array([step.pose for step in steps]), placed)
    ]
    # The steps before the break are explained by the first cost, and the others by the second one.
    totals = np.cumsum(costs[0] - costs[1])
    # Readings may change by more where the break is.
    change = _CHANGE + 5.0 * sensor.usual_std(float(robot.max_ranges.max()))
    changes = np.diff([step.ranges for step in log.steps[: len(placed) + 1]], axis=0) / change
    saved = np.minimum(np.abs(np.nan_to_num(changes)), _WORST) ** 2
    totals[: len(saved)] -= saved.sum(axis=1)
    # Of equally good steps, the last one is the nearest to the first doubt.
    return log.begin + len(totals) - int(totals[::-1].argmin())


def _misfits(
    poses: FloatArray,
    ranges: FloatArray,
    robot: RobotSpec,
    segments: FloatArray,
    sensor: RangeSensor,
    config: ContradictionConfig,
) -> FloatArray:
    """Sum of the squared residuals (m,) of the readings (m, n_beams) of each pose (m, 3) that pass through walls.

    Other readings speak against no pose: the map does not have all walls.
    """
    slack = np.diag([config.slack**2, config.slack**2, 0.0])
    expected = expected_ranges(robot, poses, slack, segments, sensor, config)
    has_wall = np.isfinite(expected.ranges)
    seen = np.minimum(ranges, robot.max_ranges)
    beyond = (seen - np.where(has_wall, expected.ranges, np.inf)) / np.where(has_wall, expected.stds, 1.0)
    return np.asarray((np.clip(np.nan_to_num(beyond, nan=0.0, neginf=0.0), 0.0, _WORST) ** 2).sum(axis=1))
