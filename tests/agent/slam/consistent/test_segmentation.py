"""Straight pieces: a wall stays one whatever odometry does; corners, curves and loose ends are cut.

The robot drives past obstacles that it sees to its left; what it believes of its way is bent by its wheels' noise.
"""

import math
from collections import Counter
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from support.readings import Readings, clone_poses, hit_points, points_of

from limslam_agent.kernels.tables import ANGLE_STD, EXTENT, MIDDLE_X, MIDDLE_Y, THETA
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.clone_filter import straight_segments
from limslam_agent.slam.consistent.pending_readings import places_of
from limslam_agent.slam.core.line_fit import fit_line
from limslam_agent.slam.core.motion import motion_from_wheels
from limslam_env import NominalNoise, RobotSpec
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.se2 import compose

ROBOT = RobotSpec()
LEFT = [0, 1]  # the beams at 90 and 45 deg
STEP = 0.02  # m driven between two readings
NOISES = (0.0, 0.02, 0.04)


class WallSegment(NamedTuple):
    """A straight piece: its readings, direction, middle, end points, length, and the direction's standard deviation."""

    members: IntArray
    theta: float
    middle: FloatArray
    points: FloatArray
    length: float
    angle_std: float


class Drive(NamedTuple):
    """What is believed after a drive, what was read, and where the beams truly ended (n, 2), m."""

    belief: CloneEKF
    readings: Readings
    hits: FloatArray
    std: float

    @property
    def points(self) -> FloatArray:
        """Where they are believed to have ended (n, 2), m."""
        return hit_points(clone_poses(self.belief, self.readings.clones), self.readings)

    def pieces(self, members: IntArray | None = None, about: FloatArray | None = None) -> list[WallSegment]:
        """The straight pieces of what was read, about a line (2,) or the one that fits all of it best."""
        chosen = np.arange(len(self.hits)) if members is None else members
        line = fit_line(self.points[chosen], self.std).line if about is None else about
        places, readings = places_of(self.belief.arrays, self.readings.clones), self.readings
        points, variances = points_of(self.belief, readings, float(line[1])), readings.variances(self.std)
        segments, owner, _ = straight_segments(
            self.belief.arrays, places, readings.rows, points, chosen, line, self.std, variances
        )
        return [
            WallSegment(
                chosen[owner == number], float(row[THETA]), row[[MIDDLE_X, MIDDLE_Y]], points[chosen[owner == number]],
                float(row[EXTENT]), float(row[ANGLE_STD]),
            )
            for number, row in enumerate(segments)
        ]  # fmt: skip


def ray(start: FloatArray, heading: float, corners: FloatArray) -> float:
    """How far a ray is free among walls from corner to corner (k, 2); inf if it meets none."""
    ahead = np.array([math.cos(heading), math.sin(heading)])
    aside = np.array([-ahead[1], ahead[0]])
    ends = (corners - start) @ np.column_stack((ahead, aside))
    free = math.inf
    for (x, y), (u, v) in pairwise(ends):
        if (y > 0.0) != (v > 0.0):
            where = x - y * (u - x) / (v - y)
            free = min(free, where if where > 0.0 else math.inf)
    return free


def drive_past(corners: FloatArray, length: float, noise: float, seed: int, wheel_variance: float = 2e-5) -> Drive:
    """Drive along x for ``length`` (m), and read walls from corner to corner (k, 2) to the left."""
    generator = np.random.default_rng(seed)
    nominal = NominalNoise(noise, wheel_variance)
    truth, belief, std = np.zeros(3), CloneEKF(np.zeros(3)), max(noise, 0.005)
    clones, beams, ranges, hits = [], [], [], []
    for _ in range(round(length / STEP) + 1):
        clone = belief.clone()
        for beam in LEFT:
            heading = truth[2] + ROBOT.beam_angles[beam]
            start = compose(truth, np.append(ROBOT.beam_origins[beam], 0.0))[:2]
            free = ray(start, heading, corners)
            if free < 1.4:
                clones.append(clone)
                beams.append(beam)
                ranges.append(free + generator.normal(0.0, noise))
                hits.append(start + free * np.array([math.cos(heading), math.sin(heading)]))
        wheels = np.full(2, STEP)
        motion = motion_from_wheels(wheels, ROBOT, nominal)
        reported = wheels + generator.normal(0.0, math.sqrt(wheel_variance * STEP), 2)
        truth = compose(truth, motion.increment)
        told = motion_from_wheels(reported, ROBOT, nominal)
        belief.predict(told)
    readings = Readings(
        np.array(clones), ROBOT.beam_origins[beams], ROBOT.beam_angles[beams], np.array(ranges),
        np.column_stack((clones, beams)),
    )  # fmt: skip
    return Drive(belief, readings, np.array(hits), std)


