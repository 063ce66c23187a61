"""The consistent estimator as a whole: walls, doors, corners, loops, teams, faults; exact geometry
where it can be.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from support.drives import (
    ROBOT,
    SQUARE,
    LapLog,
    along,
    drive,
    laps_of_square,
    local,
    placed,
    room,
    slam_after,
    straight,
    turn,
)

from limslam_agent import LimSlamTeam, LineSlam, preset
from limslam_agent.slam.core.diagnostics import AssociationRecord
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.slam import Estimator
from limslam_env import LimSlamParallelEnv, NominalNoise, Observation, RobotSpec
from limslam_env.geometry import FloatArray, se2
from limslam_env.geometry import line as line_geometry
from limslam_env.geometry import segment as segment_geometry
from limslam_env.metrics import AssociationEvent, association_metrics, closure_metrics
from limslam_env.robots import four_beam_drone, ring

Change = Callable[[int, FloatArray], FloatArray | None]

CONFIG = preset("consistent")
NOISY = preset("consistent", NominalNoise(0.02))
CORRIDOR = np.array([[-3.0, 0.4, 8.0, 0.4], [-3.0, -0.4, 8.0, -0.4]])
# Straight on, turned, and with a wall through the world's origin.
STARTS = [(0.0, 0.0, 0.0), (1.0, 2.0, 2.5), (0.0, -0.4, math.pi)]
LOOP = [(0.0, 0.0), (3.0, 0.0), (3.0, 2.0), (0.0, 2.0), (0.0, 0.0), (3.0, 0.0)]
ROOM = np.vstack((room(-0.5, -0.5, 3.5, 2.5), room(0.5, 0.5, 2.5, 1.5)))


def off_line(mark: Landmark, wall: FloatArray) -> FloatArray:
    """How far a landmark's line is from a wall's (2,), m and rad."""
    line = line_geometry.through(wall[:2], wall[2:])
    off = line_geometry.nearest_form(np.array([mark.r, mark.theta]), line) - line
    off[1] = se2.wrap_angle(float(off[1]))
    return off


def check_covariance(slam: Estimator) -> None:
    """The covariances of poses and walls are finite, symmetric, and positive but for rounding."""
    for covariance in (*slam.covariances, *(mark.covariance for mark in slam.all_landmarks)):
        assert np.isfinite(covariance).all()
        scale = np.abs(covariance).max()
        np.testing.assert_allclose(covariance, covariance.T, atol=1e-9 * scale)
        assert np.linalg.eigvalsh(covariance).min() > -1e-9 * scale


def check_pose(slam: Estimator, true: FloatArray, metres: float, degrees: float) -> None:
    """The pose is right so far, and no more wrong than it is believed to be (chi-square, 99.9
    %).
    """
    off = slam.pose - true
    off[2] = se2.wrap_angle(float(off[2]))
    assert math.hypot(*off[:2]) < metres
    assert abs(math.degrees(off[2])) < degrees
    assert off @ np.linalg.solve(slam.covariance, off) < 16.3


def check_each_reading_is_used_once(records: Sequence[AssociationRecord]) -> None:
    used = np.vstack([np.insert(record.readings, 0, record.robot, axis=1) for record in records])
    assert len(used) > 50
    assert len(np.unique(used, axis=0)) == len(used)


@pytest.mark.parametrize("place", STARTS)
def test_a_straight_corridor_becomes_its_two_walls(place: tuple[float, float, float]) -> None:
    start = np.array(place)
    walls = placed(CORRIDOR, start)
    observations, poses = drive(walls, start, straight(3.0))
    slam, records = slam_after(observations, CONFIG, start)
    assert len(slam.landmarks) == len(slam.segments) == 2
    marks = sorted(slam.landmarks, key=lambda each: -float(local(each.ends, start)[:, 1].mean()))
    for mark, wall in zip(marks, walls, strict=True):
        assert mark.r >= 0.0
        assert np.abs(off_line(mark, wall)).max() < 2e-3
        # The beam sideways began at x = 0; the one at 45 degrees ends at 3.4 m, those at 15 no
        # farther than 4.55 m.
        reach = local(mark.ends, start)[:, 0]
        assert reach.min() == pytest.approx(0.0, abs=0.05)
        assert 3.35 < reach.max() < 4.55
        assert np.linalg.eigvalsh(mark.covariance).min() > 0.0
    check_pose(slam, poses[-1], 2e-3, 0.1)
    check_covariance(slam)
    check_each_reading_is_used_once(records)


@pytest.mark.parametrize(("place", "noise"), [(STARTS[1], 0.02), (STARTS[2], 0.0)])
def test_a_door_stays_open(place: tuple[float, float, float], noise: float) -> None:
    start = np.array(place)
    walls = placed(
        np.array([[-3.0, 0.4, 1.2, 0.4], [2.0, 0.4, 8.0, 0.4], [-3.0, -0.4, 8.0, -0.4]]), start
    )
    observations, _ = drive(walls, start, straight(4.0), noise=noise)
    slam, _ = slam_after(observations, preset("consistent", NominalNoise(noise)), start)
    ends = [local(segment.reshape(2, 2), start) for segment in slam.segments]
    before, after = sorted(sorted(each[:, 0].tolist()) for each in ends if each[:, 1].mean() > 0.0)
    assert before[1] == pytest.approx(1.2, abs=0.06)
    assert after[0] == pytest.approx(2.0, abs=0.06)


def test_a_robot_that_stands_opens_no_wall() -> None:
    observations, _ = drive(CORRIDOR, np.zeros(3), straight(4.0))
    slam, _ = slam_after(observations, CONFIG, np.zeros(3))
    walls = slam.segments
    missed = observations[-1]["ranges"].copy()
    missed[:] = ROBOT.max_ranges
    for _ in range(100):
        slam.step(Observation(wheels=np.zeros(2), ranges=missed))
    np.testing.assert_array_equal(slam.segments, walls)


def test_a_wall_drawn_over_a_door_opens_when_beams_pass() -> None:
    # The door is shut on the way there, and open on the way back.
    there = np.zeros(3)
    way = straight(4.0)
    first, poses = drive(CORRIDOR, there, way)
    opened = np.array([[-3.0, 0.4, 1.5, 0.4], [2.3, 0.4, 8.0, 0.4], [-3.0, -0.4, 8.0, -0.4]])
    second, more = drive(opened, poses[-1], [*turn(180.0), *way, *turn(180.0), *way])
    slam = LineSlam(ROBOT, CONFIG, there)
    for observation in first:
        slam.step(observation)
    assert len(slam.segments) == 2
    for observation in second[1:]:
        slam.step(observation)
    slam.finish()
    left = sorted(sorted(segment[::2].tolist()) for segment in slam.segments if segment[1] > 0.0)
    assert len(left) == 2
    assert left[0][1] == pytest.approx(1.5, abs=0.08)
    assert left[1][0] == pytest.approx(2.3, abs=0.08)
    assert len(slam.segments) == 3
    check_pose(slam, more[-1], 0.01, 0.3)


@pytest.mark.parametrize("yaw", [2.5])
def test_a_wall_seen_from_both_sides_is_one_landmark(yaw: float) -> None:
    # Up one side of a thin wall, round its end, and down the other side.
    start = np.array([0.3, -0.2, yaw])
    between = np.array([0.0, 0.5, 3.0, 0.5])
    walls = placed(np.vstack((between[None], room(-0.8, -0.5, 4.0, 1.5))), start)
    wheels = along([(0.0, 0.0), (3.5, 0.0), (3.5, 1.0), (-0.3, 1.0)])
    observations, poses = drive(walls, start, wheels, noise=0.02)
    slam, _ = slam_after(observations, NOISY, start)
    marks = [
        mark for mark in slam.landmarks if np.abs(local(mark.ends, start)[:, 1] - 0.5).max() < 0.1
    ]
    assert len(marks) == 1
    assert np.ptp(local(marks[0].ends, start)[:, 0]) == pytest.approx(3.0, abs=0.15)
    assert len(slam.landmarks) == 5
    check_pose(slam, poses[-1], 0.08, 2.0)


@pytest.mark.parametrize(("degrees", "yaw"), [(60.0, 0.0), (120.0, 2.8)])
def test_a_corner_gives_two_walls_at_its_angle(degrees: float, yaw: float) -> None:
    # The wall to the left turns right, and the robot with it, from as far as it has always been.
    start = np.array([1.0, -1.0, yaw])
    bend = math.radians(-degrees)
    corner = np.array([2.0, 0.5])
    beyond = corner + 4.0 * np.array([math.cos(bend), math.sin(bend)])
    walls = placed(np.array([[-2.0, 0.5, *corner], [*corner, *beyond]]), start)
    until = 2.0 - 0.5 * math.tan(math.radians(0.5 * degrees))
    observations, poses = drive(walls, start, [*straight(until), *turn(-degrees), *straight(2.0)])
    slam, _ = slam_after(observations, CONFIG, start)
    assert len(slam.landmarks) == len(slam.segments) == 2
    for mark, wall in zip(slam.landmarks, walls, strict=True):
        assert np.abs(off_line(mark, wall)).max() < 0.01
        # Neither goes on past the corner.
        assert segment_geometry.distances(mark.ends, wall[None]).max() < 0.03
    check_pose(slam, poses[-1], 0.01, 0.5)


@pytest.mark.parametrize(("radius", "noise"), [(0.3, 0.02), (0.6, 0.0)])
def test_a_rounded_obstacle_is_not_one_wall(radius: float, noise: float) -> None:
    around = np.linspace(0.0, 2.0 * math.pi, 40, endpoint=False)
    middle = np.array([2.0, 0.4 + radius])
    circle = segment_geometry.polygon_edges(
        middle + radius * np.column_stack((np.cos(around), np.sin(around)))
    )
    walls = np.vstack((circle, CORRIDOR[1:]))
    observations, poses = drive(walls, np.zeros(3), straight(4.0), noise=noise)
    slam, _ = slam_after(observations, preset("consistent", NominalNoise(noise)), np.zeros(3))
    of_circle = slam.segments[slam.segments[:, 1] > 0.0]
    # What is drawn of it are chords that leave the circle by no more than a few centimetres.
    for x1, y1, x2, y2 in of_circle:
        points = np.column_stack((np.linspace(x1, x2, 20), np.linspace(y1, y2, 20)))
        assert np.abs(np.linalg.norm(points - middle, axis=1) - radius).max() < 0.05 + 2.0 * noise
    assert (segment_geometry.lengths(of_circle) < 1.2 * radius + 0.1).all()
    check_pose(slam, poses[-1], 0.10, 3.0)


def loop_of(
    noise: float, seed: int, wheel_variance: float = 2e-5, laps: float = 1.5, start_x: float = 1.0
) -> tuple[LapLog, Estimator, list[AssociationRecord]]:
    log = laps_of_square(
        noise, seed, laps, ROBOT, wheel_variance=wheel_variance, start=(start_x, 1.0, 0.0)
    )
    config = preset("consistent", NominalNoise(noise, wheel_variance))
    slam, records = slam_after(log.observations, config, log.poses[0])
    return log, slam, records


def events_of(log: LapLog, records: list[AssociationRecord]) -> list[AssociationEvent]:
    return [
        AssociationEvent(
            record.landmark,
            record.is_new,
            tuple(log.wall_seen[step, beam] for step, beam in record.readings.tolist()),
        )
        for record in records
    ]


@pytest.mark.parametrize(("noise", "seed"), [(0.0, 0), (0.04, 0)])
def test_round_the_square_every_wall_is_found_again(noise: float, seed: int) -> None:
    log, slam, records = loop_of(noise, seed)
    # As many walls as there are: none is there twice.
    assert len(slam.landmarks) == len(SQUARE.edges)
    assert association_metrics(events_of(log, records), len(SQUARE.edges))["association_wrong"] == 0
    check_each_reading_is_used_once(records)
    check_covariance(slam)


def test_loops_are_closed_rightly_and_the_younger_landmark_is_gone() -> None:
    # Bad wheels: on coming back, the filter is so unsure that it begins a wall anew before it knows
    # it again.
    closures = 0
    for seed in (1, 4, 8):
        log, slam, records = loop_of(0.0, seed, 4e-4, laps=2.0, start_x=3.5)
        numbers = [mark.number for mark in slam.all_landmarks]
        closures += len(slam.closures)
        for closure in slam.closures:
            assert closure.older < closure.younger
            assert closure.younger not in numbers
        # Numbers are given once, upwards, and no landmark that is gone is ever observed again.
        new = [record.landmark for record in records if record.is_new]
        assert new == list(range(len(new)))
        assert set(numbers) | {closure.younger for closure in slam.closures} == set(new)
        for closure in slam.closures:
            last = max(
                int(r.readings[:, 0].max()) for r in records if r.landmark == closure.younger
            )
            assert last <= closure.step
        pairs = [(closure.older, closure.younger) for closure in slam.closures]
        closed = closure_metrics(events_of(log, records), pairs, len(SQUARE.edges))
        assert closed["closures_wrong"] == closed["closures_mixed"] == 0
        check_each_reading_is_used_once(records)
        check_covariance(slam)
    assert closures, "no loop was closed, and the test shows nothing"


def test_the_same_observations_give_the_same_bits() -> None:
    (log, first, _), (_, second, _) = loop_of(0.02, 0, laps=0.75), loop_of(0.02, 0, laps=0.75)
    assert first.poses.tobytes() == second.poses.tobytes()
    assert first.covariances.tobytes() == second.covariances.tobytes()
    assert first.segments.tobytes() == second.segments.tobytes()
    # Whether or not anybody keeps a record, or looks on.
    alone = LineSlam(ROBOT, NOISY, log.poses[0])
    for observation in log.observations:
        alone.step(observation)
        _ = alone.segments, alone.pending_points, alone.landmarks
    alone.finish()
    assert alone.poses.tobytes() == first.poses.tobytes()
    assert alone.segments.tobytes() == first.segments.tobytes()


def test_beams_on_teammates_make_no_wall() -> None:
    env = LimSlamParallelEnv(
        "env2", num_robots=2, sensor_noise=0.02, coverage_goal=None, max_cycles=None
    )
    # Face to face.
    told, infos = env.reset(
        seed=8, options={"start": [(0.8, 4.5, -0.5 * math.pi), (0.8, 3.5, 0.5 * math.pi)]}
    )
    team = LimSlamTeam(ROBOT, NOISY, 2)
    team.reset(np.array([infos[name]["pose"] for name in team.names]))
    records: list[AssociationRecord] = []
    team.slam.on_association = records.append
    seen = []
    for _ in range(600):
        seen.append([infos[name]["wall_seen"] for name in team.names])
        told, _, _, _, infos = env.step(dict(team.act(told)))
    wall_seen = np.array(seen)
    assert np.count_nonzero(wall_seen == -2) > 0, "they never met, and the test shows nothing"
    for record in records:
        hit = wall_seen[record.readings[:, 0], record.robot, record.readings[:, 1]]
        assert np.mean(hit == -2) < 0.2
    check_each_reading_is_used_once(records)
    check_covariance(team.slam)
    poses = np.array([infos[name]["pose"] for name in team.names])
    assert np.linalg.norm(team.slam.poses[:, :2] - poses[:, :2], axis=1).max() < 0.3
    # Whoever found them first, the walls are there once for both.
    assert {record.robot for record in records} == {0, 1}
    shared = {record.landmark for record in records if record.robot == 0} & {
        record.landmark for record in records if record.robot == 1
    }
    assert shared


def test_the_map_of_one_robot_helps_the_other() -> None:
    # The first maps the corridor; the second comes from 3 m away, where there is nothing to see,
    # with bad wheels.
    walls = np.array([[0.0, 0.4, 8.0, 0.4], [0.0, -0.4, 8.0, -0.4]])
    ahead = np.array([0.3, 0.0, 0.0])
    behind = np.array([-3.0, 0.0, 0.0])
    good, _ = drive(walls, ahead, straight(5.0))
    bad, poses = drive(walls, behind, straight(5.0))
    lying = [
        Observation(
            ranges=each["ranges"],
            wheels=(np.asarray(each["wheels"]) * (1.0, 1.003)).astype(np.float32),
        )
        for each in bad
    ]
    alone, _ = slam_after(lying, CONFIG, behind)
    team = LineSlam(ROBOT, CONFIG, np.array([ahead, behind]))
    records = list[AssociationRecord]()
    team.on_association = records.append
    still = Observation(wheels=np.zeros(2, dtype=np.float32))
    for each in good:
        team.step(each, still)
    for each in lying:
        team.step(still, each)
    team.finish()
    errors = [
        abs(se2.wrap_angle(float(pose[2] - poses[-1, 2]))) for pose in (alone.pose, team.poses[1])
    ]
    assert errors[0] > math.radians(1.5)
    assert errors[1] < math.radians(0.3)
    assert len(team.landmarks) == 2
    assert not any(record.is_new for record in records if record.robot == 1)
    assert sum(record.robot == 1 for record in records) > 5


def rounds(noise: float = 0.02) -> tuple[list[Observation], FloatArray]:
    """Once round a block in a room and a side more."""
    return drive(ROOM, np.zeros(3), along(LOOP), noise=noise)


def with_ranges(observations: list[Observation], change: Change) -> list[Observation]:
    """The same drive, its ranges (n_beams,) put through ``change(step, ranges)``, which may give
    None for none.
    """
    changed: list[Observation] = []
    for step, each in enumerate(observations):
        ranges = change(step, each["ranges"].astype(float))
        told = Observation(wheels=each["wheels"])
        if ranges is not None:
            told["ranges"] = ranges.astype(np.float32)
        changed.append(told)
    return changed


def put(ranges: FloatArray, beams: Sequence[int] | np.ndarray, value: float) -> FloatArray:
    ranges[beams] = value
    return ranges


RANDOM = np.random.default_rng(7).random((2000, 6))
FAULTS: dict[str, Change] = {
    "none": lambda _step, ranges: ranges,
    "a burst of NaN": lambda step, ranges: (
        put(ranges, range(6), math.nan) if 150 <= step < 180 else ranges
    ),
    "a dead beam": lambda _step, ranges: put(ranges, [1], 1.5),
    "no ranges for 2 s": lambda step, ranges: None if 200 <= step < 220 else ranges,
    "a stuck beam": lambda _step, ranges: put(ranges, [1], 0.7),
    "nothing but noise at first": lambda step, ranges: (
        0.1 + 1.3 * RANDOM[step] if step < 150 else ranges
    ),
}
HARMLESS = {"none", "a burst of NaN", "a dead beam", "no ranges for 2 s"}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_run_goes_on_with_faulty_beams(fault: str) -> None:
    observations, poses = rounds()
    slam = LineSlam(ROBOT, NOISY, np.zeros(3))
    for number, observation in enumerate(with_ranges(observations, FAULTS[fault])):
        slam.step(observation)
        if number % 25 == 0:
            check_covariance(slam)
    slam.finish()
    check_covariance(slam)
    assert np.isfinite(slam.segments).all()
    if fault in HARMLESS:
        check_pose(slam, poses[-1], 0.25, 4.0)
        assert len(slam.landmarks) == len(ROOM)


@pytest.mark.parametrize("robot", [ring(360), four_beam_drone()])
def test_other_robots_map_a_room(robot: RobotSpec) -> None:
    observations, poses = drive(ROOM, np.zeros(3), along(LOOP, robot=robot), robot, noise=0.02)
    slam = LineSlam(robot, NOISY, np.zeros(3))
    for observation in observations:
        slam.step(observation)
    slam.finish()
    for wall in ROOM:
        off = np.array([off_line(mark, wall) for mark in slam.landmarks])
        assert (np.abs(off) < [0.10, math.radians(4.0)]).all(axis=1).any()
    check_pose(slam, poses[-1], 0.10, 3.0)
    check_covariance(slam)
