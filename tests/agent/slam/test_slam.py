"""LineSlam on corridors made of nothing but geometry, and how wrong it is against what it
believes.
"""

import copy
import math
import pickle
from typing import Any

import numpy as np
import pytest
from support.drives import FOUR_BEAMS, drive, laps_of_square, placed, recorded, straight

from limslam_agent import AgentConfig, LineSlam, preset
from limslam_agent.config.published import BufferConfig, MapConfig, PublishedConfig
from limslam_agent.slam.core.motion import motion_from_wheels
from limslam_agent.slam.slam import Estimator
from limslam_env import NominalNoise, Observation, RobotSpec
from limslam_env.geometry import FloatArray, se2
from limslam_env.geometry import line as line_geometry

ROBOT = RobotSpec()
# Every observed line counts here; when a landmark becomes a wall of the map is tested in
# test_loop_closing.
EVERY_LINE = MapConfig(min_observations=1, min_length=0.0)


def published(**stages: Any) -> AgentConfig:
    """Settings of the published method that draw every landmark."""
    return AgentConfig(estimator=PublishedConfig(map=EVERY_LINE, **stages))


CONFIG = published()


def corridor(half: float) -> FloatArray:
    """Two parallel walls about a robot that starts between them; long past where it drives."""
    return np.array([[-3.0, half, 8.0, half], [-3.0, -half, 8.0, -half]])


CORRIDOR = corridor(0.4)
STARTS = [(1.0, 2.0, 2.5), (0.5, 0.0, 0.5 * math.pi)]


def run(
    observations: list[Observation],
    config: AgentConfig,
    start: FloatArray,
    robot: RobotSpec = ROBOT,
) -> Estimator:
    slam = LineSlam(robot, config, start)
    for observation in observations:
        slam.step(observation)
    return slam


def with_wheels(observations: list[Observation], factors: tuple[float, float]) -> list[Observation]:
    """The same drive as encoders tell it that report too much or too little."""
    return [
        {"ranges": each["ranges"], "wheels": np.float32(np.asarray(each["wheels"]) * factors)}
        for each in observations
    ]


@pytest.mark.parametrize(("place", "half"), [(STARTS[0], 0.5), (STARTS[1], 0.4)])
def test_a_straight_corridor_becomes_its_two_walls(
    place: tuple[float, float, float], half: float
) -> None:
    start = np.array(place)
    walls = placed(corridor(half), start)
    observations, poses = drive(walls, start, straight(3.0))
    slam = run(observations, CONFIG, start)
    assert len(slam.landmarks) == len(slam.segments) == 2
    left, right = sorted(
        slam.landmarks, key=lambda each: -float(_in_robot_frame(each.ends, start)[:, 1].mean())
    )
    for landmark, wall in ((left, walls[0]), (right, walls[1])):
        line = line_geometry.through(wall[:2], wall[2:])
        found = line_geometry.nearest_form(np.array([landmark.r, landmark.theta]), line)
        np.testing.assert_allclose(found, line, atol=2e-3)
        # Ends: the first beam sideways began at x = 0, the slanted one saw as far ahead as the wall
        # is beside.
        reach = _in_robot_frame(landmark.ends, start)[:, 0]
        assert -0.05 <= reach.min() <= 0.3
        assert 2.5 <= reach.max() <= 3.02 + half
        assert landmark.observations >= 5
        assert np.linalg.eigvalsh(landmark.covariance).min() > 0.0
    np.testing.assert_allclose(slam.pose[:2], poses[-1, :2], atol=2e-3)
    assert abs(se2.wrap_angle(float(slam.pose[2] - poses[-1, 2]))) < 2e-3


def _in_robot_frame(points: FloatArray, start: FloatArray) -> FloatArray:
    cos = math.cos(start[2])
    sin = math.sin(start[2])
    return (points - start[:2]) @ np.array([[cos, -sin], [sin, cos]])


