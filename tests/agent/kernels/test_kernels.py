"""Kernels of the agent against plain numpy: cells, nearness and sorting."""

import math

import numpy as np
import pytest

from limslam_agent.config.presets import GridConfig
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.kernels.algebra import order_of
from limslam_agent.kernels.cells import BODY, CROSSED, ENDED, SKIPPED, change_cells
from limslam_agent.kernels.nearness import beams_on_robots, place_readings, room_ahead, safe_share
from limslam_env import RobotSpec
from limslam_env.geometry import BoolArray, FloatArray, se2
from limslam_env.interface import beams_on_rim

CONFIG = GridConfig()
PAPER = RobotSpec()
DENSE = RobotSpec(beams=beams_on_rim(tuple(range(0, 360, 20)), 0.1, max_range=3.0))


class PlainGrid:
    """The values of all cells that were touched, by column and row counted from the world's
    origin.
    """

    def __init__(self) -> None:
        self.values: dict[tuple[int, int], int] = {}
        self.touched: set[tuple[int, int]] = set()

    def update(
        self, pose: FloatArray, robot: RobotSpec, ranges: FloatArray, usable: BoolArray
    ) -> None:
        beams = np.flatnonzero(usable & (ranges > robot.too_near))
        ends = robot.beam_origins[beams] + ranges[beams, None] * robot.beam_directions[beams]
        samples = [
            robot.beam_origins[beam] + step * 0.5 * CONFIG.cell * robot.beam_directions[beam]
            for beam in beams
            for step in range(int(ranges[beam] / (0.5 * CONFIG.cell)))
        ]
        passed = se2.transform_points(pose, np.array(samples).reshape(-1, 2))
        crossed = cells_of(np.vstack((passed, pose[:2] + robot.radius * BODY)))
        everywhere = cells_of(se2.transform_points(pose, ends))
        ended = cells_of(se2.transform_points(pose, ends[ranges[beams] < robot.too_far[beams]]))
        self.touched |= crossed | everywhere
        for cell in crossed - ended:
            self._add(cell, CONFIG.seen_through)
        for cell in ended:
            self._add(cell, -CONFIG.hit)

    def _add(self, cell: tuple[int, int], amount: int) -> None:
        value = int(np.clip(self.values.get(cell, 0) + amount, -CONFIG.limit, CONFIG.limit))
        self.values[cell] = value or (1 if amount > 0 else -1)


def cells_of(points: FloatArray) -> set[tuple[int, int]]:
    return {(column, row) for column, row in np.floor(points / CONFIG.cell).astype(int).tolist()}


@pytest.mark.parametrize("robot", [PAPER, DENSE], ids=["paper", "dense"])
def test_the_grid_is_the_plain_one(robot: RobotSpec) -> None:
    generator = np.random.default_rng(5)
    number = len(robot.beams)
    plain = PlainGrid()
    grid = OccupancyGrid(CONFIG)
    for _ in range(60):
        pose = np.array([*generator.normal(0.0, 1.5, 2), generator.uniform(-4.0, 4.0)])
        ranges = np.clip(
            generator.random(number) * robot.max_ranges * 1.2, robot.min_ranges, robot.max_ranges
        )
        ranges[generator.random(number) < 0.05] = np.nan
        usable = (generator.random(number) < 0.8) & np.isfinite(ranges)
        plain.update(pose, robot, ranges, usable)
        grid.update(pose, robot, ranges, usable)
        view = grid.view
        low = np.rint(view.low / CONFIG.cell).astype(int)
        rows, columns = np.nonzero(view.values)
        found = {
            (int(column + low[0]), int(row + low[1])): int(view.values[row, column])
            for row, column in zip(rows, columns, strict=True)
        }
        assert found == plain.values
        touched = np.array(sorted(plain.touched))
        np.testing.assert_array_equal(low, touched.min(axis=0))
        np.testing.assert_array_equal(low + view.values.shape[::-1], touched.max(axis=0) + 1)
    assert min(plain.values.values()) < 0 < max(plain.values.values())


def test_values_are_limited_and_a_known_cell_is_never_zero() -> None:
    values = np.array([[1, -9, 9, 0]], dtype=np.int16)
    stamps = np.zeros((1, 4), dtype=np.int32)
    cells = np.array(
        [[0, 0, ENDED], [0, 0, CROSSED], [0, 1, ENDED], [0, 2, CROSSED], [0, 3, SKIPPED]]
    )
    change_cells(values, cells, stamps, 1, 2, 1, 10)
    assert values.tolist() == [[-1, -10, 10, 0]]
    assert stamps.tolist() == [[1, 1, 1, 0]]


