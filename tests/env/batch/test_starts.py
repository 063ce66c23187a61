"""Given starts of many environments: checked together, with the coverage that each of them
gives.
"""

import numpy as np
import pytest

from limslam_env import FloorPlanConfig, RobotSpec, World, load_world
from limslam_env.batch.places import Places
from limslam_env.batch.worlds import prepare
from limslam_env.geometry import FloatArray

ROBOT = RobotSpec()


def starts_in(world: World, count: int, seed: int) -> FloatArray:
    """Poses (count, 3) in all closed regions of a world."""
    generator = np.random.default_rng(seed)
    space = world.free_space(ROBOT.radius)
    points = space.centres(space.free)
    points = generator.permutation(points[~space.is_open(points)])[:count]
    return np.column_stack((points, generator.uniform(-3.0, 3.0, count)))


def keys_of(count: int) -> np.ndarray:
    return np.random.default_rng(0).integers(2**63, size=count).astype(np.uint64)


@pytest.mark.parametrize(("name", "robots"), [("env2", 3), ("env3", 1)])
def test_each_start_gets_what_it_would_get_alone(name, robots):
    world = load_world(name)
    count = 12
    starts = starts_in(world, count, 3)
    given = starts[:, None]
    keys = keys_of(count)
    together = Places(world, ROBOT, robots, count)
    poses = together.begin(np.arange(count), keys, given)
    for env in range(count):
        alone = Places(world, ROBOT, robots, 1)
        pose = alone.begin(np.zeros(1, dtype=int), keys[env : env + 1], given[env : env + 1])
        np.testing.assert_array_equal(pose[0], poses[env])
        site = prepare(world, ROBOT, robots, starts[env])
        tiles = together.sites.tiles[together.world_of[env]]
        np.testing.assert_array_equal(tiles[: site.tiles.size], site.tiles.ravel())


def test_starts_in_floor_plans_made_beforehand_need_no_further_places():
    places = Places(FloorPlanConfig(width=4.0, height=4.0), ROBOT, 1, 6, [1, 2])
    keys = keys_of(6)
    drawn = places.begin(np.arange(6), keys, None)
    np.testing.assert_array_equal(places.begin(np.arange(6), keys, drawn), drawn)
    assert len(places.sites) == 2


def test_the_first_start_that_cannot_be_is_named():
    world = load_world("env1")
    starts = starts_in(world, 50, 1)
    starts[[20, 30], :2] = [[-3.0, 0.0], [1e3, 1e3]]
    with pytest.raises(
        ValueError, match=r"start \(-3, 0, .*\) collides|start \(-3, 0, .*\) lies in a region"
    ):
        Places(world, ROBOT, 1, 50).begin(np.arange(50), keys_of(50), starts[:, None])
    starts[10, 1] = np.nan
    with pytest.raises(ValueError, match="three finite numbers"):
        world.check_poses(starts, ROBOT.radius)
