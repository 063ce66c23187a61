"""Settings, robots and arguments: what is refused in one short line, and how ranges are drawn
from.
"""

import dataclasses
import math
import re

import gymnasium as gym
import numpy as np
import pytest

import limslam_env
from limslam_env import (
    LimSlamEnv,
    LimSlamParallelEnv,
    NoiseConfig,
    RobotSpec,
    SensorSpec,
    World,
    load_world,
    robots,
)
from limslam_env.interface import beams_on_rim, side_of
from limslam_env.robots import ROBOTS

HIGHEST = {
    "sensor_noise": 1e3,
    "range_noise_growth": 1e3,
    "range_resolution": 1e3,
    "dropout": 1.0,
    "fold_back": 1e3,
    "cone": 0.5 * math.pi,
    "wheel_variance": 1e3,
    "encoder_resolution": 1e3,
    "wheel_mismatch": 0.5,
    "axle_mismatch": 0.5,
    "slip_rate": 1e6,
    "slip_share": 1.0,
    "yaw_std": 1e3,
    "yaw_drift": 10.0,
    "yaw_resolution": 1.0,
}
SIGNED = {"wheel_mismatch", "axle_mismatch", "yaw_drift"}


def lowest(name: str) -> float:
    return -HIGHEST[name] if name in SIGNED else 0.0


def test_every_setting_has_its_bounds_here():
    assert [part.name for part in dataclasses.fields(NoiseConfig)] == list(HIGHEST)


@pytest.mark.parametrize("name", HIGHEST)
def test_a_setting_out_of_bounds_is_refused_in_one_clear_line(name):
    low = lowest(name)
    high = HIGHEST[name]
    above = high * 1.001
    below = low - 1e-9
    nan = math.nan
    inf = math.inf
    for value in (
        *(above, below, nan, inf, -inf),
        *(
            (low, above),
            (below, high),
            (high, low),
            (nan, high),
            (low, nan),
            (low, inf),
            [below, high],
        ),
    ):
        with pytest.raises(
            ValueError, match=rf"^{name} must be a number from \S+ to \S+, or a range"
        ) as refusal:
            NoiseConfig(**{name: value})
        assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", HIGHEST)
def test_the_bounds_themselves_are_allowed(name):
    low = lowest(name)
    high = HIGHEST[name]
    for value in (low, high, (low, high), (high, high)):
        assert getattr(NoiseConfig(**{name: value}), name) == value


def test_what_is_drawn_lies_in_its_range_and_fills_it():
    ranges = {name: (lowest(name), high) for name, high in HIGHEST.items()}
    generator = np.random.default_rng(0)
    draws = [NoiseConfig(**ranges).drawn(generator) for _ in range(400)]
    for name, (low, high) in ranges.items():
        values = np.array([getattr(drawn, name) for drawn in draws])
        assert all(type(getattr(drawn, name)) is float for drawn in draws)
        assert low <= values.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < values.max() <= high
        assert values.mean() == pytest.approx(
            0.5 * (low + high), abs=5.0 * (high - low) / math.sqrt(12.0 * 400)
        )


@pytest.mark.parametrize("name", HIGHEST)
def test_one_range_more_shifts_no_other_draw(name):
    some = {"sensor_noise": (0.01, 0.04), "axle_mismatch": (-0.1, 0.1), "slip_share": (0.2, 0.9)}
    with_it = {**some, name: (lowest(name), HIGHEST[name])}
    one, other = (
        NoiseConfig(**settings).drawn(np.random.default_rng(5)) for settings in (some, with_it)
    )
    for part in dataclasses.fields(NoiseConfig):
        if part.name != name:
            assert getattr(one, part.name) == getattr(other, part.name)


def test_sharp_sensors_can_be_changed():
    sharp = NoiseConfig.sharp(dropout=(0.0, 0.1), wheel_variance=1e-4)
    assert sharp == dataclasses.replace(
        NoiseConfig.sharp(), dropout=(0.0, 0.1), wheel_variance=1e-4
    )
    with pytest.raises(ValueError, match=r"^cone must be"):
        NoiseConfig.sharp(cone=-0.1)
    with pytest.raises(TypeError, match="colour"):
        NoiseConfig.sharp(colour=1.0)


@pytest.mark.parametrize("goal", [0.0, -0.5, 1.0001, math.nan, math.inf])
def test_a_coverage_goal_that_cannot_be_reached_or_is_no_goal_is_refused(goal):
    with pytest.raises(ValueError, match="coverage_goal must lie in"):
        LimSlamEnv("env1", coverage_goal=goal)


