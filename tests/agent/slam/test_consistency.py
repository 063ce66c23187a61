"""Whether the consistent estimator is as wrong as it believes to be: normalised errors of many laps of the square.

The normalised estimation error squared (NEES) of a pose, e^T P^-1 e, is chi-square of three degrees of freedom where
the filter is honest. Each run is looked at four times, a quarter of a lap apart.
"""

import numpy as np
import pytest
from support.drives import FOUR_BEAMS, laps_of_square

from limslam_agent import LineSlam, preset
from limslam_env import NominalNoise
from limslam_env.geometry import FloatArray, se2


def counted(wheels: FloatArray, tick: float, seed: int) -> FloatArray:
    """Travels (t, 2), m, as encoders with a tick, m, report them, which were somewhere within a tick at the start."""
    if not tick:
        return wheels
    totals = np.cumsum(wheels, axis=0) + np.random.default_rng(seed).uniform(0.0, tick, 2)
    return np.diff(np.floor(totals / tick) * tick, axis=0, prepend=np.zeros((1, 2)))


def mean_nees(noise: float, runs: int, tick: float = 0.0) -> float:
    """Mean NEES / 3 of some runs, one a seed."""
    found = []
    for seed in range(runs):
        log = laps_of_square(noise, seed)
        slam, moments = LineSlam(FOUR_BEAMS, preset("consistent", NominalNoise(noise)), log.poses[0]), len(log) // 4
        wheels = counted(np.array([seen["wheels"] for seen in log.observations]), tick, seed)
        for step, observation in enumerate(log.observations):
            slam.step({**observation, "wheels": wheels[step]})
            if step % moments == moments - 1:
                error = slam.pose - log.poses[step]
                error[2] = se2.wrap_angle(float(error[2]))
                found.append(error @ np.linalg.solve(slam.covariance, error) / 3.0)
    return float(np.mean(found))


def test_a_few_laps_are_about_as_wrong_as_believed() -> None:
    assert 0.3 < mean_nees(0.02, 8) < 2.2


def test_coarse_encoders_make_laps_about_as_wrong_as_believed() -> None:
    assert 0.2 < mean_nees(0.02, 8, tick=0.01) < 2.2


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "most"), [(0.0, 1.5), (0.02, 1.7), (0.04, 2.0)])
def test_laps_are_not_much_more_wrong_than_believed(noise: float, most: float) -> None:
    """The bars of the project; at 4 cm the mean lies at the upper end of the 95 % band of chi-square."""
    assert 0.5 < mean_nees(noise, 30) < most
