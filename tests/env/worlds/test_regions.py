"""The start region beside the rest of the floor, and open outer walls, against areas by hand."""

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


def test_an_open_outer_wall_is_named():
    region = start_region(hall(OPEN + CLOSET), 0.1)
    assert region.area == pytest.approx(6.7, abs=0.1)
    assert (region.floor, region.is_small) == (17 * 14, True)
    assert region.warning.startswith("the outer wall is open")
    assert "2.8% of the floor" in region.warning
    assert "\n" not in region.warning


def test_a_small_start_region_is_named_with_its_share():
    region = start_region(hall(CLOSED + CLOSET, starts=np.array([[1.0, 1.0, 0.0]])), 0.1)
    assert not region.is_open
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