@pytest.mark.parametrize(
    ("degrees", "side"),
    [
        (15, "none"),
        (45, "left"),
        (180, "none"),
        (-45, "right"),
        (270, "right"),
    ],
)
def test_a_beam_without_a_side_gets_that_of_its_angle(degrees, side):
    angle = math.radians(degrees)
    assert SensorSpec(0.0, 0.0, angle).side == side_of(angle) == side
    assert SensorSpec(0.0, 0.0, angle, side=None).side == side
    assert beams_on_rim((degrees,), 0.1)[0].side == side


@pytest.mark.parametrize("side", ["Left", 1])
def test_an_unknown_side_is_refused(side):
    with pytest.raises(ValueError, match="side is left, right or none"):
        SensorSpec(0.0, 0.0, 0.0, side=side)


def test_brackets_in_a_file_that_are_never_closed_are_refused():
    with pytest.raises(ValueError, match="not a robot"):
        RobotSpec.from_json("[" * 100_000)


def test_beams_given_as_a_list_are_as_good_as_a_tuple():
    beams = list(beams_on_rim((90.0, 0.0, -90.0), 0.1))
    robot = RobotSpec(beams=beams)
    assert robot.beams == tuple(beams)
    assert robot == RobotSpec(beams=tuple(beams))
    assert hash(robot) == hash(RobotSpec(beams=tuple(beams)))
    # What becomes of the list afterwards is none of the robot's business.
    beams.clear()
    assert len(robot.beams) == 3
    assert RobotSpec.from_json(robot.to_json()) == robot
    with pytest.raises(ValueError, match="at least one beam"):
        RobotSpec(beams=[])


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (
            {"radius": 60.0},
            "radius must be a number from 0.001 to 5 m, not 60.0: is it in m?",
        ),
        (
            {"axle": 115.0},
            "axle must be a number from 0.001 to 10 m, not 115.0: is it in m?",
        ),
        (
            {"max_wheel_speed": 300.0},
            "max_wheel_speed must be a number from 0.0001 to 100 m/s, not 300.0",
        ),
    ],
)
def test_a_robot_in_millimetres_is_refused(wrong, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        RobotSpec(**wrong)


@pytest.mark.parametrize("wrong", [{"max_range": 2000.0}, {"x": 60.0}, {"y": -30.0}])
def test_a_beam_in_millimetres_is_refused(wrong):
    with pytest.raises(ValueError, match=r"a beam's \w+ must be .* m, not .*: is it in m\?"):
        SensorSpec(**{"x": 0.0, "y": 0.0, "angle": 0.0, **wrong})


@pytest.mark.parametrize(("period", "phase"), [(1, 1), (6, 6), (6, -1)])
def test_a_phase_lies_within_the_period(period, phase):
    words = f"a beam's phase, in steps, must be a whole number from 0 to {period - 1}, not {phase}"
    with pytest.raises(ValueError, match=re.escape(words)):
        SensorSpec(0.0, 0.0, 0.0, period=period, phase=phase)
    assert SensorSpec(0.0, 0.0, 0.0, period=7, phase=6).phase == 6


def test_the_largest_robots_and_beams_are_accepted():
    beams = (SensorSpec(5.0, -5.0, 0.0, max_range=1000.0),)
    assert RobotSpec(radius=5.0, axle=10.0, max_wheel_speed=100.0, beams=beams).reach > 1000.0


@pytest.mark.parametrize("wrong", [[90.0, -90.0], ["left"], [{"x": 0.0}], [None]])
def test_beams_that_are_no_sensors_are_refused(wrong):
    with pytest.raises(
        TypeError, match="each beam of a robot must be a SensorSpec, as beams_on_rim makes them"
    ):
        RobotSpec(beams=wrong)


@pytest.mark.parametrize(
    "degrees",
    [(math.pi / 2, 0.0, -math.pi / 2), (math.radians(54.0),)],
)
def test_radians_where_degrees_are_expected_are_refused(degrees):
    with pytest.raises(
        ValueError, match=r"the angles of beams_on_rim are degrees, but .* look like radians"
    ):
        beams_on_rim(degrees, 0.1)


def test_degrees_where_radians_are_expected_are_refused():
    with pytest.raises(ValueError, match=r"a beam's angle .* rad, not 90.0: is it in rad\?"):
        SensorSpec(0.05, 0.0, 90.0)


@pytest.mark.parametrize("degrees", [(1, -1), (6, 0), (1.57, 90.0), ()])
def test_small_angles_in_degrees_are_accepted(degrees):
    assert len(beams_on_rim(degrees, 0.1)) == len(degrees)


NUM_BEAMS = {"paper": 6, "e-puck": 8, "four-beam-drone": 4, "ring": 36, "lidar": 360}


def test_every_robot_is_looked_at_here():
    assert set(ROBOTS) == set(NUM_BEAMS)


@pytest.mark.parametrize("name", NUM_BEAMS)
def test_a_shipped_robot_drives_and_sees(name):
    robot = ROBOTS[name]()
    count = NUM_BEAMS[name]
    env = LimSlamEnv("env1", robot=robot)
    observation, info = env.reset(seed=0)
    start = info["pose"]
    touched = False
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
    for number, (angle, origin) in enumerate(
        zip(robot.beam_angles, robot.beam_origins, strict=True)
    ):
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
    for make in (robots.ring, RobotSpec.lidar):
        with pytest.raises(ValueError, match=f"must be a whole number from 1 to 4096, not {count}"):
            make(count)


def test_the_beams_of_a_laser_scanner_start_at_the_middle_of_the_robot():
    robot = RobotSpec.lidar(8, 4.0, radius=0.2)
    np.testing.assert_allclose(robot.beam_angles, 0.25 * math.pi * np.arange(8))
    np.testing.assert_array_equal(robot.beam_origins, np.zeros((8, 2)))
    assert (robot.radius, robot.reach) == (0.2, 4.0)


@pytest.mark.parametrize(
    "make", [robots.e_puck, robots.four_beam_drone, lambda reach: robots.ring(8, reach)]
)
@pytest.mark.parametrize("reach", [0.0, math.inf])
def test_a_reach_that_cannot_be_is_refused(make, reach):
    with pytest.raises(ValueError, match=r"max_range|finite"):
        make(reach)


@pytest.mark.parametrize("name", NUM_BEAMS)
def test_a_shipped_robot_survives_a_file(name):
    robot = ROBOTS[name]()
    assert RobotSpec.from_json(robot.to_json()) == robot


@pytest.fixture(scope="module")
def env():
    return gym.make("LimSlam-Env1-v0", disable_env_checker=True).unwrapped


@pytest.mark.parametrize(
    "options",
    [
        {"world": 3},
        {"world": None},
        {"world": ["env1"]},
        {"start": [10**400, 0, 0]},
        {"start": 10**6000},
        {3: 1},
        3,
    ],
)
def test_impossible_options_of_a_reset(env, options):
    with pytest.raises(
        ValueError, match=r"a world is|the start is|unknown reset option|a dictionary"
    ):
        env.reset(options=options)


@pytest.mark.parametrize("count", [2.5, "2", True, 0, 9, -1])
def test_an_impossible_number_of_robots(count):
    with pytest.raises(ValueError, match="robots must be a whole number from 1 to 8"):
        LimSlamParallelEnv("env1", num_robots=count)
    with pytest.raises(ValueError, match="robots must be a whole number from 1 to 8"):
        limslam_env.parallel_vector_env(world="env1", num_robots=count, num_envs=1)


@pytest.mark.parametrize("source", [3, None])
def test_what_is_no_world(source):
    with pytest.raises(ValueError, match="a world is a name, the path of a file, or a World"):
        load_world(source)


def test_very_long_names_are_cut_in_messages():
    with pytest.raises(ValueError) as caught:
        load_world("x" * 20_000)
    assert len(str(caught.value)) <= 500


def test_very_many_long_walls_are_refused_before_they_take_minutes():
    ends = np.random.default_rng(0).uniform(0.0, 60.0, (99_000, 4))
    with pytest.raises(ValueError, match="km long; 50 km can be used"):
        World("many", (60.0, 60.0), ends)


MAKERS = {
    "single": lambda **arguments: gym.make("LimSlam-Env1-v0", **arguments),
    "batch": lambda **arguments: gym.make_vec("LimSlam-Env1-v0", num_envs=2, **arguments),
    "parallel": lambda **arguments: limslam_env.parallel_env(world="env1", **arguments),
    "parallel batch": lambda **arguments: limslam_env.parallel_vector_env(
        world="env1", num_envs=2, **arguments
    ),
}


@pytest.mark.parametrize("make", MAKERS.values(), ids=list(MAKERS))
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            {"noise": 0.02},
            r"noise must be a NoiseConfig, such as NoiseConfig\(sensor_noise=\.\.\.\), not 0\.02",
        ),
        ({"rewards": -0.1}, r"rewards must be a RewardConfig, such as RewardConfig\("),
        ({"rewards": {"stop": -0.1}}, r"rewards has no setting 'stop'; there are new_area, step"),
        ({"robot": {"beams": [{"x": 0.0}]}}, r"robot: each beam of a robot must be a SensorSpec"),
        ({"noise": {"dropout": 2}}, r"dropout must be a number from 0 to 1"),
        (
            {"robot": "e_puck"},
            r"robot must be a RobotSpec, such as RobotSpec\(radius=\.\.\.\), not 'e_puck'",
        ),
        ({"sensor_noise": "0.02"}, r"sensor_noise must be a number"),
        ({"coverage_goal": "0.9"}, r"coverage_goal must lie in"),
    ],
)
def test_an_argument_of_a_wrong_type(make, arguments, words):
    with pytest.raises(ValueError, match=words) as caught:
        make(**arguments)
    assert len(str(caught.value)) <= 500
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("make", [MAKERS["single"], MAKERS["parallel"]], ids=["single", "parallel"])
def test_a_window_without_pygame_names_the_extra(monkeypatch, make):
    monkeypatch.setattr("limslam_env.rendering.painter.find_spec", lambda _: None)
    with pytest.raises(gym.error.DependencyNotInstalled, match=r'pip install "limslam\[play\]"'):
        make(render_mode="human")