@pytest.mark.parametrize("place", STARTS)
def test_walls_on_one_line_with_a_door_between_become_two(
    place: tuple[float, float, float],
) -> None:
    start = np.array(place)
    # The left wall has an opening of 0.8 m and a room behind it that no beam reaches.
    walls = placed(
        np.array([[-3.0, 0.4, 1.2, 0.4], [2.0, 0.4, 8.0, 0.4], [-3.0, -0.4, 8.0, -0.4]]), start
    )
    observations, _ = drive(walls, start, straight(4.0))
    slam = run(observations, CONFIG, start)
    reaches = [
        sorted(_in_robot_frame(s.reshape(2, 2), start)[:, 0])
        for s in slam.segments
        if _in_robot_frame(s.reshape(2, 2), start)[:, 1].mean() > 0.0
    ]
    before, after = sorted(reaches)
    assert len(slam.segments) == 3
    assert before[1] == pytest.approx(1.2, abs=0.06)
    assert after[0] == pytest.approx(2.0, abs=0.06)


def test_without_correction_the_pose_is_pure_odometry() -> None:
    start = np.array([1.0, -1.0, 2.0])
    generator = np.random.default_rng(4)
    wheels = [tuple(0.025 + 0.002 * generator.standard_normal(2)) for _ in range(120)]
    observations, _ = drive(placed(CORRIDOR, start), start, wheels)
    lying = with_wheels(observations, (1.01, 0.99))
    pose = start
    for each in lying:
        increment = motion_from_wheels(
            np.asarray(each["wheels"], dtype=float), ROBOT, CONFIG.noise
        ).increment
        pose = se2.compose(pose, increment)
    slam = run(lying, preset("odometry"), start)
    np.testing.assert_allclose(slam.pose, pose, atol=1e-12)
    # It draws walls all the same, and with the filter on the pose would have been another.
    assert len(slam.segments) >= 2
    assert np.abs(run(lying, CONFIG, start).pose - pose).max() > 1e-3


def test_readings_that_are_not_numbers_are_counted_and_the_step_goes_on() -> None:
    start = np.zeros(3)
    observations, _ = drive(CORRIDOR, start, straight(2.0))
    broken: list[Observation] = []
    missing: list[Observation] = []
    for number, each in enumerate(observations):
        ranges = each["ranges"].copy()
        none = each["ranges"].copy()
        if number % 5 == 0:
            ranges[0] = math.nan
            ranges[4] = -math.inf
            none[0] = none[4] = 1.5
        broken.append({"ranges": ranges, "wheels": each["wheels"]})
        missing.append({"ranges": none, "wheels": each["wheels"]})
    slam = run(broken, CONFIG, start)
    other = run(missing, CONFIG, start)
    assert slam.refused_readings == 2 * 17
    assert other.refused_readings == 0
    # Such a reading tells as much as none: the map is that of beams which saw nothing.
    np.testing.assert_array_equal(slam.pose, other.pose)
    np.testing.assert_array_equal(slam.segments, other.segments)
    assert len(slam.segments) == 2
    assert np.isfinite(slam.covariance).all()


@pytest.mark.parametrize("shape", [(5,), (7,), (6, 1), (1, 6), (1,), (), (0,)])
def test_ranges_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="ranges must be 6 numbers"):
        LineSlam(ROBOT, CONFIG).step({"ranges": np.ones(shape), "wheels": np.zeros(2)})


