"""Mapper: SLAM, occupancy grid and odometry without a policy, for one robot and for several."""

from functools import reduce

import numpy as np
import pytest

from limslam_agent import LimSlamAgent, LimSlamTeam, LineSlam, Mapper, preset
from limslam_env import LimSlamParallelEnv, NominalNoise, RobotSpec
from limslam_env.geometry import se2

ROBOT = RobotSpec()
NOISE = NominalNoise(0.02)
CONFIG = preset("paper", NOISE)
STEPS = 250


@pytest.fixture(scope="module")
def drive():
    """Start poses (2, 3) and the observations of two robots that a team has driven through Env1."""
    env = LimSlamParallelEnv("env1", num_robots=2, sensor_noise=0.02)
    told, infos = env.reset(seed=5)
    team = LimSlamTeam(ROBOT, CONFIG)
    starts = np.array([infos[name]["pose"] for name in team.names])
    team.reset(starts)
    observations = []
    for _ in range(STEPS):
        observations.append([told[name] for name in team.names])
        told, *_ = env.step(team.act(told))
    return starts, observations, team


def mapped(starts, steps, config=CONFIG):
    mapper = Mapper(ROBOT, config, starts)
    for observations in steps:
        mapper.step(*observations)
    return mapper


def first_robot(drive):
    starts, observations, _ = drive
    return starts[0], [each[:1] for each in observations]


def assert_same_grid(grid, other):
    np.testing.assert_array_equal(grid.low, other.low)
    np.testing.assert_array_equal(grid.values, other.values)


def test_a_mapper_believes_what_the_team_believes_that_heard_the_same(drive):
    starts, observations, team = drive
    mapper = mapped(starts, observations)
    snapshot = team.snapshot()
    assert len(mapper.beliefs) == 2
    for number, belief in enumerate(mapper.beliefs):
        np.testing.assert_array_equal(belief.pose, snapshot.poses[number])
        np.testing.assert_array_equal(belief.covariance, snapshot.covariances[number])
        np.testing.assert_array_equal(belief.other_poses, snapshot.poses[1 - number : 2 - number])
        np.testing.assert_array_equal(belief.segments, snapshot.segments)
        assert_same_grid(belief.grid, snapshot.grid)
        assert len(belief.other_goals) == 0
    assert len(snapshot.segments) >= 2
    np.testing.assert_array_equal(mapper.odometry, snapshot.odometry)


def test_odometry_is_the_composition_of_the_increments_whatever_the_slam_corrects(drive):
    starts, observations, _ = drive
    mapper = mapped(starts, observations)
    for number, start in enumerate(starts):
        increments = [
            se2.arc(*se2.wheels_to_arc(each[number]["wheels"].astype(float), ROBOT.axle))
            for each in observations
        ]
        np.testing.assert_allclose(
            mapper.odometry[number], reduce(se2.compose, increments, start), atol=1e-12
        )
    assert np.abs(mapper.odometry - mapper.slam.poses).max() > 1e-3


def test_beliefs_odometry_and_grid_keep_their_moment(drive):
    start, steps = first_robot(drive)
    mapper = mapped(start, steps[:100])
    belief = mapper.belief
    odometry = mapper.odometry
    grid = mapper.grid
    arrays = [
        belief.pose,
        belief.covariance,
        belief.ranges,
        belief.segments,
        belief.grid.values,
        odometry,
        grid.values,
    ]
    before = [array.copy() for array in arrays]
    for observations in steps[100:]:
        mapper.step(*observations)
    for array, old in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(array, old)
    assert not odometry.flags.writeable
    assert not grid.values.flags.writeable
    assert np.abs(mapper.belief.pose - belief.pose).max() > 0.1


def test_reset_forgets_everything_and_can_change_the_number_of_robots(drive):
    starts, observations, _ = drive
    start, steps = first_robot(drive)
    mapper = mapped(start, steps[:80])
    mapper.reset(starts)
    np.testing.assert_array_equal(mapper.odometry, starts)
    assert mapper.grid.values.size == 0
    for each in observations[:80]:
        mapper.step(*each)
    expected = mapped(starts, observations[:80])
    assert_same_grid(mapper.grid, expected.grid)
    for belief, other in zip(mapper.beliefs, expected.beliefs, strict=True):
        np.testing.assert_array_equal(belief.pose, other.pose)
        np.testing.assert_array_equal(belief.segments, other.segments)


FARTHEST = r"start poses must be finite, and at most 1e\+07 m"


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (np.zeros(2), r"shape \(3,\), or \(n, 3\) for n robots, not \(2,\)"),
        (np.array([0.0, np.nan, 0.0]), FARTHEST),
        (np.array([1.1e7, 0.0, 0.0]), FARTHEST),
        (np.array([1e300, 0.0, 0.0]), FARTHEST),
    ],
)
def test_a_bad_start_pose_is_refused_in_one_line(start, message):
    with pytest.raises(ValueError, match=message) as refusal:
        Mapper(ROBOT, CONFIG, start)
    assert "\n" not in str(refusal.value)


RANGES = np.array([0.8, 0.9, 1.5, 1.5, 0.9, 0.8])


