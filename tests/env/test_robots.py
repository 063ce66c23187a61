"""The robots that ship: they drive, they see, and they stay as they are when copied."""

import math

import numpy as np
import pytest

from limslam_env import LimSlamEnv, RobotSpec, robots
from limslam_env.robots import ROBOTS

NUM_BEAMS = {"paper": 6, "e-puck": 8, "four-beam-drone": 4, "ring": 36}


def test_every_robot_is_looked_at_here():
    assert set(ROBOTS) == set(NUM_BEAMS)


@pytest.mark.parametrize("name", NUM_BEAMS)
def test_a_shipped_robot_drives_and_sees(name):
    robot, count = ROBOTS[name](), NUM_BEAMS[name]
    env = LimSlamEnv("env1", robot=robot)
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


@pytest.mark.parametrize("count", [1, 7])
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
@pytest.mark.parametrize("reach", [0.0, math.inf])
def test_a_reach_that_cannot_be_is_refused(make, reach):
    with pytest.raises(ValueError, match=r"max_range|finite"):
        make(reach)


@pytest.mark.parametrize("name", NUM_BEAMS)
def test_a_shipped_robot_survives_a_file(name):
    robot = ROBOTS[name]()
    assert RobotSpec.from_json(robot.to_json()) == robot
