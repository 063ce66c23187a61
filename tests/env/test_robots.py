"""The robots that ship: they drive, they see, and they stay as they are when copied."""

import copy
import math
import pickle
from collections import Counter

import numpy as np
import pytest

from limslam_env import robots
from limslam_env.envs.env import LimSlamEnv
from limslam_env.interface import RobotSpec, SensorSpec, beams_on_rim
from limslam_env.robots import ROBOTS

NUM_BEAMS = {"paper": 6, "e-puck": 8, "four-beam-drone": 4, "ring": 36}
ARRAYS = [
    "beam_origins", "beam_angles", "beam_directions", "min_ranges", "max_ranges", "too_near", "too_far", "_periods",
]  # fmt: skip


def test_every_robot_is_looked_at_here():
    assert set(ROBOTS) == set(NUM_BEAMS)


@pytest.mark.parametrize("world", ["env1", "square"])
@pytest.mark.parametrize("name", NUM_BEAMS)
def test_a_shipped_robot_drives_and_sees(name, world):
    robot, count = ROBOTS[name](), NUM_BEAMS[name]
    env = LimSlamEnv(world, robot=robot)
    observation, info = env.reset(seed=0)
    start, touched = info["pose"], False
    assert env.observation_space["ranges"].shape == (count,)
    for step in range(650):
        assert observation["ranges"].shape == info["wall_seen"].shape == (count,)
        assert env.observation_space.contains(observation)
        observation, _, _, _, info = env.step((1.0, 1.0) if step < 600 else (-0.3, 0.3))
        touched |= info["collision"]
    assert np.hypot(*(info["pose"] - start)[:2]) > 1.0
    assert touched, "every robot gets to a wall and stops there"
    assert info["coverage"] > 0.0


@pytest.mark.parametrize("name", NUM_BEAMS)
def test_a_shipped_robot_sees_a_wall_at_the_right_distance(name):
    robot = ROBOTS[name]()
    env = LimSlamEnv("square", robot=robot)
    reach = float(robot.max_ranges[0])
    # The wall at x = 7 lies ahead, nearer than the shortest of the beams can see.
    gap = 0.5 * reach
    observation, info = env.reset(seed=0, options={"start": (7.0 - robot.radius - gap, 1.0, 0.0)})
    for number, (angle, origin) in enumerate(zip(robot.beam_angles, robot.beam_origins, strict=True)):
        distance = (robot.radius + gap - origin[0]) / max(math.cos(angle), 1e-9)
        if distance < reach and abs(angle) < 0.5:
            assert info["wall_seen"][number] == 1
            assert observation["ranges"][number] == pytest.approx(distance, abs=1e-6)
    assert (info["wall_seen"] == 1).any()


def test_the_paper_s_robot_is_the_default_one():
    assert robots.paper() == RobotSpec()


def test_an_e_puck_is_small_and_short_sighted():
    robot = robots.e_puck()
    assert robot.radius == 0.035
    np.testing.assert_array_equal(robot.max_ranges, 0.06)
    # Its sensors stand on the rim and the same on both sides.
    np.testing.assert_allclose(np.linalg.norm(robot.beam_origins, axis=1), robot.radius)
    angles = sorted(robot.beam_angles)
    np.testing.assert_allclose(angles, [-angle for angle in reversed(angles)])
    np.testing.assert_array_equal(robots.e_puck(max_range=0.12).max_ranges, 0.12)


def test_a_drone_s_beams_start_at_its_middle_and_point_four_ways():
    robot = robots.four_beam_drone()
    np.testing.assert_array_equal(robot.beam_origins, 0.0)
    np.testing.assert_allclose(np.abs(robot.beam_directions).sum(axis=1), 1.0)
    assert [beam.side for beam in robot.beams] == ["none", "left", "none", "right"]
    np.testing.assert_array_equal(robots.four_beam_drone(3.5).max_ranges, 3.5)


@pytest.mark.parametrize("count", [1, 2, 7, 36, 360])
def test_a_ring_s_beams_are_evenly_spread_from_ahead_on(count):
    robot = robots.ring(count, max_range=2.5)
    assert len(robot.beams) == count
    np.testing.assert_allclose(robot.beam_angles, 2.0 * math.pi * np.arange(count) / count)
    np.testing.assert_allclose(robot.beam_origins, robot.radius * robot.beam_directions)
    np.testing.assert_array_equal(robot.max_ranges, 2.5)
    assert robot.radius == RobotSpec().radius


@pytest.mark.parametrize("count", [0, -3])
def test_a_ring_without_beams_is_refused(count):
    with pytest.raises(ValueError, match=f"a ring needs at least one beam, not {count}"):
        robots.ring(count)


@pytest.mark.parametrize("make", [robots.e_puck, robots.four_beam_drone, lambda reach: robots.ring(8, reach)])
@pytest.mark.parametrize("reach", [0.0, -1.0, math.nan, math.inf])
def test_a_reach_that_cannot_be_is_refused(make, reach):
    with pytest.raises(ValueError, match=r"max_range|finite"):
        make(reach)


@pytest.mark.parametrize("robot", [*(make() for make in ROBOTS.values()), robots.ring(7), robots.ring(360)])
def test_a_robot_that_is_the_same_left_and_right_has_as_many_beams_for_both_buffers(robot):
    sides = Counter(beam.side for beam in robot.beams)
    assert sides["left"] == sides["right"] > 0


@pytest.mark.parametrize("clone", [copy.copy, copy.deepcopy, lambda robot: pickle.loads(pickle.dumps(robot))])  # noqa: S301 (our own bytes)
@pytest.mark.parametrize("is_used", [False, True], ids=["unused", "used"])
def test_a_copy_of_a_robot_is_equal_and_its_arrays_are_read_only(clone, is_used):
    robot = RobotSpec(radius=0.2, beams=(*beams_on_rim((30.0, -30.0), 0.2), SensorSpec(0.0, 0.1, 1.0, period=3)))
    if is_used:
        for name in ARRAYS:
            getattr(robot, name)
    again = clone(robot)
    assert again == robot
    assert hash(again) == hash(robot)
    assert type(again) is RobotSpec
    for name in set(ARRAYS) - {"_periods"}:
        np.testing.assert_array_equal(getattr(again, name), getattr(robot, name))
        with pytest.raises(ValueError, match="read-only"):
            getattr(again, name)[...] = 0.0
    assert again.reach == robot.reach
    np.testing.assert_array_equal(again.measures(2), robot.measures(2))


@pytest.mark.parametrize("name", NUM_BEAMS)
def test_a_shipped_robot_survives_a_file(name):
    robot = ROBOTS[name]()
    assert RobotSpec.from_json(robot.to_json()) == robot
