"""How the consistent filter finds walls: straight pieces, association, expected readings, and where
walls extend.
"""

import math
from collections import Counter
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.drives import ROBOT, drive, recorded, straight
from support.readings import (
    Readings,
    clone_poses,
    hit_points,
    of_filter,
    points_of,
)

from limslam_agent import LineSlam, preset
from limslam_agent.config.consistent import ConsistentConfig, ExtentConfig
from limslam_agent.kernels.extents import (
    Looks,
    add_wall,
    clear_along_beams,
    count_hits,
    merge_walls,
    pass_at,
)
from limslam_agent.kernels.segments import cut_at_bends
from limslam_agent.kernels.tables import (
    ANGLE_STD,
    BIN,
    EXTENT,
    FARTHEST,
    MIDDLE_X,
    MIDDLE_Y,
    THETA,
    empty_walls,
    select,
)
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.limits import FAR_GATE
from limslam_agent.slam.consistent.wall_map import WallExtent, WallMap
from limslam_agent.slam.core.diagnostics import Comparison
from limslam_agent.slam.core.line_fit import fit_line
from limslam_agent.slam.core.motion import motion_from_wheels
from limslam_env import NominalNoise, Observation
from limslam_env.geometry import FloatArray, IntArray, se2, segment
from limslam_env.geometry import line as line_geometry

LEFT = [0, 1]  # the beams at 90 and 45 deg
STEP = 0.02  # m driven between two readings
NOISES = (0.0, 0.02, 0.04)


class WallSegment(NamedTuple):
    """A straight piece: its readings, direction, middle, end points, length, and the direction's
    standard deviation.
    """

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

    def pieces(
        self, members: IntArray | None = None, about: FloatArray | None = None
    ) -> list[WallSegment]:
        """The straight pieces of what was read, about a line (2,) or the one that fits all of it
        best.
        """
        chosen = np.arange(len(self.hits)) if members is None else members
        line = fit_line(self.points[chosen], self.std).line if about is None else about
        points = points_of(self.belief, self.readings, float(line[1]))
        own = select(of_filter(self.belief, self.readings, self.std), chosen)
        segments, owner, _ = cut_at_bends(self.belief.arrays, own, points[chosen], line, self.std)
        return [
            WallSegment(
                chosen[owner == number],
                float(row[THETA]),
                row[[MIDDLE_X, MIDDLE_Y]],
                points[chosen[owner == number]],
                float(row[EXTENT]),
                float(row[ANGLE_STD]),
            )
            for number, row in enumerate(segments)
        ]


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


def drive_past(
    corners: FloatArray, length: float, noise: float, seed: int, wheel_variance: float = 2e-5
) -> Drive:
    """Drive along x for ``length`` (m), and read walls from corner to corner (k, 2) to the left."""
    generator = np.random.default_rng(seed)
    nominal = NominalNoise(noise, wheel_variance)
    truth = np.zeros(3)
    belief = CloneEKF(np.zeros(3))
    std = max(noise, 0.005)
    clones = []
    beams = []
    ranges = []
    hits = []
    for _ in range(round(length / STEP) + 1):
        clone = belief.clone()
        for beam in LEFT:
            heading = truth[2] + ROBOT.beam_angles[beam]
            start = se2.compose(truth, np.append(ROBOT.beam_origins[beam], 0.0))[:2]
            free = ray(start, heading, corners)
            if free < 1.4:
                clones.append(clone)
                beams.append(beam)
                ranges.append(free + generator.normal(0.0, noise))
                hits.append(start + free * np.array([math.cos(heading), math.sin(heading)]))
        wheels = np.full(2, STEP)
        motion = motion_from_wheels(wheels, ROBOT, nominal)
        reported = wheels + generator.normal(0.0, math.sqrt(wheel_variance * STEP), 2)
        truth = se2.compose(truth, motion.increment)
        told = motion_from_wheels(reported, ROBOT, nominal)
        belief.predict(told)
    readings = Readings(
        np.array(clones),
        ROBOT.beam_origins[beams],
        ROBOT.beam_angles[beams],
        np.array(ranges),
        np.column_stack((clones, beams)),
    )
    return Drive(belief, readings, np.array(hits), std)


def chain(start: tuple[float, float], *legs: tuple[float, float]) -> FloatArray:
    """Corners (k, 2) of walls one after another: each its length (m) and direction (deg)."""
    steps = [
        (length * math.cos(math.radians(turn)), length * math.sin(math.radians(turn)))
        for length, turn in legs
    ]
    return np.asarray(np.array(start) + np.vstack((np.zeros((1, 2)), np.cumsum(steps, axis=0))))


def facets(angle: float) -> FloatArray:
    """Two facets of 0.45 m that meet at ``angle`` (deg), as of a rounded obstacle, and stand 0.5 m
    to the left.
    """
    half = 0.5 * angle
    return chain((0.1, 0.5), (0.45, half), (0.45, -half))


