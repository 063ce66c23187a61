"""The start region beside the rest of the floor, and gaps in outer walls, against areas by hand."""

import numpy as np
import pytest

from limslam_env import World, load_world
from limslam_env.worlds.formats.loading import shipped_worlds
from limslam_env.worlds.regions import start_region

# A hall of 17 m x 14 m with a closet of 2.7 m x 2.5 m in a corner.
CLOSET = [[0, 2.5, 2.7, 2.5], [2.7, 2.5, 2.7, 0]]
CLOSED = [[0, 0, 17, 0], [17, 0, 17, 14], [17, 14, 0, 14], [0, 14, 0, 0]]
OPEN = [[0, 0, 17, 0], [17, 0, 17, 14], [17, 14, 6, 14], [5, 14, 0, 14], [0, 14, 0, 0]]


def hall(walls, **more):
    return World("hall", (17.0, 14.0), np.array(walls, dtype=float), **more)


def test_a_gap_in_the_outer_wall_is_found_and_named():
    region = start_region(hall(OPEN + CLOSET), 0.1)
    assert region.area == pytest.approx(6.7, abs=0.1)
    assert region.open_area == pytest.approx(17 * 14 - 2.7 * 2.5, abs=2.0)
    assert region.gap == pytest.approx((5.5, 14.0), abs=0.25)
    assert region.is_small
    assert region.warning.startswith("the outer wall is open near (5.")
    assert "2.8% of the floor" in region.warning
    assert "\n" not in region.warning


@pytest.mark.parametrize("width", [0.3, 3.5])
def test_gaps_of_any_width_are_found(width):
    walls = [*OPEN[:2], [17, 14, 6 + width, 14], [6, 14, 0, 14], OPEN[4]]
    region = start_region(hall(walls + CLOSET), 0.1)
    assert region.gap == pytest.approx((6 + 0.5 * width, 14.0), abs=0.5 * width + 0.1)


def test_a_small_start_region_is_named_with_its_share():
    region = start_region(hall(CLOSED + CLOSET, starts=np.array([[1.0, 1.0, 0.0]])), 0.1)
    assert region.gap is None
    assert region.share == pytest.approx(2.7 * 2.5 / (17 * 14), rel=0.03)
    assert "the other regions cannot be reached" in region.warning


def test_a_hall_with_a_closet_that_nothing_starts_in_is_fine():
    region = start_region(hall(CLOSED + CLOSET), 0.1)
    assert region.area == pytest.approx(17 * 14 - 2.7 * 2.5, rel=0.01)
    assert (region.is_small, region.warning) == (False, None)


@pytest.mark.parametrize("name", shipped_worlds())
def test_nothing_is_wrong_with_the_shipped_worlds(name):
    region = start_region(load_world(name), 0.1)
    assert (region.share, region.warning) == (1.0, None)
