"""Drop-outs: readings that saw nothing although there was a wall."""

import numpy as np
import pytest

from limslam_agent import Mapper, preset
from limslam_agent.config.presets import GridConfig
from limslam_agent.dropouts import Dropouts, without_dropouts
from limslam_agent.grid.drawing import ReadingDrawer
from limslam_agent.grid.occupancy import GridView, OccupancyGrid, drawn_grid
from limslam_env import NominalNoise, RobotSpec
from limslam_env.geometry import FloatArray

ROBOT = RobotSpec()
COUNT = len(ROBOT.beams)
ALL = np.ones(COUNT, dtype=bool)


def readings_of_a_wall(steps: int, chance: float, *, at: float = 0.8, seed: int = 0) -> FloatArray:
    """Readings (steps, n_beams), m, of a wall that each beam misses with some probability."""
    generator = np.random.default_rng(seed)
    seen = at + 0.02 * generator.standard_normal((steps, COUNT))
    return np.where(generator.random(seen.shape) < chance, ROBOT.max_ranges, seen)


def noted(ranges: FloatArray) -> Dropouts:
    """The drop-outs among readings (t, n_beams), m."""
    dropouts = Dropouts(ROBOT)
    for row in ranges:
        dropouts.note(row, ALL)
    return dropouts


@pytest.mark.parametrize("chance", [0.05, 0.3])
def test_their_share_is_estimated(chance: float) -> None:
    dropouts = noted(readings_of_a_wall(1000, chance))
    assert dropouts.share == pytest.approx(chance, rel=0.15)


def test_a_sensor_that_misses_nothing_has_none() -> None:
    # Open doors of many widths, an object that moves, and a wall at the end of the longest range.
    ranges = readings_of_a_wall(300, 0.0)
    for step in range(10, 290, 20):
        ranges[step : step + step // 20 + 2] = ROBOT.max_ranges
    ranges[:, 0] = np.where(np.arange(300) % 3 == 0, ROBOT.max_ranges[0], 0.97 * ROBOT.max_ranges[0])
    ranges[::2, 1], ranges[1::2, 1] = 0.4, 1.2
    dropouts = noted(ranges)
    assert (dropouts.share, dropouts.enough) == (0.0, 1)


def drawn_with(ranges: FloatArray) -> OccupancyGrid:
    """The grid of a robot that stands at the origin, after readings (t, n_beams), m."""
    drawer, grid = ReadingDrawer(ROBOT), OccupancyGrid(GridConfig())
    for row in ranges:
        drawer.draw(grid, 0, np.zeros(3), row, ALL)
    return grid


def reach_of(view: GridView) -> float:
    """Distance (m) of the farthest free cell from the origin."""
    return float(np.hypot(*view.centres(np.argwhere(view.free)).T).max())


def test_readings_that_saw_nothing_are_drawn_when_enough_of_them_follow_each_other() -> None:
    # The first drop-outs make some free ground behind the wall, before it is known that there are drop-outs.
    before = readings_of_a_wall(1000, 0.1, at=0.5)
    known = drawn_with(before).view.values
    nothing = np.tile(ROBOT.max_ranges, (6, 1))
    seen = np.full((1, COUNT), 0.5)
    short = drawn_with(np.vstack((before, seen, nothing[:2], seen))).view
    assert np.count_nonzero(short.free) == np.count_nonzero(known > 0)
    # A chance of 0.1 makes a series of four with a probability of 1e-4. The estimated chance is not exactly 0.1.
    assert np.count_nonzero(drawn_with(np.vstack((before, nothing))).view.free) > 1.2 * np.count_nonzero(known > 0)


def test_a_beam_that_takes_turns_with_others_is_compared_with_its_own_readings() -> None:
    dropouts, ranges = Dropouts(ROBOT), readings_of_a_wall(6000, 0.1)
    for step, row in enumerate(ranges):
        fresh = np.arange(COUNT) == step % COUNT
        # What the other beams read earlier means nothing now.
        dropouts.note(np.where(fresh, row, np.nan), fresh)
    assert dropouts.share == pytest.approx(0.1, rel=0.2)


def test_a_finished_map_has_no_free_ground_behind_a_wall() -> None:
    steps = 400
    ranges = readings_of_a_wall(steps, 0.1, at=0.5)[:, None]
    measured, poses = np.ones(ranges.shape, dtype=bool), np.zeros((steps, 1, 3))
    grid = drawn_grid(GridConfig(), ROBOT, poses, ranges, measured)
    assert reach_of(grid) < 0.75
    kept = without_dropouts(ROBOT, ranges[:, 0], measured[:, 0])
    assert (kept | (ranges[:, 0] >= ROBOT.too_far)).all()


def test_a_mapper_that_is_reset_draws_no_reading_of_the_estimate_before() -> None:
    mapper = Mapper(ROBOT, preset("consistent", NominalNoise(0.02)))
    for row in readings_of_a_wall(300, 0.1, at=0.5):
        mapper.step({"wheels": np.zeros(2), "ranges": row})
    mapper.step({"wheels": np.zeros(2), "ranges": ROBOT.max_ranges})  # these readings wait
    mapper.reset(np.array([20.0, 0.0, 0.0]))
    for _ in range(8):
        mapper.step({"wheels": np.zeros(2), "ranges": ROBOT.max_ranges})
    cells = mapper.grid.centres(np.argwhere(mapper.grid.free))
    assert np.hypot(*(cells - np.array([20.0, 0.0])).T).max() < 1.7
