"""Inputs for tests of the batch's stages: the plain estimator's state after a drive, and the same state in arrays."""

from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar, cast

import numpy as np
from support.drives import ROBOT, along, drive, room
from support.readings import Readings

from limslam_agent.config.presets import AgentConfig, ConsistentConfig, preset
from limslam_agent.slam.batch.compilation import entry
from limslam_agent.slam.batch.state import Spec, spec_of
from limslam_agent.slam.consistent.consistent import ConsistentEstimator
from limslam_agent.slam.consistent.pending_readings import BEAM, CLONE, RANGE, TAKEN_AT, WAITING
from limslam_agent.slam.slam import LineSlam
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


def waiting_readings(estimator: ConsistentEstimator, side: int) -> Readings:
    """The pending readings of a side of the only robot."""
    rows = estimator._pending[side, : estimator._fill[side, WAITING]]
    beams = rows[:, BEAM].astype(int)
    return Readings(
        rows[:, CLONE].astype(int), ROBOT.beam_origins[beams], ROBOT.beam_angles[beams], rows[:, RANGE],
        rows[:, [TAKEN_AT, BEAM]].astype(int),
    )  # fmt: skip