def chain(start: tuple[float, float], *legs: tuple[float, float]) -> FloatArray:
    """Corners (k, 2) of walls one after another: each its length (m) and direction (deg)."""
    steps = [(length * math.cos(math.radians(turn)), length * math.sin(math.radians(turn))) for length, turn in legs]
    return np.asarray(np.array(start) + np.vstack((np.zeros((1, 2)), np.cumsum(steps, axis=0))))


def facets(angle: float) -> FloatArray:
    """Two facets of 0.45 m that meet at ``angle`` (deg), as of a rounded obstacle, and stand 0.5 m to the left."""
    half = 0.5 * angle
    return chain((0.1, 0.5), (0.45, half), (0.45, -half))


WALL = chain((-3.0, 0.6), (9.0, 0.0))


# A straight wall.


@pytest.mark.parametrize("noise", NOISES)
def test_a_straight_wall_stays_one_piece_whatever_odometry_makes_of_it(noise: float) -> None:
    counts, lost = Counter[int](), []
    for seed in range(60):
        drive = drive_past(WALL, 0.8, noise, seed)
        pieces = drive.pieces()
        counts[len(pieces)] += 1
        lost.append(1.0 - sum(len(piece.members) for piece in pieces) / len(drive.hits))
    assert counts[1] >= 58
    # And hardly a reading is taken for a loose end.
    assert np.mean(lost) < 0.01


def test_a_bend_of_the_way_is_not_taken_for_one_of_the_wall() -> None:
    # Wheels twice as bad bend the wall by centimetres; who takes the poses for exact cuts it to pieces.
    counts = {trusted: Counter[int]() for trusted in (False, True)}
    for seed in range(30):
        for trusted, count in counts.items():
            drive = drive_past(WALL, 0.8, 0.0, seed, wheel_variance=4e-5)
            if trusted:
                drive.belief.P[:] = 0.0
            count[len(drive.pieces())] += 1
    assert counts[False][1] >= 29
    assert counts[True][1] <= 10


# What is not straight.


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("angle", [25.0, -25.0])
def test_two_facets_are_cut_near_the_corner_between_them(noise: float, angle: float) -> None:
    corners, right, off = facets(angle), 0, []
    for seed in range(30):
        drive = drive_past(corners, 1.0, noise, seed)
        pieces = drive.pieces()
        if len(pieces) != 2:
            continue
        right += 1
        low, high = sorted((float(along.min()), float(along.max())) for along in (
            drive.hits[piece.members, 0] for piece in pieces
        ))  # fmt: skip
        off.append(abs(0.5 * (low[1] + high[0]) - corners[1, 0]))
        # Which way a facet runs, with half of the readings, at 4 cm to some degrees.
        turned = np.sort([math.degrees(piece.theta) % 180.0 for piece in pieces])
        assert turned[1] - turned[0] == pytest.approx(25.0, abs=25.0 * (0.2 + 15.0 * noise))
    assert right >= 27
    assert np.median(off) < (0.04 if noise == 0.0 else 0.08)
    assert max(off) < 0.2


def test_a_curve_has_no_long_straight_piece() -> None:
    # A round pillar of 0.5 m radius, 0.4 m to the left.
    bends = np.radians(np.linspace(-180.0, 0.0, 60))
    pillar = np.column_stack((0.5 + 0.5 * np.cos(bends), 0.9 + 0.5 * np.sin(bends)))
    for seed in range(10):
        drive = drive_past(pillar, 1.0, 0.0, seed)
        members = np.nonzero(drive.hits[:, 1] < 0.55)[0]
        pieces = drive.pieces(members)
        assert np.ptp(drive.hits[members, 0]) > 0.6
        assert max(piece.length for piece in pieces) < 0.35


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_the_end_of_another_wall_is_cut_off(noise: float) -> None:
    # The wall steps back by 6 cm, and 10 cm of what comes then were taken for it.
    corners = chain((-1.0, 0.6), (1.8, 0.0), (0.06, 90.0), (1.0, 0.0))
    kept, wrong = 0.0, 0
    for seed in range(20):
        drive = drive_past(corners, 1.0, noise, seed)
        members = np.nonzero(drive.hits[:, 0] < 0.9)[0]
        pieces = drive.pieces(members)
        stepped_back = drive.hits[members, 1] > 0.605
        assert np.count_nonzero(stepped_back) >= 5
        found = np.concatenate([piece.members for piece in pieces if piece.length > 0.3])
        wrong += int(np.count_nonzero(drive.hits[found, 1] > 0.605))
        kept += len(found) / np.count_nonzero(~stepped_back)
    assert wrong <= 2
    assert kept > 0.85 * 20


# Few points.