@pytest.mark.parametrize("wheels", [[math.nan, 0.0], [0.1]])
def test_wheels_that_are_not_two_finite_numbers_are_refused_and_move_nothing(
    wheels: list[float],
) -> None:
    slam = LineSlam(ROBOT, CONFIG, np.array([1.0, 2.0, 3.0]))
    with pytest.raises(ValueError, match="wheels must be 2 finite numbers"):
        slam.step({"ranges": np.ones(6), "wheels": np.array(wheels)})
    np.testing.assert_array_equal(slam.pose, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(slam.covariance, np.zeros((3, 3)))


def test_an_observation_without_motion_is_refused() -> None:
    with pytest.raises(ValueError, match="'wheels' or 'odometry'"):
        LineSlam(ROBOT, CONFIG).step({"ranges": np.ones(6)})


def test_finish_uses_what_is_left_in_the_buffers() -> None:
    # The buffers are so large that they never fill: without an end nothing comes of the drive.
    start = np.array([1.0, 2.0, 2.5])
    walls = placed(CORRIDOR, start)
    observations, _ = drive(walls, start, straight(2.0))
    slam, records = recorded(observations, published(buffer=BufferConfig(size=10_000)), start)
    assert records == []
    slam.finish()
    assert [record.is_new for record in records] == [True, True]
    assert len(slam.segments) == 2
    for landmark in slam.landmarks:
        # Seen sideways from the start, and by the slanted beams 0.4 m further than the end.
        assert np.ptp(_in_robot_frame(landmark.ends, start)[:, 0]) == pytest.approx(2.4, abs=0.05)
        assert np.abs(_in_robot_frame(landmark.ends, start)[:, 1]) == pytest.approx(0.4, abs=2e-3)
    # What was used is used up.
    slam.finish()
    assert len(records) == 2
    assert [landmark.observations for landmark in slam.landmarks] == [1, 1]


def test_observations_without_ranges_move_the_robot_and_measure_nothing() -> None:
    start = np.zeros(3)
    slam = LineSlam(ROBOT, CONFIG, start)
    slam.step(
        {"ranges": np.full(6, 0.7, dtype=np.float32), "wheels": np.zeros(2, dtype=np.float32)}
    )
    assert slam.measured.all()
    for motion in ({"wheels": np.float32([0.1, 0.1])}, {"odometry": np.array([0.1, 0.0, 0.0])}):
        slam.step(motion)
        assert not slam.measured.any()
    np.testing.assert_allclose(slam.pose, [0.2, 0.0, 0.0], atol=1e-6)
    # The latest readings stay those that were last made, and none was refused.
    np.testing.assert_allclose(slam.ranges, 0.7, rtol=1e-6)
    assert slam.refused_readings == 0


@pytest.mark.parametrize("name", ["consistent", "paper"])
def test_copies_go_on_as_the_slam_that_they_were_made_of(name: str) -> None:
    start = np.array(STARTS[0])
    observations, _ = drive(placed(CORRIDOR, start), start, straight(1.0))
    slam = run(observations[:-1], preset(name), start)
    copies = copy.deepcopy(slam), pickle.loads(pickle.dumps(slam)), slam.copied()  # noqa: S301 (its own bytes)
    for each in (slam, *copies):
        each.step(observations[-1])
        np.testing.assert_array_equal(each.covariance, slam.covariance)
        np.testing.assert_array_equal(each.segments, slam.segments)


def counted(wheels: FloatArray, tick: float, seed: int) -> FloatArray:
    """Travels (t, 2), m, as encoders with a tick, m, report them, which were somewhere within a
    tick at the start.
    """
    if not tick:
        return wheels
    totals = np.cumsum(wheels, axis=0) + np.random.default_rng(seed).uniform(0.0, tick, 2)
    return np.diff(np.floor(totals / tick) * tick, axis=0, prepend=np.zeros((1, 2)))


def mean_nees(noise: float, runs: int, tick: float = 0.0) -> float:
    """Mean NEES / 3 of some runs, one a seed."""
    found = []
    for seed in range(runs):
        log = laps_of_square(noise, seed)
        slam = LineSlam(FOUR_BEAMS, preset("consistent", NominalNoise(noise)), log.poses[0])
        moments = len(log) // 4
        wheels = counted(np.array([seen["wheels"] for seen in log.observations]), tick, seed)
        for step, observation in enumerate(log.observations):
            slam.step({**observation, "wheels": wheels[step]})
            if step % moments == moments - 1:
                error = slam.pose - log.poses[step]
                error[2] = se2.wrap_angle(float(error[2]))
                found.append(error @ np.linalg.solve(slam.covariance, error) / 3.0)
    return float(np.mean(found))


def test_a_few_laps_are_about_as_wrong_as_believed() -> None:
    assert 0.3 < mean_nees(0.02, 8) < 2.2


def test_coarse_encoders_make_laps_about_as_wrong_as_believed() -> None:
    assert 0.2 < mean_nees(0.02, 8, tick=0.01) < 2.2


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "most"), [(0.0, 1.5), (0.02, 1.7), (0.04, 2.0)])
def test_laps_are_not_much_more_wrong_than_believed(noise: float, most: float) -> None:
    """The bars of the project; at 4 cm the mean lies at the upper end of the 95 % band of
    chi-square.
    """
    assert 0.5 < mean_nees(noise, 30) < most
