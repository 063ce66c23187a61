"""The latest observations of a robot, and the step at which it was most likely carried away."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import cast

import numpy as np

from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.known_map import KnownMap
from limslam_agent.status.rays import Sight, step_rays
from limslam_agent.status.sudden_changes import change_evidence
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose, inverse
from limslam_env.interface import Observation, RobotSpec


def copied(observations: Sequence[Observation]) -> tuple[Observation, ...]:
    """Copies of the observations of a step, which their sender cannot change any more."""
    copies = ({name: np.array(value) for name, value in seen.items()} for seen in observations)
    return cast("tuple[Observation, ...]", tuple(copies))


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
    steps: list[Sight] = field(default_factory=list)

    @property
    def end(self) -> int:
        """Number of the next step."""
        return self.begin + len(self.steps)

    def __getitem__(self, number: int) -> Sight:
        return self.steps[number - self.begin]

    def since(self, number: int) -> list[Sight]:
        """The steps from a number on, as far as they are kept."""
        return self.steps[max(number - self.begin, 0) :]

    def before(self, number: int) -> list[Sight]:
        """The steps before a number, as far as they are kept."""
        return self.steps[: number - self.begin]

    def move(self, begin: int, poses: Sequence[FloatArray] | FloatArray) -> None:
        """Replace the poses of the steps from ``begin`` on by others (m, 3)."""
        for number, pose in enumerate(poses, begin - self.begin):
            self.steps[number] = self.steps[number]._replace(pose=pose)

    def forget_before(self, number: int) -> None:
        """Remove the steps before a number.

        The last two steps always stay: a local frame begins at the pose after the first one kept, with the step after.
        """
        gone = max(min(number, self.end - 2) - self.begin, 0)
        self.steps, self.begin = self.steps[gone:], self.begin + gone

    def driven_back(self, pose: FloatArray, number: int) -> FloatArray:
        """Poses (m, 3) after each step from the first one kept to the one before ``number``, by the odometry alone.

        The last of them is ``pose`` (3,).
        """
        poses = [pose]
        for step in reversed(self.steps[1 : number - self.begin]):
            poses.append(compose(poses[-1], inverse(step.motion)))
        return np.array(poses[::-1])


def carried_at(log: StepLog, placed: FloatArray, robot: RobotSpec, sensor: RangeSensor, place: KnownMap) -> int:
    """The first step after a robot was carried away: earlier readings fit the poses that were believed, later ones fit
    the poses by which it was placed again.

    Both are weighed by the evidence of the readings in the map, which is 0 on ground that the map does not have. There,
    no reading contradicts anything, and a step would be taken for one of the new place if only contradictions counted.
    The evidence of the change of the readings at the break counts, too.

    Parameters
    ----------
    log
        The steps. The robot was carried away after the first of them, and before the step after the last placed one.
    placed
        Poses (m, 3) of the first m steps of the log if the robot had been carried away before them.
    robot, sensor
        Body and beams as specified, and how ranges are measured.
    place
        The map of the time before.
    """
    steps, mounted = log.steps[: len(placed)], sensor.mounted(robot)
    # The steps before the break are explained by the poses that were believed, and the others by the placed ones.
    gained = [
        here.evidence - there.evidence
        for step, pose in zip(steps, placed, strict=True)
        for here, there in [place.weigh(np.array([step.pose, pose]), step_rays(step.ranges, mounted, sensor.bias))]
    ]
    totals = np.cumsum(gained)
    changing = log.steps[: len(placed) + 1]
    changes = change_evidence(
        np.array([step.ranges for step in changing]), np.array([step.motion for step in changing]), robot, sensor
    ).sum(axis=1)
    totals[1 : 1 + len(changes)] += changes
    # Of equally good steps, the last one is the nearest to the first doubt.
    return log.begin + len(totals) - int(totals[::-1].argmax())