ROBOT = RobotSpec()
SEEDS = range(40)
BEAMS = len(ROBOT.beams)


def drawn(seed: int) -> tuple[np.random.Generator, FloatArray, FloatArray]:
    """A generator, a pose (3,) and readings, some of them without a number."""
    generator = np.random.default_rng(seed)
    ranges = np.clip(
        generator.random(BEAMS) * ROBOT.max_ranges * 1.2, ROBOT.min_ranges, ROBOT.max_ranges
    )
    ranges[generator.random(BEAMS) < 0.1] = np.nan
    return (
        generator,
        np.array([*generator.normal(0.0, 1.0, 2), generator.uniform(-4.0, 4.0)]),
        ranges,
    )


def ends_of(pose: FloatArray, reaches: FloatArray) -> FloatArray:
    return se2.transform_points(pose, ROBOT.beam_origins + reaches[:, None] * ROBOT.beam_directions)


@pytest.mark.parametrize("seed", range(5))
def test_readings_are_placed(seed: int) -> None:
    _, pose, ranges = drawn(seed)
    seen = np.empty((BEAMS, 2))
    touched = np.empty((BEAMS, 2))
    place_readings(pose, ranges, ROBOT.beam_table, 0.4, seen, touched)
    is_hit = (ranges > ROBOT.too_near) & (ranges < ROBOT.too_far)
    is_near = ranges <= ROBOT.too_near
    np.testing.assert_allclose(
        seen, np.where(is_hit[:, None], ends_of(pose, ranges), np.nan), atol=1e-12
    )
    near = ends_of(pose, 0.4 * ROBOT.too_near)
    np.testing.assert_allclose(touched, np.where(is_near[:, None], near, np.nan), atol=1e-12)


def test_the_share_of_a_way_that_is_safe() -> None:
    shares = np.array([1.0, 0.5, 0.25])
    found = set()
    for seed in SEEDS:
        generator, pose, _ = drawn(seed)
        points = pose[:2] + generator.normal(0.0, 0.2, (8, BEAMS, 2))
        points[generator.random((8, BEAMS)) < 0.9] = np.nan
        way = generator.normal(0.0, 0.05, 2)
        flat = points.reshape(-1, 2) - pose[:2]
        flat = flat[np.hypot(*flat.T) > 0.08]
        least = np.minimum(np.hypot(*flat.T), 0.125)
        safe = [
            share for share in shares.tolist() if (np.hypot(*(flat - share * way).T) >= least).all()
        ]
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
        ranges = np.clip(
            generator.random(BEAMS) * ROBOT.max_ranges, ROBOT.min_ranges, ROBOT.max_ranges
        )
        other = pose + np.array([*generator.normal(0.0, 0.5, 2), 1.0])
        root = generator.normal(0.0, 0.1, (6, 6))
        covariance = root @ root.T
        found = np.zeros(BEAMS, dtype=bool)
        sizes = (0.02, 0.03, 0.1, 0.1, 2.0, 0.05)
        poses = np.vstack((other, pose))
        beams_on_robots(poses, covariance, 1, ranges, ROBOT.beam_table, sizes, found)
        ends = ends_of(pose, ranges)
        distance = np.hypot(*(ends - other[:2]).T)
        arms = ends - pose[:2]
        toward = (ends - other[:2]) / distance[:, None]
        turning = arms[:, 0] * toward[:, 1] - arms[:, 1] * toward[:, 0]
        jacobian = np.column_stack((toward, turning, -toward))
        columns = [3, 4, 5, 0, 1]
        variance = np.einsum(
            "ki,ij,kj->k", jacobian, covariance[np.ix_(columns, columns)], jacobian
        )
        noise = 0.02**2 + (0.03 * ranges**2) ** 2
        expected = distance <= 0.1 + 2.0 * np.sqrt(variance + noise) + 0.05 + 0.1 * ranges
        np.testing.assert_array_equal(found, expected)
        seen += np.count_nonzero(found)
    assert 0 < seen < len(SEEDS) * BEAMS


def test_equal_numbers_are_sorted_by_their_place() -> None:
    for size in range(70):
        values = np.random.default_rng(size).integers(0, 20, size).astype(float)
        np.testing.assert_array_equal(order_of(values), np.argsort(values, kind="stable"))
