"""Whether the consistent estimator is as wrong as it believes to be: normalised errors of many laps of the square.

The normalised estimation error squared (NEES) of a pose, e^T P^-1 e, is chi-square of three degrees of freedom where
the filter is honest. Runs are independent of each other, the moments of one run are not: it is taken at four moments,
a quarter of a lap apart, and the band of the mean allows for what correlation is left between them.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import chi2
from support.drives import FOUR_BEAMS, LapLog, laps_of_square
from support.readings import Readings, clone_poses, hit_points, keep_clones, observe

from limslam_agent.config.presets import AgentConfig, ConsistentConfig, preset
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.limits import HUBER, ITERATIONS
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_agent.slam.core.motion import motion_from_wheels
from limslam_agent.slam.slam import LineSlam
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import NominalNoise, Observation, RobotSpec

DEGREES = 3
MOMENTS = 4


class Waiting(NamedTuple):
    """A reading that waits: its clone, step, beam and range (m), and the distance driven until then (m)."""

    clone: int
    step: int
    beam: int
    distance: float
    driven: float


class OracleEstimator:
    """The consistent estimator's filter, handed the true wall of each reading: no Hough, no gates, no loop to close.

    Readings of a wall wait beside clones until they span the length of a new landmark; then it is started from all of
    them, and later ones are used in batches.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig, start: FloatArray) -> None:
        self.robot, self.config, self.filter = robot, config, CloneEKF(start)
        settings = config.estimator
        assert isinstance(settings, ConsistentConfig)
        self._front, self._driven = FrontEnd(robot), 0.0
        self._min_length = settings.for_ranges(config.range_std).creation.min_length
        self._waiting: dict[int, list[Waiting]] = {}
        self._index: dict[int, int] = {}

    def step(self, observation: Observation, wall_seen: IntArray) -> None:
        self._front.accept(observation)
        wheels = np.asarray(observation["wheels"], dtype=float)
        motion = motion_from_wheels(wheels, self.robot, self.config.noise)
        self.filter.predict(motion.increment, motion.covariance)
        self._driven += float(np.hypot(*motion.increment[:2]))
        if self._front.hits.any():
            clone = self.filter.clone()
            for beam in np.flatnonzero(self._front.hits).tolist():
                reading = Waiting(clone, self._front.step, beam, float(self._front.ranges[beam]), self._driven)
                self._waiting.setdefault(int(wall_seen[beam]), []).append(reading)
        for wall in list(self._waiting):
            self._use(wall)
        wanted = {reading.clone for waiting in self._waiting.values() for reading in waiting}
        keep_clones(self.filter, wanted)

    def _use(self, wall: int) -> None:
        settings, waiting = self.config.estimator, self._waiting[wall]
        assert isinstance(settings, ConsistentConfig)
        oldest = self._driven - settings.pending.max_age
        self._waiting[wall] = waiting = [reading for reading in waiting if reading.driven >= oldest]
        if len(waiting) < settings.pending.batch:
            return
        readings = self._readings(waiting)
        if wall not in self._index:
            points = hit_points(clone_poses(self.filter, readings.clones), readings)
            middle = points.mean(axis=0)
            across = np.linalg.svd(points - middle, full_matrices=False)[2]
            if np.ptp((points - middle) @ across[0]) < self._min_length:
                return
            self._index[wall] = self.filter.add_line(math.atan2(across[1][1], across[1][0]), middle)
        observe(self.filter, readings, self._index[wall], self.config.range_std, ITERATIONS, HUBER)
        self._waiting[wall] = []

    def _readings(self, waiting: list[Waiting]) -> Readings:
        beams = np.array([reading.beam for reading in waiting])
        return Readings(
            np.array([reading.clone for reading in waiting]),
            self.robot.beam_origins[beams],
            self.robot.beam_angles[beams],
            np.array([reading.distance for reading in waiting]),
            np.array([[reading.step, reading.beam] for reading in waiting]),
        )


class Band(NamedTuple):
    """The 95 % band of a mean of normalised errors."""

    low: float
    high: float


def nees(pose: FloatArray, covariance: FloatArray, true: FloatArray) -> float:
    error = pose - true
    error[2] = wrap_angle(float(error[2]))
    return float(error @ np.linalg.solve(covariance, error))


def moments(log: LapLog) -> list[int]:
    """The steps at which errors are looked at: after a quarter of the way, a half, three quarters, and all of it."""
    return [round((len(log) - 1) * number / MOMENTS) for number in range(1, MOMENTS + 1)]


def with_oracle(log: LapLog, config: AgentConfig) -> list[float]:
    """Normalised errors (4,) with known association."""
    estimator, found = OracleEstimator(FOUR_BEAMS, config, log.poses[0]), []
    for step, observation in enumerate(log.observations):
        estimator.step(observation, log.wall_seen[step])
        if step in moments(log):
            found.append(nees(estimator.filter.pose, estimator.filter.joint_pose_covariance, log.poses[step]))
    return found


def with_real_association(log: LapLog, config: AgentConfig) -> list[float]:
    """Normalised errors (4,) of the whole mapping half."""
    slam, found = LineSlam(FOUR_BEAMS, config, log.poses[0]), []
    for step, observation in enumerate(log.observations):
        slam.step(observation)
        if step in moments(log):
            found.append(nees(slam.pose, slam.covariance, log.poses[step]))
    return found


def band_of_mean(values: FloatArray) -> Band:
    """The 95 % band of the mean of normalised errors (runs, moments) of an honest filter.

    Runs are independent. The variance of one run's mean over its moments is that of chi-square of three degrees of
    freedom, 6, times the mean correlation of the moments with each other; a chi-square with the mean and the variance
    of the mean of all has the quantiles.
    """
    runs, count = values.shape
    correlation = max(float(np.corrcoef(values.T).mean()), 1.0 / count) if count > 1 else 1.0
    freedom = runs * DEGREES / correlation
    low, high = chi2.ppf((0.025, 0.975), freedom) / freedom * DEGREES
    return Band(float(low), float(high))


def check(values: FloatArray, *, is_exact: bool) -> None:
    """Inside the band; without noise, sigma is taken for 5 mm and errors are below it: only its upper end counts."""
    band = band_of_mean(values)
    told = (
        f"mean {values.mean():.2f}, band {band.low:.2f} to {band.high:.2f}, at moments {values.mean(axis=0).round(2)}"
    )
    assert values.mean() < band.high, told
    assert is_exact or values.mean() > band.low, told


def runs(find: Callable[[LapLog, AgentConfig], list[float]], noise: float, count: int) -> FloatArray:
    """Normalised errors (count, 4), a run a seed."""
    config = preset("consistent", NominalNoise(noise))
    return np.array([find(laps_of_square(noise, seed), config) for seed in range(count)])


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.04])
def test_with_known_association_a_few_laps_are_as_wrong_as_believed(noise: float) -> None:
    check(runs(with_oracle, noise, 8), is_exact=noise == 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.04])
def test_with_known_association_laps_are_as_wrong_as_believed(noise: float) -> None:
    check(runs(with_oracle, noise, 30), is_exact=noise == 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "most"), [(0.0, 1.5), (0.02, 1.7), (0.04, 2.0)])
def test_with_real_association_laps_are_not_much_more_wrong_than_believed(noise: float, most: float) -> None:
    """The bars of the project for NEES / 3; at 4 cm the mean lies at the band's upper end."""
    values = runs(with_real_association, noise, 30)
    assert 0.5 < values.mean() / DEGREES < most
