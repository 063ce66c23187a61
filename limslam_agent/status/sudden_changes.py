"""Readings that change so suddenly that the robot may have been carried away.

For each step, the readings are explained in two ways: the robot is still *here*, and each beam goes on along what it
saw before, or sweeps past an edge; or the robot is *elsewhere*, and each reading is that of a random place. The
evidence is the logarithm of the likelihood ratio of both, as far as the map does not explain the readings. A step with
some evidence is a *change*: the robot may have been carried away before it.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from limslam_agent.kernels.tables import RAY_BEAM
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.known_map import KnownMap
from limslam_agent.status.rays import LASTING, dropouts, moved, step_rays
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec

_BEGIN = 1.0  # evidence of a step that is a change
_EXPLAINED = 1.0  # evidence of a reading for the map: more than that of seeing nothing on free ground
_MAPS = 4


class Sight(NamedTuple):
    """What a robot believed and read in one step. Each step makes one, so it has to be cheap.

    Attributes
    ----------
    pose
        Estimated pose (3,), m and rad.
    ranges
        Readings (n_beams,), m. They are NaN where there is no new reading.
    increment
        The motion (3,) that the odometry reports for this step, in the frame of the robot before it, m and rad.
    """

    pose: FloatArray
    ranges: FloatArray
    increment: FloatArray


@dataclass(frozen=True, eq=False)
class Change:
    """A step before which a robot may have been carried away.

    Attributes
    ----------
    step
        Number of the step.
    known
        The map of that time, which a wrong pose cannot change any more.
    by_beam
        Logarithm of the likelihood ratio by the change of each reading (n_beams,).
    """

    step: int
    known: KnownMap
    by_beam: FloatArray

    @property
    def evidence(self) -> float:
        """Logarithm of the likelihood ratio by the changes of all readings."""
        return float(self.by_beam.sum())


class SuddenChanges:
    """Finds the changes of one robot's readings.

    Attributes
    ----------
    weighed
        Number of the latest step in which a change would have been noticed; -1 before the first one. What follows a
        reading says whether it was a dropout, so that the last steps wait.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._robot, self.weighed = robot, -1
        # The map at the latest calls. A wrong pose soon changes it.
        self._known: deque[tuple[int, KnownMap]] = deque(maxlen=_MAPS)

    def find(self, sights: Sequence[Sight], first: int, known: KnownMap, covariance: FloatArray) -> list[Change]:
        """The changes since the last call.

        Parameters
        ----------
        sights, first
            The latest steps, and the number of the first of them.
        known, covariance
            The map as it is now, and the covariance (3, 3) of the pose.
        """
        self._known.append((first + len(sights) - 1, known.frozen))
        begin = max(self.weighed + 1 - LASTING - first, 0)
        steps = sights[begin:]
        if len(steps) <= LASTING + 1:
            return []
        ranges = np.array([each.ranges for each in steps])
        usable = np.isfinite(ranges) & ~dropouts(ranges >= self._robot.too_far)
        motions = np.array([(np.hypot(*each.increment[:2]), abs(each.increment[2])) for each in steps])
        last = 1 - LASTING
        evidence = change_evidence(ranges[:last], usable[:last], motions[:last], self._robot, known.sensor)
        found = []
        for row in np.flatnonzero(evidence.sum(axis=1) > _BEGIN).tolist():
            number = first + begin + row + 2
            if number > self.weighed:
                map_then = next((each for at, each in reversed(self._known) if at <= number), self._known[0][1])
                is_explained = self._are_explained(steps[row + 2], usable[row + 2], map_then, covariance)
                by_beam = np.where(is_explained, np.minimum(evidence[row], 0.0), evidence[row])
                found.append(Change(number, map_then, by_beam))
        self.weighed = first + begin + len(steps) - LASTING
        return [each for each in found if each.evidence > _BEGIN]

    def _are_explained(self, sight: Sight, usable: BoolArray, known: KnownMap, covariance: FloatArray) -> BoolArray:
        """Which readings (n_beams,) ended where the map has a wall, so that their change says nothing."""
        ranges, sensor = np.where(usable, sight.ranges, np.nan), known.sensor
        rays = moved(step_rays(ranges, sensor.mounted(self._robot), sensor.bias), sight.pose)
        found: BoolArray = np.zeros(len(ranges), dtype=bool)
        found[rays[:, RAY_BEAM].astype(int)] = known.explained(rays, covariance).evidence > _EXPLAINED
        return found


def change_evidence(
    ranges: FloatArray, usable: BoolArray, motions: FloatArray, robot: RobotSpec, sensor: RangeSensor
) -> FloatArray:
    """The evidence (m, n_beams) of each reading that the robot was carried away before its step.

    It is the logarithm of the likelihood of the reading at a random place, less that of the reading after the one
    before. The likelihoods are mixtures: a beam goes on along what it saw, within the slope of walls that the motion
    allows for, or it meets an edge. Their constants, in `limslam_agent.kernels.readings`, are those of recorded
    explorations.

    Parameters
    ----------
    ranges, usable
        Readings of m + 2 steps (m + 2, n_beams), m, and a mask of those that count.
    motions
        Length and angle of the motion before each of the steps (m + 2, 2), m and rad, without signs.
    robot, sensor
        The beams, and how they measure.
    """
    from limslam_agent.kernels.readings import weigh_changes

    evidence = np.empty((len(ranges) - 2, ranges.shape[1]))
    weigh_changes(ranges, usable, motions, robot.beam_table, float(sensor.std), float(sensor.growth), evidence)
    return evidence
