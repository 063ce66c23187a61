"""Beams that report their readings late, found by the ranges that the map predicts."""

import numpy as np

from limslam_agent.config.status import LateBeamConfig
from limslam_agent.status.contradictions import ExpectedRanges
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec


class LateBeams:
    """Compares readings with the ranges that were expected a while ago.

    Parameters
    ----------
    robot
        Body and beams.
    config
        The delay that is tested.
    """

    def __init__(self, robot: RobotSpec, config: LateBeamConfig) -> None:
        self._delay = max(round(config.delay / robot.control_period), 1)
        self._limit = config.sigmas
        # The nearest step counts if the expected ranges of the right step are not known.
        slack = self._delay // 3
        self._offsets = sorted(range(-slack, slack + 1), key=abs)
        self._unknown = np.full(len(robot.beams), np.inf)
        self._expected: dict[int, FloatArray] = {}

    def evidence(
        self, steps: list[int], ranges: FloatArray, usable: BoolArray, predicted: ExpectedRanges
    ) -> FloatArray:
        """By how much the earlier expected ranges fit the readings of some steps better than the present ones.

        Parameters
        ----------
        steps
            Numbers of the m steps, in order.
        ranges, usable
            Readings (m, n_beams), m, and a mask of those that count.
        predicted
            The ranges that the map predicts for these steps.

        Returns
        -------
        evidence
            Difference of the sums of squared residuals (n_beams,), in variances.
        """
        self._expected |= dict(zip(steps, predicted.ranges, strict=True))
        before = np.array([self._earlier(step - self._delay) for step in steps])
        for step in [step for step in self._expected if step < steps[-1] - 2 * self._delay]:
            del self._expected[step]
        both = usable & np.isfinite(predicted.ranges) & np.isfinite(before)
        stds = np.where(both, predicted.stds, 1.0)
        now, then = (
            np.minimum(np.abs(np.where(both, ranges - each, 0.0)) / stds, self._limit) ** 2
            for each in (predicted.ranges, before)
        )
        return np.asarray((now - then).sum(axis=0))

    def _earlier(self, step: int) -> FloatArray:
        """The expected ranges (n_beams,) of a step, or of the nearest known one; infinite if none is near."""
        found = (self._expected.get(step + offset) for offset in self._offsets)
        return next((ranges for ranges in found if ranges is not None), self._unknown)
