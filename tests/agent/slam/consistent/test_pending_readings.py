"""Readings that wait: which beams are used, how far apart they are taken, and when a wall has ended."""

import math
from dataclasses import replace

import numpy as np
import pytest

from limslam_agent.config.consistent import ConsistentConfig, PendingReadingsConfig
from limslam_agent.slam.consistent.pending_readings import (
    BEAM,
    DRIVEN,
    DRIVEN_AT,
    SIDES,
    TURNED,
    TURNED_AT,
    WAITING,
    collect,
    has_ended,
    is_due,
    sides_of,
)
from limslam_agent.slam.consistent.step_settings import step_settings
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec, beams_on_rim

ROBOT = RobotSpec()  # beams at 90, 45, 15, -15, -45, -90 deg; left are 0 and 1, ahead 2 and 3, right 4 and 5
RANGES = np.array([0.4, 0.6, 1.0, 1.1, 0.7, 0.5])
FREE = ROBOT.max_ranges
CONFIG = PendingReadingsConfig(min_distance=0.05, min_turn=math.radians(5.0))


class _Drive:
    """A front end and the pending readings of the same robot; clones are numbered by the times that they are taken."""

    def __init__(self, robot: RobotSpec = ROBOT, config: PendingReadingsConfig = CONFIG, most: int = 8) -> None:
        sensor, estimator = RangeSensor(0.02), replace(ConsistentConfig(), pending=config)
        self.front, self.sides, self.taken = FrontEnd(robot), sides_of(robot, most), 0
        self.settings, self.travel = step_settings(estimator, sensor, 0.02), np.zeros(7)
        self.travel[[DRIVEN_AT, TURNED_AT]] = -math.inf
        self.pending, self.fill = np.zeros((3, 1000, 5)), np.zeros((3, 2), dtype=np.int64)

    def step(self, ranges: FloatArray | None, distance: float = 0.0, turn: float = 0.0) -> bool:
        """Move, read, and let what is wanted wait; whether anything was."""
        self.travel[DRIVEN] += abs(distance)
        self.travel[TURNED] += abs(turn)
        self.front.accept({} if ranges is None else {"ranges": ranges})
        wanted = is_due(self.travel, self.front.hits, self.sides, self.settings)
        if wanted:
            self.collect()
        return wanted

    def collect(self) -> None:
        front = self.front
        collect(
            self.travel, self.pending, self.fill, front.step, front.ranges, front.hits, self.sides, 10 + self.taken
        )  # fmt: skip
        self.taken += 1

    def rows(self, side: str) -> FloatArray:
        number = SIDES.index(side)
        return self.pending[number, : self.fill[number, WAITING]]

    def beams(self) -> dict[str, list[int]]:
        return {side: self.rows(side)[:, BEAM].astype(int).tolist() for side in SIDES}

    def has_ended(self, side: str, gap: float) -> bool:
        return has_ended(self.travel, self.fill, SIDES.index(side), gap)


def seen_by(*beams: int) -> FloatArray:
    """Ranges where only some beams see a wall."""
    return np.where(np.isin(np.arange(6), beams), RANGES, FREE)


# How far apart.


# Which beams.


@pytest.mark.parametrize(("most", "kept"), [(1, 1), (2, 2), (3, 3), (8, 8), (17, 17), (40, 40), (99, 40)])
def test_many_beams_of_a_side_are_thinned_out_evenly(most: int, kept: int) -> None:
    degrees = (*np.linspace(30.0, 150.0, 40).tolist(), -90.0)
    drive = _Drive(RobotSpec(beams=beams_on_rim(degrees, 0.10)), most=most)
    drive.step(np.full(41, 0.7))
    beams = drive.beams()
    assert len(beams["left"]) == len(set(beams["left"])) == kept
    # Sides do not share.
    assert (beams["right"], beams["none"]) == ([40], [])
    if kept > 1:
        assert (beams["left"][0], beams["left"][-1]) == (0, 39)
        steps = np.diff(beams["left"])
        assert steps.max() - steps.min() <= 1


@pytest.mark.parametrize("dead", [math.nan, math.inf, 1.5, 0.05, 0.0])
def test_a_dead_beam_adds_nothing_and_holds_up_no_other(dead: float) -> None:
    drive = _Drive()
    broken = RANGES.copy()
    broken[[0, 4, 5]] = dead
    assert [drive.step(broken, distance=0.06) for _ in range(3)] == [True] * 3
    assert drive.beams() == {"left": [1] * 3, "right": [], "none": [2, 3] * 3}
    assert all(np.isfinite(drive.rows(side)).all() for side in SIDES)
    assert not drive.has_ended("right", 0.1)


# The end of a wall.


def test_a_wall_has_ended_when_nothing_was_seen_of_it_for_the_gap_and_not_before() -> None:
    drive = _Drive()
    drive.step(RANGES)
    right_only = seen_by(4, 5)
    ended = []
    for _ in range(5):
        drive.step(right_only, distance=0.06)
        ended.append((drive.has_ended("left", 0.25), drive.has_ended("right", 0.25)))
    assert ended == [(False, False)] * 4 + [(True, False)]
