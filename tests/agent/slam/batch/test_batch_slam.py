"""BatchSlam and SlamVectorObservation: equal to the single filter, whatever the threads, and what
happens when full.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from support.drives import ROBOT, along, drive, laps_of_square, room, straight

from limslam_agent import (
    AgentConfig,
    BatchSlam,
    LimSlamAgent,
    LineSlam,
    SlamObservation,
    SlamVectorObservation,
    WallFollower,
    preset,
)
from limslam_agent.config.consistent import ConsistentConfig, RangeErrorConfig
from limslam_agent.config.presets import self_calibrating
from limslam_agent.slam.batch.state import Capacity
from limslam_agent.slam.slam import Estimator
from limslam_env import LimSlamEnv, NoiseConfig, NominalNoise, Observation, RobotSpec
from limslam_env.envs.wrappers import NormalizedObservation, NormalizedVectorObservation
from limslam_env.geometry import FloatArray
from limslam_env.robots import ring

WORLDS = ["env1", "env2", "env3", "square", "random"]
EQUAL = 1e-6
START = np.zeros(3)
CORRIDOR_LOOP = [(0.0, 0.0), (3.0, 0.0), (3.0, 2.0), (0.0, 2.0), (0.0, 0.0), (3.0, 0.0)]
ROOM = np.vstack((room(-0.5, -0.5, 3.5, 2.5), room(0.5, 0.5, 2.5, 1.5)))
CALIBRATING = self_calibrating(preset("consistent"))


def config_of(noise: float) -> AgentConfig:
    return preset("consistent", NominalNoise(noise))


def without_sensor_errors(config: AgentConfig) -> AgentConfig:
    assert isinstance(config.estimator, ConsistentConfig)
    return replace(
        config, estimator=replace(config.estimator, range_errors=RangeErrorConfig(enabled=False))
    )


def world_env(name: str, noise: float, tick: float = 0.0, **arguments: Any) -> gym.Env[Any, Any]:
    which = "LimSlam-Random-v0" if name == "random" else "LimSlam-World-v0"
    chosen = {} if name == "random" else {"world": name}
    return gym.make(
        which,
        noise=NoiseConfig(noise, encoder_resolution=tick),
        coverage_goal=None,
        **chosen,
        **arguments,
    )


def explored(
    noise: float, steps: int, seed: int = 7, tick: float = 0.0
) -> tuple[float, BatchSlam, list[LimSlamAgent]]:
    """The largest difference of poses between five robots in one batch and five agents, which
    drive.
    """
    envs = [world_env(name, noise, tick) for name in WORLDS]
    config = config_of(noise)
    seen = []
    starts = []
    for env in envs:
        observation, info = env.reset(seed=seed)
        seen.append(observation)
        starts.append(info["pose"])
    agents = [LimSlamAgent(ROBOT, config, WallFollower(ROBOT, config.policy)) for _ in envs]
    for agent, start in zip(agents, starts, strict=True):
        agent.reset(start)
    batch = BatchSlam(ROBOT, config, len(envs), num_threads=2)
    worst = 0.0
    batch.reset(starts)
    for _ in range(steps):
        beliefs = batch.step([each["ranges"] for each in seen], [each["wheels"] for each in seen])
        actions = [agent.act(each) for agent, each in zip(agents, seen, strict=True)]
        single = np.array([agent.slam.pose for agent in agents])
        worst = max(worst, float(np.abs(beliefs.pose - single).max()))
        covariances = np.array([agent.slam.covariance for agent in agents])
        np.testing.assert_allclose(beliefs.covariance, covariances, rtol=0.0, atol=EQUAL)
        seen = [env.step(action)[0] for env, action in zip(envs, actions, strict=True)]
    return worst, batch, agents


def check_maps(batch: BatchSlam, slams: list[Estimator]) -> None:
    np.testing.assert_array_equal(batch.num_landmarks, [len(slam.all_landmarks) for slam in slams])
    np.testing.assert_array_equal(batch.num_closures, [len(slam.closures) for slam in slams])
    for number, slam in enumerate(slams):
        np.testing.assert_allclose(batch.segments(number), slam.segments, rtol=0.0, atol=EQUAL)
    assert not batch.overflows.any()


@pytest.mark.parametrize(("noise", "tick"), [(0.0, 0.0), (0.04, 0.01)])
def test_it_is_the_single_filter_in_every_world(noise: float, tick: float) -> None:
    worst, batch, agents = explored(noise, 350, tick=tick)
    assert worst < EQUAL
    check_maps(batch, [agent.slam for agent in agents])
    assert batch.num_landmarks.min() >= 3


def test_contact_is_noticed_alike() -> None:
    env = world_env("env3", 0.02)
    config = config_of(0.02)
    observation, info = env.reset(seed=3)
    slam = LineSlam(ROBOT, config, info["pose"])
    batch = BatchSlam(ROBOT, config, 1)
    in_contact = 0
    slipped = 0.0
    batch.reset(info["pose"][None])
    for number in range(250):
        before = slam.covariance
        slam.step(observation)
        slipped = max(slipped, float(np.diag(slam.covariance - before)[:2].max()))
        belief = batch.step(observation["ranges"][None], observation["wheels"][None])
        np.testing.assert_allclose(belief.pose[0], slam.pose, rtol=0.0, atol=EQUAL)
        np.testing.assert_allclose(belief.covariance[0], slam.covariance, rtol=0.0, atol=EQUAL)
        # It drives against whatever is in front of it, and then turns a little.
        observation, _, _, _, info = env.step(
            np.array([0.6, 0.6] if number % 50 < 40 else [-0.5, 0.5], dtype=np.float32)
        )
        in_contact += info["collision"]
    assert in_contact > 30
    assert slipped > 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.04])
def test_it_is_the_single_filter_over_long_drives(noise: float) -> None:
    worst, batch, agents = explored(noise, 3000, 8)
    assert worst < EQUAL
    check_maps(batch, [agent.slam for agent in agents])


def followed(
    observations: list[Observation],
    config: AgentConfig,
    robot: RobotSpec = ROBOT,
    start: FloatArray = START,
) -> tuple[Estimator, BatchSlam]:
    """Both after a drive during which they were equal."""
    slam = LineSlam(robot, config, start)
    batch = BatchSlam(robot, config, 1, num_threads=1, size=0)
    batch.reset(start[None])
    for seen in observations:
        slam.step(seen)
        beliefs = batch.step(seen["ranges"][None], seen["wheels"][None])
        np.testing.assert_allclose(beliefs.pose[0], slam.pose, rtol=0.0, atol=EQUAL)
    check_maps(batch, [slam])
    return slam, batch


def test_loops_are_closed_alike() -> None:
    # Bad wheels: on coming back, the filter is so unsure that it begins a wall anew before it knows
    # it again.
    log = laps_of_square(0.0, 10, 2.0, ROBOT, wheel_variance=2e-4, start=(3.5, 1.0, 0.0))
    # The curvature of so large errors looks like a constant error, for which a single robot would
    # be calibrated.
    config = self_calibrating(preset("consistent", NominalNoise(0.0, 2e-4)), "never")
    slam, batch = followed(log.observations, config, ROBOT, log.poses[0])
    assert len(slam.closures) == batch.num_closures[0] > 0


def test_cones_are_modelled_alike() -> None:
    # The readings are those of rays. A single robot would find that out, or take it for an error of
    # the odometry.
    stated = without_sensor_errors(self_calibrating(config_of(0.02), "never"))
    observations, _ = drive(ROOM, START, along(CORRIDOR_LOOP), noise=0.02)
    slam, batch = followed(observations, stated, replace(ROBOT, cone=0.26))
    assert batch.num_landmarks[0] >= 3
    assert np.abs(slam.pose - followed(observations, stated)[0].pose).max() > 1e-3


def test_other_robots_and_unsteady_beams() -> None:
    beams = ring(20).beams
    robot = RobotSpec(
        beams=tuple(replace(beam, period=4, phase=at % 4) for at, beam in enumerate(beams))
    )
    observations, _ = drive(ROOM, START, along(CORRIDOR_LOOP[:3], robot=robot), robot, 0.02)
    for number, seen in enumerate(observations):
        seen["ranges"][number % 20] = np.nan
    slam, batch = followed(observations, config_of(0.02), robot)
    assert batch.refused_readings[0] == slam.refused_readings == len(observations)


DRIVE = drive(ROOM, START, along(CORRIDOR_LOOP[:4]), noise=0.02)[0]


def batch_of(num_envs: int, config: AgentConfig | None = None, **arguments: Any) -> BatchSlam:
    batch = BatchSlam(ROBOT, config or config_of(0.02), num_envs, **arguments)
    batch.reset(np.zeros((num_envs, 3)))
    return batch


def test_threads_change_no_bit() -> None:
    shifted = [list(np.roll(np.arange(len(DRIVE)), number)) for number in range(9)]
    told = []
    for threads in (1, 2, 5):
        batch = batch_of(9, num_threads=threads)
        for step in range(200):
            seen = [DRIVE[rows[step]] for rows in shifted]
            beliefs = batch.step(
                [each["ranges"] for each in seen], [each["wheels"] for each in seen]
            )
        told.append((beliefs.pose.tobytes(), beliefs.covariance.tobytes(), beliefs.grid.tobytes()))
    assert told[0] == told[1] == told[2]


def test_a_reset_of_some_leaves_the_others() -> None:
    batch = batch_of(3, num_threads=1)
    fresh = batch_of(3, num_threads=1)
    for seen in DRIVE[:150]:
        batch.step([seen["ranges"]] * 3, [seen["wheels"]] * 3)
    mask = np.array([False, True, False])
    batch.reset(np.full((3, 3), [1.0, 2.0, 0.5]), mask)
    fresh.reset(np.full((3, 3), [1.0, 2.0, 0.5]))
    for seen in DRIVE[150:250]:
        beliefs = batch.step([seen["ranges"]] * 3, [seen["wheels"]] * 3)
        expected = fresh.step([seen["ranges"]] * 3, [seen["wheels"]] * 3)
    np.testing.assert_array_equal(beliefs.pose[1], expected.pose[1])
    np.testing.assert_array_equal(beliefs.grid[1], expected.grid[1])
    np.testing.assert_array_equal(beliefs.pose[0], beliefs.pose[2])
    assert np.abs(beliefs.pose[0] - beliefs.pose[1]).max() > 0.1


def test_without_room_for_landmarks_none_is_founded() -> None:
    full = batch_of(1, capacity=Capacity(landmarks=2))
    roomy = batch_of(1)
    for seen in DRIVE:
        beliefs = full.step(seen["ranges"][None], seen["wheels"][None])
        roomy.step(seen["ranges"][None], seen["wheels"][None])
    assert full.num_landmarks[0] == 2 < roomy.num_landmarks[0]
    assert full.overflows[0] > 0
    assert roomy.overflows[0] == 0
    assert np.linalg.eigvalsh(beliefs.covariance[0]).min() > 0.0


def test_a_small_grid_goes_along() -> None:
    # 41 cells hold all that the crop of a robot shows that has not turned.
    small = batch_of(1, capacity=Capacity(cells=41), size=21)
    large = batch_of(1, size=21)
    observations, _ = drive(np.array([[-1.0, 0.5, 30.0, 0.5]]), START, straight(20.0))
    for seen in observations:
        here = small.step(seen["ranges"][None], seen["wheels"][None])
        there = large.step(seen["ranges"][None], seen["wheels"][None])
        np.testing.assert_array_equal(here.grid, there.grid)
    assert set(np.unique(here.grid)) == {0, 127, 255}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda: BatchSlam(ROBOT, preset("paper"), 2),
            "a batch needs the preset consistent, not 'paper'",
        ),
        (lambda: BatchSlam(ROBOT, CALIBRATING, 2), "does not calibrate odometry by itself"),
        (lambda: BatchSlam(ROBOT, num_threads=0), "num_threads must be 1 or more, not 0"),
        (lambda: batch_of(2).reset(np.zeros((3, 3))), r"start poses \(2, 3\), not \(3, 3\)"),
        (
            lambda: batch_of(2).step(np.ones((2, 5)), np.zeros((2, 2))),
            r"must be \(2, 6\) and \(2, 2\)",
        ),
        (
            lambda: batch_of(2).step(np.ones((2, 6)), np.array([[0.0, 0.0], [np.inf, 0.0]])),
            "wheel travel of robot 1",
        ),
        (
            lambda: batch_of(2).step(np.ones((2, 6)), np.zeros((2, 2)), [True]),
            "a mask must be 2 booleans",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(change: Callable[[], Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as refusal:
        change()
    assert "\n" not in str(refusal.value)


def vector(mode: AutoresetMode, steps: int = 15, number: int = 3) -> SyncVectorEnv:
    def make(length: int) -> Callable[[], gym.Env[Any, Any]]:
        return lambda: world_env("env1", 0.02, max_episode_steps=length)

    return SyncVectorEnv([make(steps + 4 * place) for place in range(number)], autoreset_mode=mode)


def singles(steps: int = 15, number: int = 3) -> list[SlamObservation]:
    return [
        SlamObservation(
            world_env("env1", 0.02, max_episode_steps=steps + 4 * place), config_of(0.02)
        )
        for place in range(number)
    ]


def same(one: dict[str, Any], other: dict[str, Any], row: int) -> None:
    assert set(one) == set(other)
    for key, value in other.items():
        np.testing.assert_allclose(one[key][row], value, rtol=0.0, atol=1e-5)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_the_vector_tells_what_single_wrappers_tell(mode: AutoresetMode) -> None:
    env = SlamVectorObservation(vector(mode), config_of(0.02))
    alone = singles()
    ended = [False] * 3
    told, _ = env.reset(seed=100)
    for row, one in enumerate(alone):
        same(told, one.reset(seed=100 + row)[0], row)
    generator = np.random.default_rng(0)
    for _ in range(70):
        actions = generator.uniform(0.2, 1.0, (3, 2)).astype(np.float32)
        told, _, terminated, truncated, info = env.step(actions)
        assert env.observation_space.contains(told)
        for row, one in enumerate(alone):
            if mode == AutoresetMode.NEXT_STEP and ended[row]:
                seen = one.reset()[0]
                ended[row] = False
            else:
                seen, _, over, stopped, _ = one.step(actions[row])
                assert (over, stopped) == (terminated[row], truncated[row])
                ended[row] = over or stopped
                if mode == AutoresetMode.SAME_STEP and ended[row]:
                    for key, value in seen.items():
                        np.testing.assert_allclose(
                            info["final_obs"][row][key], value, rtol=0.0, atol=1e-5
                        )
                    seen = one.reset()[0]
            same(told, seen, row)
    env.close()


def test_pictures_of_a_batch_show_the_beliefs() -> None:
    made = {"num_envs": 2, "sensor_noise": 0.02, "render_mode": "rgb_array"}
    plain = gym.make_vec("LimSlam-Env1-v0", **made)
    env = SlamVectorObservation(gym.make_vec("LimSlam-Env1-v0", **made), config_of(0.02))
    for each in (plain, env):
        each.reset(seed=0)
        for _ in range(100):  # until there are walls
            each.step(np.full((2, 2), 0.5, dtype=np.float32))
    pictures = env.render()
    for without, shown, overlay in zip(
        plain.render(), pictures, env.unwrapped.overlays, strict=True
    ):
        assert not np.array_equal(without, shown)
        assert len(overlay.segments)


def test_a_normalized_batch_of_beliefs_lies_in_its_space() -> None:
    env = NormalizedVectorObservation(
        SlamVectorObservation(vector(AutoresetMode.SAME_STEP), config_of(0.02))
    )
    told, _ = env.reset(seed=100)
    finals = []
    for _ in range(70):
        assert env.observation_space.contains(told)
        told, *_, info = env.step(np.full((3, 2), 0.6, dtype=np.float32))
        finals += [seen for seen in info.get("final_obs", ()) if seen is not None]
    assert finals
    assert all(env.single_observation_space.contains(seen) for seen in finals)


def test_what_cannot_be_wrapped_is_refused() -> None:
    with pytest.raises(ValueError, match="a grid needs at least one cell, not 0"):
        SlamVectorObservation(vector(AutoresetMode.NEXT_STEP), size=0)
    with pytest.raises(ValueError, match="has no LimSLAM robot"):
        SlamVectorObservation(SyncVectorEnv([lambda: gym.make("CartPole-v1")]))
    with pytest.raises(ValueError, match="ranges must be those of the robot"):
        SlamVectorObservation(SyncVectorEnv([lambda: NormalizedObservation(LimSlamEnv("env1"))]))
    with pytest.raises(ValueError, match="preset consistent"):
        SlamVectorObservation(vector(AutoresetMode.NEXT_STEP), preset("paper"))
