"""Occupancy grids: the compiled update is the plain one, and cells keep the rules."""

import numpy as np
import pytest

from limslam_agent.config.presets import GridConfig
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.kernels.cells import BODY, CROSSED, ENDED, SKIPPED, change_cells
from limslam_env import RobotSpec
from limslam_env.geometry import BoolArray, FloatArray, se2
from limslam_env.interface import beams_on_rim

CONFIG = GridConfig()
PAPER = RobotSpec()
DENSE = RobotSpec(beams=beams_on_rim(tuple(range(0, 360, 20)), 0.1, max_range=3.0))


class PlainGrid:
    """The values of all cells that were touched, by column and row counted from the world's origin."""

    def __init__(self) -> None:
        self.values: dict[tuple[int, int], int] = {}
        self.touched: set[tuple[int, int]] = set()

    def update(self, pose: FloatArray, robot: RobotSpec, ranges: FloatArray, usable: BoolArray) -> None:
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
    generator, number, plain, grid = np.random.default_rng(5), len(robot.beams), PlainGrid(), OccupancyGrid(CONFIG)
    for _ in range(60):
        pose = np.array([*generator.normal(0.0, 1.5, 2), generator.uniform(-4.0, 4.0)])
        ranges = np.clip(generator.random(number) * robot.max_ranges * 1.2, robot.min_ranges, robot.max_ranges)
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
    values, stamps = np.array([[1, -9, 9, 0]], dtype=np.int16), np.zeros((1, 4), dtype=np.int32)
    cells = np.array([[0, 0, ENDED], [0, 0, CROSSED], [0, 1, ENDED], [0, 2, CROSSED], [0, 3, SKIPPED]])
    change_cells(values, cells, stamps, 1, 2, 1, 10)
    assert values.tolist() == [[-1, -10, 10, 0]]
    assert stamps.tolist() == [[1, 1, 1, 0]]