WALL = chain((-3.0, 0.6), (9.0, 0.0))


# A straight wall.


@pytest.mark.parametrize("noise", NOISES)
def test_a_straight_wall_stays_one_piece_whatever_odometry_makes_of_it(noise: float) -> None:
    counts = Counter[int]()
    lost = []
    for seed in range(60):
        drive = drive_past(WALL, 0.8, noise, seed)
        pieces = drive.pieces()
        counts[len(pieces)] += 1
        lost.append(1.0 - sum(len(piece.members) for piece in pieces) / len(drive.hits))
    assert counts[1] >= 58
    # And hardly a reading is taken for a loose end.
    assert np.mean(lost) < 0.01


def test_a_bend_of_the_way_is_not_taken_for_one_of_the_wall() -> None:
    # Wheels twice as bad bend the wall by centimetres; who takes the poses for exact cuts it to
    # pieces.
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
    corners = facets(angle)
    right = 0
    off = []
    for seed in range(30):
        drive = drive_past(corners, 1.0, noise, seed)
        pieces = drive.pieces()
        if len(pieces) != 2:
            continue
        right += 1
        low, high = sorted(
            (float(along.min()), float(along.max()))
            for along in (drive.hits[piece.members, 0] for piece in pieces)
        )
        off.append(abs(0.5 * (low[1] + high[0]) - corners[1, 0]))
        # Which way a facet runs, with half of the readings, at 4 cm to some degrees.
        turned = np.sort([math.degrees(piece.theta) % 180.0 for piece in pieces])
        assert turned[1] - turned[0] == pytest.approx(25.0, abs=25.0 * (0.2 + 15.0 * noise))
    assert right >= 27
    assert np.median(off) < (0.04 if noise == 0.0 else 0.08)
    assert max(off) < 0.2


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_the_end_of_another_wall_is_cut_off(noise: float) -> None:
    # The wall steps back by 6 cm, and 10 cm of what comes then were taken for it.
    corners = chain((-1.0, 0.6), (1.8, 0.0), (0.06, 90.0), (1.0, 0.0))
    kept = 0.0
    wrong = 0
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


START = np.zeros(3)
CONFIG = preset("consistent")
GATE = ConsistentConfig().association.gate
STRAIGHT_WALL = np.array([[-1.0, 0.5, 5.0, 0.5]])
BACK_AND_FORTH = [*straight(3.0), *straight(-2.5), *straight(2.0)]
FALSE_TURN = range(len(straight(5.5)) + 1, len(straight(5.5)) + 5)


def misled(degrees: float) -> tuple[list[Observation], FloatArray]:
    """A drive along a wall that is known already, whose odometry turns by an angle that is none,
    and the last pose.
    """
    observations, poses = drive(STRAIGHT_WALL, START, BACK_AND_FORTH)
    each = 0.5 * ROBOT.axle * math.radians(degrees) / len(FALSE_TURN)
    for step in FALSE_TURN:
        observations[step]["wheels"] += np.array([-each, each], dtype=np.float32)
    return observations, poses[-1]


def test_a_filter_that_is_too_sure_is_corrected_by_the_only_wall_nearby() -> None:
    observations, pose = misled(6.0)
    heard = list[Comparison]()
    slam = LineSlam(ROBOT, CONFIG, START)
    slam.on_comparison = heard.append
    for seen in observations:
        slam.step(seen)
    assert np.abs(slam.pose - pose).max() < 0.005
    assert len(slam.all_landmarks) == 1
    # The first comparison after the false turn lies between the gates, and it is said that the
    # landmark was taken.
    tests = [each.tests[0] for each in heard if each.step > FALSE_TURN[0]]
    refused = [test for test in tests if GATE < test.distance < FAR_GATE]
    assert refused
    assert refused[0].excluded == ""


def test_a_turn_beyond_the_far_gate_is_not_taken_back() -> None:
    observations, pose = misled(10.0)
    slam, _ = recorded(observations, CONFIG, START)
    assert abs(se2.wrap_angle(float(slam.pose[2] - pose[2]))) > math.radians(5.0)


TOLERANCE = 1.0  # beams that pass for each that ends there
spots = st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=30).map(np.array)


class Extent:
    """The extent of the first landmark of a map of its own."""

    def __init__(self) -> None:
        self.walls = empty_walls(2, 1000)
        add_wall(self.walls, 0)

    def hit(self, along: FloatArray) -> None:
        count_hits(self.walls, 0, along)

    def pass_at(self, along: float) -> bool:
        """Count a beam that passes; whether it counted."""
        before = self.walls.counted.sum()
        pass_at(self.walls, 0, along)
        return bool(self.walls.counted.sum() > before)

    def absorb(self, other: "Extent", factor: float, shift: float) -> None:
        for own, others in zip(self.walls[:4], other.walls[:4], strict=True):
            own[1] = others[0]
        merge_walls(self.walls, 0, 1, factor, shift, 2)

    def intervals(self, gap: float, tolerance: float) -> FloatArray:
        low, length = self.walls.table[0, :2]
        extent = WallExtent(
            int(low), self.walls.counted[0, :, :length], self.walls.reached[0, :, :length]
        )
        return extent.intervals(gap, tolerance)

    @property
    def ends(self) -> tuple[float, float]:
        low, high = self.walls.ends[0].tolist()
        return low, high


