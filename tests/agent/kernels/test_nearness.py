"""Ends of beams beside the body and on other robots: compiled as in plain numpy."""

import math

import numpy as np
import pytest

from limslam_agent.kernels.nearness import (
    beams_on_robot,
    place_readings,
    room_ahead,
    safe_share,
)
from limslam_env import RobotSpec
from limslam_env.geometry import FloatArray, se2

ROBOT, SEEDS = RobotSpec(), range(40)
BEAMS = len(ROBOT.beams)


def drawn(seed: int) -> tuple[np.random.Generator, FloatArray, FloatArray]:
    """A generator, a pose (3,) and readings, some of them without a number."""
    generator = np.random.default_rng(seed)
    ranges = np.clip(generator.random(BEAMS) * ROBOT.max_ranges * 1.2, ROBOT.min_ranges, ROBOT.max_ranges)
    ranges[generator.random(BEAMS) < 0.1] = np.nan
    return generator, np.array([*generator.normal(0.0, 1.0, 2), generator.uniform(-4.0, 4.0)]), ranges


def ends_of(pose: FloatArray, reaches: FloatArray) -> FloatArray:
    return se2.transform_points(pose, ROBOT.beam_origins + reaches[:, None] * ROBOT.beam_directions)


@pytest.mark.parametrize("seed", range(5))
def test_readings_are_placed(seed: int) -> None:
    _, pose, ranges = drawn(seed)
    seen, touched = np.empty((BEAMS, 2)), np.empty((BEAMS, 2))
    place_readings(pose, ranges, ROBOT.beam_table, 0.4, seen, touched)
    is_hit, is_near = (ranges > ROBOT.too_near) & (ranges < ROBOT.too_far), ranges <= ROBOT.too_near
    np.testing.assert_allclose(seen, np.where(is_hit[:, None], ends_of(pose, ranges), np.nan), atol=1e-12)
    near = ends_of(pose, 0.4 * ROBOT.too_near)
    np.testing.assert_allclose(touched, np.where(is_near[:, None], near, np.nan), atol=1e-12)


def test_the_share_of_a_way_that_is_safe() -> None:
    shares, found = np.array([1.0, 0.5, 0.25]), set()
    for seed in SEEDS:
        generator, pose, _ = drawn(seed)
        points = pose[:2] + generator.normal(0.0, 0.2, (8, BEAMS, 2))
        points[generator.random((8, BEAMS)) < 0.9] = np.nan
        way = generator.normal(0.0, 0.05, 2)
        flat = points.reshape(-1, 2) - pose[:2]
        flat = flat[np.hypot(*flat.T) > 0.08]
        least = np.minimum(np.hypot(*flat.T), 0.125)
        safe = [share for share in shares.tolist() if (np.hypot(*(flat - share * way).T) >= least).all()]
        share = safe_share(pose, way, points[:5], points[5:], 0.08, 0.125, shares)
        assert share == (safe[0] if safe else 0.0)
        found.add(share)
    assert found == {0.0, 0.25, 0.5, 1.0}


def test_room_ahead() -> None:
    for seed in SEEDS:
        _, _, ranges = drawn(seed)
        front = (np.abs(ROBOT.beam_angles) <= math.radians(60.0)) & np.isfinite(ranges)
        rooms = [math.inf if front.any() else 0.0]
        for beam in np.flatnonzero(front & (ranges < ROBOT.too_far)):
            x, y = ROBOT.beam_origins[beam] + ranges[beam] * ROBOT.beam_directions[beam]
            if abs(y) < ROBOT.radius + 0.03 and x > 0.0:
                rooms.append(x - math.sqrt(ROBOT.radius**2 - min(abs(y), ROBOT.radius) ** 2))
        found = room_ahead(ranges, ROBOT.beam_table, math.radians(60.0), ROBOT.radius, 0.03)
        assert found == pytest.approx(min(rooms), abs=1e-15)


def test_beams_on_another_robot() -> None:
    seen = 0
    for seed in SEEDS:
        generator, pose, _ = drawn(seed)
        ranges = np.clip(generator.random(BEAMS) * ROBOT.max_ranges, ROBOT.min_ranges, ROBOT.max_ranges)
        other, root = pose + np.array([*generator.normal(0.0, 0.5, 2), 1.0]), generator.normal(0.0, 0.1, (9, 9))
        covariance, found = root @ root.T, np.zeros(BEAMS, dtype=bool)
        beams_on_robot(
            pose, other, ranges, ROBOT.beam_table, (0.02, 0.03, 0.1, 0.01), covariance, 6, 0, (0.1, 2.0, 0.05), found
        )
        reached = ranges - 0.01
        ends = ends_of(pose, reached)
        distance, arms = np.hypot(*(ends - other[:2]).T), ends - pose[:2]
        toward = (ends - other[:2]) / distance[:, None]
        turning = arms[:, 0] * toward[:, 1] - arms[:, 1] * toward[:, 0]
        jacobian, columns = np.column_stack((toward, turning, -toward)), [6, 7, 8, 0, 1]
        variance = np.einsum("ki,ij,kj->k", jacobian, covariance[np.ix_(columns, columns)], jacobian)
        noise = 0.02**2 + (0.03 * reached**2) ** 2
        expected = distance <= 0.1 + 2.0 * np.sqrt(variance + noise) + 0.05 + 0.1 * reached
        np.testing.assert_array_equal(found, expected)
        seen += np.count_nonzero(found)
    assert 0 < seen < len(SEEDS) * BEAMS