def test_the_nominal_noise_is_the_upper_end_of_what_a_reset_may_draw():
    noise = limslam_env.NoiseConfig(
        sensor_noise=(0.01, 0.03), wheel_variance=(0.0, 1e-4), slip_rate=0.5
    )
    assert MAKERS["single"](noise=noise).unwrapped.nominal_noise == limslam_env.NominalNoise(
        0.03, 1e-4
    )
    assert MAKERS["parallel"](sensor_noise=0.02).nominal_noise == limslam_env.NominalNoise(0.02)
    ideal = limslam_env.NoiseConfig(wheel_variance=0.0)
    assert MAKERS["batch"](noise=ideal).nominal_noise == limslam_env.NominalNoise()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: RobotSpec(radius=1e-6), "radius must be a number from 0.001 to 5 m"),
        (lambda: RobotSpec(control_period=1e-300), "control_period must be a number from 0.0001"),
        (lambda: RobotSpec(control_period=1e6), "control_period must be a number from 0.0001"),
        (lambda: RobotSpec(axle=True), "axle must be a number"),
        (lambda: SensorSpec(0.1, 0.0, 0.0, period=2.5), "period, in steps, must be a whole number"),
        (lambda: SensorSpec(0.1, 0.0, 0.0, period=True), "period, in steps, must be a whole"),
        (lambda: SensorSpec(0.1, 0.0, 1j), "a beam's angle must be a number"),
        (lambda: SensorSpec(0.1, 10**400, 0.0), "a beam's y must be a number"),
        (lambda: RobotSpec(axle=10**5000), "not a very large int"),
        (lambda: limslam_env.NominalNoise(10**400), r"0 \.\.\. 0"),
        (
            lambda: MAKERS["single"](robot=RobotSpec(radius=0.001)).reset(),
            "a robot of 0.001 m radius is too small for a world of 7 x 7 m",
        ),
        (lambda: limslam_env.RewardConfig(step=math.nan), "the reward step must be a number"),
        (lambda: LimSlamEnv("env1", coverage_goal=True), "coverage_goal must lie in"),
        (lambda: NoiseConfig(dropout=True), "dropout must be a number"),
        (lambda: limslam_env.NominalNoise(1e300), r"noise \(range_std\) must be a number"),
        (lambda: limslam_env.FloorPlanConfig(width=1j), "width must be a length"),
        (lambda: World("w", (10.0, True), [[0, 0, 9, 9]]), "size must be two lengths"),
        (
            lambda: World("w", (10.0, 10.0), [[0, 0, 9, 9]], doors=[[1e300, 0, 0, 1]]),
            r"doors\[0\] holds a number that is above 1e\+07",
        ),
        (lambda: MAKERS["single"](world="env1").reset(options={"start": (1, 2, 1e300)}), "finite"),
        (
            lambda: gym.make_vec("LimSlam-Env1-v0", num_envs=10**9),
            "num_envs must be a whole number from 1 to 4194304",
        ),
        (
            lambda: gym.make_vec("LimSlam-Env1-v0", num_envs=2, world="random", plans=10**400),
            "plans must be a whole number from 1 to 100000",
        ),
    ],
)
def test_a_number_that_is_merely_finite_or_none_at_all_is_refused(make, words):
    with pytest.raises(ValueError, match=words) as refusal:
        make()
    assert "\n" not in str(refusal.value)