def hit_at(*along: FloatArray) -> Extent:
    extent = Extent()
    for places in along:
        extent.hit(places)
    return extent


def wall(low: float, high: float) -> FloatArray:
    """A place in every bin, 1 cm from its lower end."""
    return np.arange(low + 0.01, high, BIN)


@given(spots, st.floats(0.06, 2.0))
def test_pieces_are_the_hits_cut_at_gaps(along: FloatArray, gap: float) -> None:
    pieces = hit_at(along).intervals(gap, TOLERANCE)
    # All hits are within some piece, pieces begin and end with hits, in order, and what is between
    # is a gap.
    assert all(((pieces[:, 0] <= place) & (place <= pieces[:, 1])).any() for place in along)
    assert np.isin(pieces, along).all()
    assert (pieces[:, 1] >= pieces[:, 0]).all()
    assert (pieces[1:, 0] - pieces[:-1, 1] > gap).all()
    for low, high in pieces:
        inside = np.sort(along[(along >= low) & (along <= high)])
        assert (np.diff(inside) <= gap).all()


# The map that is drawn of it.


def wall_map(theta: float = 0.7, config: ExtentConfig | None = None) -> tuple[WallMap, FloatArray]:
    """A map of one wall 2 m long, read 40 times, and its line (r, theta)."""
    belief = CloneEKF(np.zeros(3))
    line = np.array([1.0, theta])
    belief.add_line(theta, line[0] * np.array([math.cos(theta), math.sin(theta)]))
    walls = WallMap(belief, config or ExtentConfig())
    walls.add_known(line_geometry.at(line, wall(-1.0, 1.0)))
    return walls, line


def beams_from(
    walls: WallMap, origins: FloatArray, heading: float, free: float, std: float = 0.005
) -> None:
    """Beams that begin at points (n, 2) and went a distance into the same direction."""
    beam = np.zeros((1, 8))
    ekf = walls._belief.arrays
    beam[0, FARTHEST] = 10.0
    for origin in origins:
        ekf.x[:3] = *origin, heading
        clear_along_beams(
            walls.arrays,
            ekf,
            0,
            Looks(np.array([free]), np.ones(1, dtype=bool), beam, std, 0.0),
        )


def look(
    walls: WallMap, line: FloatArray, along: FloatArray, free: float, std: float = 0.005
) -> None:
    """Beams straight at places along the wall from 0.5 m before it."""
    beams_from(
        walls, line_geometry.at(line, along) - 0.5 * line_geometry.normal(line), line[1], free, std
    )


@pytest.mark.parametrize("theta", [0.7, -2.0])
def test_a_piece_of_the_map_vanishes_where_beams_pass(theta: float) -> None:
    walls, line = wall_map(theta)
    assert segment.lengths(walls.segments) == pytest.approx([1.95])
    for _ in range(2):
        look(walls, line, np.arange(-0.28, 0.3, 0.05), 1.2)
    segments = walls.segments
    assert segment.lengths(segments) == pytest.approx([0.65, 0.65], abs=0.051)
    middles = 0.5 * (segments[:, :2] + segments[:, 2:])
    np.testing.assert_allclose(np.abs(middles @ line_geometry.direction(line)), 0.65, atol=0.05)
    np.testing.assert_allclose(
        walls.ends(0) @ line_geometry.direction(line), [-0.99, 0.96], atol=1e-12
    )
    for _ in range(2):
        look(walls, line, np.arange(-0.98, 1.0, 0.05), 1.2)
    assert walls.segments.shape == (0, 4)
    assert len(walls.all_landmarks) == 1


def test_beams_that_end_at_the_wall_or_within_what_is_unsure_or_look_away_do_not_open_it() -> None:
    walls, line = wall_map()
    along = np.arange(-0.98, 1.0, 0.05)
    for _ in range(3):
        look(walls, line, along, 0.5)
        look(walls, line, along, 0.54)
        look(walls, line, along, 1.2, std=0.3)
        beams_from(
            walls,
            line_geometry.at(line, along) - 0.5 * line_geometry.normal(line),
            line[1] + math.pi,
            1.2,
        )
        beams_from(walls, line_geometry.at(line, along), line[1] + 0.5 * math.pi, 1.2)
    assert segment.lengths(walls.segments) == pytest.approx([1.95])