def seen(**changes):
    return {"ranges": RANGES, "wheels": np.array([0.03, 0.03]), **changes}


TICKS = r"travels {} m in one step, .* 0.3 m/s for 0.1 s: wheels must be metres"
MOVED = "odometry must be 3 finite numbers, at most 1000 m"


@pytest.mark.parametrize(
    ("observations", "message"),
    [
        ([], "observations"),
        ([{"ranges": RANGES}], "wheels"),
        ([seen(wheels=np.array([np.nan, 0.0]))], "wheels"),
        ([seen(wheels=np.array([78.0, 144.0]))], TICKS.format(144)),
        ([seen(wheels=np.array([0.01, -14.0]))], TICKS.format(14)),
        ([seen(wheels=np.array([1.0j, 0.0]))], "wheels must be 2"),
        ([seen(wheels=[10**400, 0])], "wheels must be 2"),
        ([seen(wheels=None)], "wheels must be 2"),
        ([seen(wheel_variances=[-1.0, 0.0])], "wheel_variances must be 2"),
        ([seen(wheel_variances=[10**400, 0])], "wheel_variances must be 2"),
        ([seen(yaw=10**400)], "yaw must be one number"),
        ([seen(ranges=np.ones(4))], "ranges must be 6"),
        ([seen(ranges=RANGES * (1.0 + 1.0j))], "ranges must be 6"),
        ([seen(ranges=["near"] * 6)], "ranges must be 6"),
        ([seen(ranges=[10**400] * 6)], "ranges must be 6"),
        ([seen(ranges=[[1.0], 1.0, 1.0, 1.0, 1.0, 1.0])], "ranges must be 6"),
        *(
            ([{"ranges": RANGES, "odometry": np.array([motion, 0.0, 0.0])}], MOVED)
            for motion in (1e300, 1e20, 1001.0)
        ),
    ],
    ids=lambda value: str(value)[:40],
)
@pytest.mark.parametrize("name", ["paper", "consistent"])
def test_a_refused_observation_changes_nothing(observations, message, name, drive):
    start, steps = first_robot(drive)
    mapper = mapped(start, steps[:50], preset(name, NOISE))
    before = mapper.belief
    odometry = mapper.odometry
    with pytest.raises(ValueError, match=message) as refusal:
        mapper.step(*observations)
    assert "\n" not in str(refusal.value)
    np.testing.assert_array_equal(mapper.odometry, odometry)
    np.testing.assert_array_equal(mapper.belief.pose, before.pose)
    assert_same_grid(mapper.belief.grid, before.grid)


@pytest.mark.parametrize("wrong", [(np.zeros(2), np.ones(6)), None])
def test_an_observation_that_is_no_dictionary_is_refused_in_one_line(wrong):
    mapper = Mapper(ROBOT, CONFIG)
    with pytest.raises(
        TypeError, match="an observation must be a dictionary with 'wheels' and 'ranges'"
    ):
        mapper.step(wrong)
    with pytest.raises(TypeError, match="an observation must be a dictionary"):
        LineSlam(ROBOT, CONFIG).step(wrong)


@pytest.mark.parametrize(("ratio", "begins_again"), [(1.4, False), (1.6, True)])
def test_noise_that_is_nearly_as_known_takes_no_robot_back_to_its_start(drive, ratio, begins_again):
    start, steps = first_robot(drive)
    mapper = mapped(start, steps[:20], preset("graph", NOISE))
    slam = mapper.slam
    slam.assume(slam.sensor._replace(std=ratio * slam.sensor.std))
    mapper.step(*steps[20])
    assert (mapper.slam is not slam) == begins_again
    assert len(mapper.drive.scans) == mapper.slam.robots[0].step + 1 == 21


@pytest.mark.parametrize("name", ["paper", "consistent"])
@pytest.mark.parametrize("start", [(9.9e6, -9.9e6, 0.0), (0.0, 0.0, 9.9e6)])
def test_the_farthest_start_pose_is_mapped_from(name, start):
    mapper = Mapper(ROBOT, preset(name, NOISE), np.array(start))
    for _ in range(60):
        mapper.step(seen())
    mapper.finish()
    assert np.hypot(*(mapper.snapshot().pose[:2] - np.array(start[:2]))) < 3.0


@pytest.mark.parametrize("name", ["paper", "consistent"])
@pytest.mark.parametrize("has_ranges", [True, False])
def test_an_estimate_that_leaves_all_bounds_ends_in_one_line(name, has_ranges):
    mapper = Mapper(ROBOT, preset(name, NOISE))
    told = {"odometry": np.array([1000.0, 0.0, 0.0])}
    if has_ranges:
        told["ranges"] = RANGES

    def drive_on():
        for _ in range(10_100):
            mapper.step(told)

    with pytest.raises(ValueError, match=r"the estimated pose must be|the map has grown past"):
        drive_on()


def test_robot_and_settings_in_the_wrong_order_are_refused():
    with pytest.raises(TypeError, match="a RobotSpec and an AgentConfig, in this order"):
        LimSlamAgent(CONFIG, ROBOT)
