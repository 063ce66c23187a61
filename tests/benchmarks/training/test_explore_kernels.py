"""What training computes for many robots is what an agent computes for one."""

import gymnasium as gym
import numpy as np
import pytest

import limslam_env  # noqa: F401 (registers the environments)
from benchmarks.training.explore_env import ExploreConfig, ExploreVectorEnv
from limslam_agent.config.presets import GridConfig
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.policies.collision_guard import CollisionGuard
from limslam_agent.policies.controller import wheel_speeds
from limslam_agent.policies.learned.polar_view import ViewConfig, frontier_distance, observe
from limslam_env.geometry.se2 import compose, wrap_angle
from limslam_env.interface import RobotSpec

ROBOT = RobotSpec()
VIEW = ViewConfig()
HOLD = ExploreConfig().drive.hold


class Recorder(gym.vector.VectorWrapper):
    """Keeps what the batch answered, and what it was asked."""

    def reset(self, **arguments):
        told, info = self.env.reset(**arguments)
        self.rows = [(None, told["ranges"].copy(), info["pose"].copy(), told["wheels"].copy())]
        return told, info

    def step(self, actions):
        asked = np.array(actions)
        answer = self.env.step(actions)
        self.rows.append((asked, answer[0]["ranges"].copy(), answer[4]["pose"].copy(), answer[0]["wheels"].copy()))
        self.ends = answer[2] | answer[3]
        return answer


def batch(num_envs=3, **arguments):
    settings = {"sensor_noise": 0.02, "autoreset_mode": "SameStep", "plans": [5, 6], **arguments}
    return Recorder(gym.make_vec("LimSlam-Random-v0", num_envs=num_envs, **settings))


@pytest.mark.parametrize("pose", ["true", "odometry"])
def test_grid_view_and_bumper_are_those_of_one_agent(pose):
    env = batch(max_episode_steps=None)
    explore = ExploreVectorEnv(env, ExploreConfig(pose=pose))
    views = [explore.reset(seed=3)[0]]
    generator = np.random.default_rng(0)
    # Not straight back: rounding says which way round.
    choices = [np.where(generator.random(3) < 0.4, generator.integers(-11, 12, 3), 0) for _ in range(40)]
    views += [explore.step(choice)[0] for choice in choices]
    for robot in range(3):
        grid, guard, believed, heading, expected = OccupancyGrid(GridConfig()), CollisionGuard(ROBOT), None, 0.0, None
        for step, (asked, ranges, true, wheels) in enumerate(env.rows):
            if asked is not None:
                np.testing.assert_allclose(asked[robot], expected, atol=1e-6)
            believed = true[robot] if pose == "true" or step == 0 else driven(believed, wheels[robot])
            reading = ranges[robot].astype(float)
            grid.update(believed, ROBOT, reading, np.ones(6, dtype=bool))
            if step % HOLD == 0:
                told = observe(grid.view, believed, reading, ROBOT, VIEW)
                # Starts may lie on the border of two cells, where rounding chooses.
                if step:
                    np.testing.assert_allclose(views[step // HOLD][robot], told, atol=1e-5)
                if step // HOLD < len(choices):
                    heading = believed[2] + VIEW.angle(choices[step // HOLD][robot])
            guard.add_readings(believed, reading)
            error = float(wrap_angle(heading - believed[2]))
            wanted = wheel_speeds(0.3 * max(np.cos(error), 0.0), float(np.clip(5.0 * error, -2.5, 2.5)), ROBOT)
            expected = guard.limit_speed(believed, wanted)
    assert np.isfinite(frontier_distance(grid.view)).any()


def driven(pose, wheels):
    left, right = np.asarray(wheels, dtype=float)
    turn = (right - left) / ROBOT.axle
    chord = 0.5 * (left + right) * np.sinc(0.5 * turn / np.pi)
    return compose(pose, np.array([chord * np.cos(0.5 * turn), chord * np.sin(0.5 * turn), turn]))


def test_an_episode_ends_with_a_last_look_and_the_next_begins_with_an_empty_grid():
    env = batch(max_episode_steps=2 * HOLD)
    explore = ExploreVectorEnv(env)
    first, _ = explore.reset(seed=1)
    explore.step(np.zeros(3, dtype=int))
    told, rewards, terminated, truncated, info = explore.step(np.zeros(3, dtype=int))
    assert truncated.all()
    assert not terminated.any()
    assert rewards.shape == (3,)
    last = np.stack(list(info["final_obs"]))
    size = VIEW.rings * VIEW.directions
    # The last look knows more than a first one.
    assert (last[:, :size].mean(axis=1) < told[:, :size].mean(axis=1)).all()
    assert told.dtype == first.dtype == last.dtype == np.float32
    assert explore.observation_space.contains(told)


def test_episodes_that_begin_a_step_later_are_refused():
    env = gym.make_vec("LimSlam-Env1-v0", num_envs=2)
    with pytest.raises(ValueError, match="autoreset_mode"):
        ExploreVectorEnv(env)
