"""A drive as it was recorded: what a robot observed and believed in each step.

It is recorded once. Whatever else looks back at a drive holds numbers of steps.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation

_FORGOTTEN = 200  # steps that are forgotten at once


class Scan(NamedTuple):
    """What a robot believed and read in one step. Each step makes one, so it has to be cheap."""

    pose: FloatArray  # estimated pose (3,), m and rad
    # Readings (n_beams,), m, as they were reported. They are NaN where there is no new reading.
    ranges: FloatArray
    # The motion (3,) that the odometry reports for this step, in the frame of the robot before it,
    # m and rad
    motion: FloatArray = np.zeros(3)
    observation: Observation = Observation()  # what the robot observed
    covariance: FloatArray = np.zeros((3, 3))  # of the pose, by the filter


@dataclass(eq=False)
class Drive:
    """Consecutive steps of a robot. ``begin`` is the number of the first one that is kept."""

    begin: int = 0
    scans: list[Scan] = field(default_factory=list)

    @property
    def end(self) -> int:
        """Number of the next step."""
        return self.begin + len(self.scans)

    def __getitem__(self, number: int) -> Scan:
        return self.scans[number - self.begin]

    def since(self, first: int) -> list[Scan]:
        """The steps from a number on, as far as they are kept."""
        return self.between(first, self.end)

    def between(self, first: int, last: int) -> list[Scan]:
        """The steps from a number to before another one, as far as they are kept."""
        return self.scans[max(first - self.begin, 0) : max(last - self.begin, 0)]

    def cut(self, first: int) -> list[Scan]:
        """Remove the steps from a number on, which are to be processed again."""
        scans = self.since(first)
        del self.scans[max(first - self.begin, 0) :]
        return scans

    def replace(self, first: int, scans: Sequence[Scan]) -> None:
        """Replace steps from a number on by others."""
        self.scans[first - self.begin : first - self.begin + len(scans)] = scans

    def forget_before(self, number: int) -> None:
        """Forget the steps before a number, many at once."""
        if number >= self.begin + _FORGOTTEN:
            del self.scans[: number - self.begin]
            self.begin = number
