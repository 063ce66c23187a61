"""Inputs for tests of the batch's stages: the plain estimator's state after a drive, and the same state in arrays."""

from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar, cast

import numpy as np
from support.drives import ROBOT, along, drive, room
from support.readings import Readings

from limslam_agent.config.presets import AgentConfig, ConsistentConfig, preset
from limslam_agent.slam.batch.batch_slam import state_of
from limslam_agent.slam.batch.compilation import entry
from limslam_agent.slam.batch.state import (
    CLONES,
    LINES,
    NEXT_CLONE,
    Capacity,
    Filter,
    Spec,
    States,
    spec_of,
    states_for,
)
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.consistent import ConsistentEstimator
from limslam_agent.slam.consistent.pending_readings import BEAM, CLONE, RANGE, TAKEN_AT, WAITING
from limslam_agent.slam.core.ekf import POSE
from limslam_agent.slam.slam import LineSlam
from limslam_env.geometry import FloatArray
from limslam_env.interface import NominalNoise, Observation

Kernel = TypeVar("Kernel", bound=Callable[..., Any])
NOISE = 0.02
WALLS = np.vstack((room(-0.5, -0.5, 3.5, 2.5), room(0.5, 0.5, 2.5, 1.5)))
ROUTE = [(0.0, 0.0), (3.0, 0.0), (3.0, 2.0), (0.0, 2.0)]


def cached(kernel: Kernel) -> Kernel:
    """A compiled stage as Python calls it, with its machine code kept on disk, because compiling takes seconds."""
    return entry(cast(Kernel, cast(Any, kernel).py_func))


def config_of(noise: float = NOISE) -> AgentConfig:
    return preset("consistent", NominalNoise(noise))


def estimator_config() -> ConsistentConfig:
    config = config_of().estimator
    assert isinstance(config, ConsistentConfig)
    return config


def spec() -> Spec:
    return spec_of(ROBOT, config_of(), estimator_config())


@cache
def observations() -> list[Observation]:
    return drive(WALLS, np.zeros(3), along(ROUTE), noise=NOISE)[0]


def estimator_after(steps: int) -> ConsistentEstimator:
    """The plain estimator after so many steps of the drive."""
    slam = LineSlam(ROBOT, config_of(), np.zeros(3))
    for seen in observations()[:steps]:
        slam.step(seen)
    return cast(ConsistentEstimator, slam._estimator)


def state_from(estimator: ConsistentEstimator) -> States:
    """The state of one robot that equals the single estimator's."""
    state = state_of.py_func(states_for(ROBOT, estimator_config(), 1, Capacity()), 0)  # type: ignore[attr-defined]
    ekf, plain = state.filter, estimator.belief
    size = len(plain.x)
    ekf.x[:size], ekf.top[:, :size] = plain.x, plain.P[:POSE]
    for row in range(size):
        ekf.rest[row * (row + 1) // 2 : row * (row + 1) // 2 + row + 1] = plain.P[row, : row + 1]
    ekf.anchors[: plain.num_lines] = plain.anchors
    ekf.clones[: plain.num_clones] = plain._clones.numbers
    ekf.counts[LINES], ekf.counts[CLONES] = plain.num_lines, plain.num_clones
    ekf.counts[NEXT_CLONE] = plain._clones.next
    return state


def waiting_readings(estimator: ConsistentEstimator, side: int) -> Readings:
    """The pending readings of a side of the only robot."""
    rows = estimator._pending[side, : estimator._fill[side, WAITING]]
    beams = rows[:, BEAM].astype(int)
    return Readings(
        rows[:, CLONE].astype(int), ROBOT.beam_origins[beams], ROBOT.beam_angles[beams], rows[:, RANGE],
        rows[:, [TAKEN_AT, BEAM]].astype(int),
    )  # fmt: skip


def covariance_of(ekf: Filter) -> FloatArray:
    """P (n, n) of the state in arrays: the pose's rows are those of ``top``."""
    size = size_of(ekf)
    covariance = np.zeros((size, size))
    for row in range(POSE, size):
        base = row * (row + 1) // 2
        covariance[row, POSE : row + 1] = covariance[POSE : row + 1, row] = ekf.rest[base + POSE : base + row + 1]
    covariance[:POSE], covariance[:, :POSE] = ekf.top[:, :size], ekf.top[:, :size].T
    return covariance


def size_of(ekf: Filter) -> int:
    return int(POSE + 2 * ekf.counts[LINES] + POSE * ekf.counts[CLONES])


def assert_same(ekf: Filter, plain: CloneEKF, tolerance: float = 1e-9) -> None:
    """Both filters hold the same state, to a tolerance relative to the covariance's largest entry."""
    assert (ekf.counts[LINES], ekf.counts[CLONES]) == (plain.num_lines, plain.num_clones)
    size = size_of(ekf)
    np.testing.assert_allclose(ekf.x[:size], plain.x, rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(covariance_of(ekf), plain.P, rtol=0.0, atol=tolerance)
    np.testing.assert_array_equal(ekf.anchors[: plain.num_lines], plain.anchors)
    assert ekf.clones[: plain.num_clones].tolist() == plain._clones.numbers.tolist()
