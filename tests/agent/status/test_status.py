"""The status: readings against a map, contradictions, sudden changes, faults of robots, and the
smoothed path.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.drives import ROBOT, ranges_at, room
from support.halls import HALL, PART, WAY, drive, known

from benchmarks.suite.faults import Fault
from benchmarks.suite.jobs import KIDNAPPED
from limslam_agent import LimSlamAgent, preset
from limslam_agent.grid.occupancy import GridView
from limslam_agent.kernels.tables import RAY_LENGTH
from limslam_agent.record import Drive, Scan
from limslam_agent.runs.episode import another_place
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.chance import chance_off
from limslam_agent.status.known_map import KnownMap, drift_fit, slip_fit
from limslam_agent.status.monitor import CARRIED, WINDOW, StatusMonitor
from limslam_agent.status.rays import moved, rays_of, step_rays
from limslam_agent.status.status import (
    Status,
    final_status_scores,
    lost_since,
    smoothed_status,
    status_scores,
    worst,
)
from limslam_env import LimSlamEnv, NominalNoise
from limslam_env.geometry import se2


def steps_with(
    fault: Fault,
    world: str,
    noise: float,
    lasts: float,
    seed: int,
    note: list[str] | None = None,
    *,
    finds_places: bool = True,
) -> tuple[LimSlamAgent, list[dict[str, Any]]]:
    """Explore until some seconds (``lasts``) after a fault began. A lost robot may look for its
    place.

    Returns
    -------
    agent
        The agent at the end.
    rows
        For each step the true ``info``, and the ``observation`` that the agent got. Its status is
        added to ``note``.
    """
    env = LimSlamEnv(world, sensor_noise=noise, coverage_goal=None)
    settings = preset("consistent", NominalNoise(noise))
    agent = LimSlamAgent(
        env.robot, settings if finds_places else replace(settings, finds_places=False)
    )
    told, info = env.reset(seed=seed)
    agent.reset(info["pose"], seed)
    rows = []
    while info["time"] < fault.begin + lasts:
        seen = fault.altered(told, info["time"])
        action = agent.act(seen)
        rows.append({**info, "observation": seen})
        if note is not None:
            note.append(agent.status)
        if fault.kind == KIDNAPPED and abs(info["time"] - fault.begin) < 1e-6:
            env.carry(
                0,
                another_place(
                    env.world, env.robot, info["pose"], np.random.default_rng(fault.seed)
                ),
            )
        told, _, _, _, info = env.step(action)
    return agent, rows


WALLS = room(0.0, 0.0, 2.0, 2.0)
POSE = np.array([1.0, 0.8, 0.3])
FREE = GridView(np.full(2, -1.0), 0.1, np.full((40, 40), 4, dtype=np.int16))
NOISE = 0.02
STATED = RangeSensor(NOISE)


def explained(segments, ranges=None, covariance=None, grid=FREE, sensor=STATED):
    ranges = ranges_at(POSE, WALLS) if ranges is None else ranges
    rays = moved(step_rays(sensor.corrected(np.array(ranges), ROBOT), ROBOT), POSE)
    return KnownMap(segments, grid, sensor).explained(rays, covariance), rays


def test_a_right_map_is_not_contradicted():
    found, rays = explained(WALLS)
    assert found.tested.all()
    assert not found.against.any()
    assert (found.evidence > 0.0).all()
    fit = KnownMap(WALLS, FREE, STATED).fit_here(rays)
    assert fit.evidence == pytest.approx(found.evidence.sum())
    assert (fit.contradictions, fit.tested) == (0, len(rays))


def test_the_evidence_of_a_reading_at_a_wall_is_a_likelihood_ratio():
    wall = np.array([[1.5, -4.0, 1.5, 4.0]])
    rays = np.array([[0.5, 0.0, 1.0, 0.0, 1.03, 1.5, 0.0]])
    (evidence,), _, _ = KnownMap(wall, FREE, RangeSensor(NOISE)).explained(
        rays, np.diag([0.01, 0.0, 0.04])
    )
    std = math.sqrt(NOISE**2 + 0.045**2 + 0.01 + 0.04)
    density = math.exp(-0.5 * (0.03 / std) ** 2) / (std * math.sqrt(2.0 * math.pi))
    share_of_wrong = 0.02
    nothing = 0.45
    assert evidence == pytest.approx(
        math.log((1 - share_of_wrong) * density * 1.5 / (1 - nothing) + share_of_wrong)
    )


@pytest.mark.parametrize("ranges", [None, ROBOT.max_ranges], ids=["a wall", "nothing seen"])
def test_a_reading_beyond_known_ground_says_nothing(ranges):
    values = np.zeros_like(FREE.values)
    values[17:19, 19:21] = 4
    found, _ = explained(np.zeros((0, 4)), ranges, grid=replace(FREE, values=values))
    assert not found.tested.any()
    np.testing.assert_array_equal(found.evidence, 0.0)


@pytest.mark.parametrize("ranges", [None, ROBOT.max_ranges], ids=["longer", "nothing seen"])
def test_a_wall_too_near_is_gone_through(ranges):
    found, rays = explained(np.array([[0.3, 1.3, 1.7, 1.3]]), ranges)
    through = (found.against > 0.0) & (found.against < rays[:, RAY_LENGTH])
    assert through.any()
    assert (found.evidence[through] < 0.0).all()


def test_ends_of_beams_in_free_space_contradict_unless_they_are_beside_unknown_ground():
    nothing = np.zeros((0, 4))
    found, rays = explained(nothing)
    ended = rays[:, RAY_LENGTH] < ROBOT.max_ranges
    np.testing.assert_array_equal(found.against > 0.0, ended)
    np.testing.assert_allclose(found.against[ended], rays[ended, RAY_LENGTH])
    assert not explained(nothing, ROBOT.max_ranges)[0].against.any()
    values = FREE.values.copy()
    ends = rays[:, :2] + rays[:, RAY_LENGTH, None] * rays[:, 2:4]
    rows, columns = FREE.cells(ends).T
    values[rows, columns + 1] = 0
    assert not explained(nothing, grid=GridView(FREE.low, FREE.cell, values))[0].against.any()


@pytest.mark.parametrize("off", [(0.2, -0.1, 0.08), (0.0, 0.0, 0.0)])
def test_the_likeliest_pose_near_by_is_that_of_the_drive(off):
    whole = known(WAY, HALL)
    rays = rays_of(drive(PART, HALL), ROBOT)
    found = drift_fit(whole, moved(rays, np.array(off)), np.diag([0.1**2, 0.1**2, 0.05**2]))
    np.testing.assert_allclose(found.fit.pose, se2.inverse(np.array(off)), atol=0.06)
    assert found.evidence > 50.0


@pytest.mark.parametrize("turn", [-26.0, 14.0])
def test_a_slip_is_found_by_what_was_read_since_then(turn):
    whole = known(WAY, HALL)
    rays = rays_of(drive(PART, HALL), ROBOT)
    start = np.array([*rays[0, :2], 0.0])
    slip = se2.compose(
        se2.compose(start, np.array([0.0, 0.0, math.radians(turn)])), se2.inverse(start)
    )
    found = slip_fit(whole, moved(rays, slip))
    np.testing.assert_allclose(found.fit.pose, se2.inverse(slip), atol=0.06)
    assert found.evidence > whole.fit_here(moved(rays, slip)).evidence + 50.0


SURE = np.diag([1e-6, 1e-6, 1e-6])
SENSOR = RangeSensor(0.02)
WIDE = GridView(np.array([-4.0, -4.0]), 0.1, np.full((100, 100), 4, dtype=np.int16))
KNOWN = KnownMap(WALLS, FREE, SENSOR)


class Watched(StatusMonitor):
    """A monitor of a drive that goes on with each call."""

    def __init__(self):
        self.drive = Drive()
        super().__init__(ROBOT, SENSOR, self.drive)

    def goes_on(self, pose, ranges, distance=0.11, turn=0.0, **more):
        """The robot has moved by a distance, m, and a turn, rad; whether a check is due."""
        scan = Scan(pose, ranges, np.array([distance, 0.0, turn]), **more)
        self.drive.scans.append(scan)
        return self.observe(is_busy=True)

    def goes_on_blindly(self):
        """A step without new readings."""
        return self.goes_on(np.array([1.0, 1.0, 0.0]), np.full(6, np.nan), 0.01)


def broken_after(readings):
    """The broken beam of a robot that turns by 0.1 rad before each row of readings (n, 6), m."""
    watched = Watched()
    for row in readings:
        if watched.goes_on(place(0), row, 0.0, 0.1):
            watched.check(SURE, KNOWN)
        if watched.broken is not None:
            return watched.broken
    return None


def test_equal_readings_far_apart_are_no_broken_beam():
    # In a corridor, a beam that turns sees each wall for a moment, always at the same distances.
    since = (np.arange(400)[:, None] + 3 * np.arange(6)) % 31
    assert broken_after(np.where(since < 3, 0.8 + 0.05 * (since != 1), np.nan)) is None


@pytest.mark.parametrize("every", [1, 3, 6])
def test_a_stuck_beam_is_found_by_the_readings_that_it_has(every):
    readings = np.random.default_rng(0).uniform(0.2, 1.4, (200, 6))
    readings[:, 2] = np.where(np.arange(200) % every == 0, 0.8, np.nan)
    assert broken_after(readings) == 2


def place(number):
    """A pose on a small circle about the middle of the room."""
    angle = 0.1 * number
    return np.array([1.0 + 0.2 * math.cos(angle), 1.0 + 0.2 * math.sin(angle), angle])


def watched_levels(watched, steps, walls=WALLS, known=KNOWN, covariance=SURE, begin=0):
    """Check at each step what a robot sees whose surroundings are ``walls``; the levels."""
    levels = []
    for number in range(begin, begin + steps):
        assert watched.goes_on(place(number), ranges_at(place(number), walls))
        watched.check(covariance, known)
        levels.append(watched.status.level)
    return levels


def test_a_robot_whose_walls_are_gone_is_lost_at_once_and_says_why():
    watched = Watched()
    watched_levels(watched, 40)
    levels = watched_levels(watched, 10, walls=np.zeros((0, 4)), begin=40)
    assert levels.index("lost") <= 4
    # The contradictions alone would suffice before it is known that the readings changed suddenly,
    # and when.
    assert watched.status == CARRIED
    assert watched.loss.is_dated
    assert watched.loss.is_carried
    assert watched.loss.step == 40, "the walls are gone since the first of the ten steps"


def test_a_robot_that_was_carried_away_is_lost_although_its_map_is_redrawn_around_it():
    watched = Watched()
    watched_levels(watched, 40)
    wrong = room(-3.0, -3.0, 3.0, 3.0)
    # After a step without readings, nothing has changed at once.
    watched.goes_on_blindly()
    levels = watched_levels(
        watched, 200, walls=wrong, known=KnownMap(wrong, WIDE, SENSOR), begin=40
    )
    assert levels.index("lost") < 10
    assert set(levels[levels.index("lost") :]) == {"lost"}


def test_a_lost_robot_is_ok_again_when_the_earlier_map_fits():
    watched = Watched()
    watched_levels(watched, 40)
    began = watched_levels(watched, 10, walls=np.zeros((0, 4)), begin=40).index("lost")
    assert watched.added_covariance.any()
    levels = watched_levels(watched, 200, begin=50)
    steps = levels.index("ok") + 10 - began
    assert WINDOW <= 0.11 * steps <= WINDOW + 1.0
    assert set(levels[levels.index("ok") :]) == {"ok"}
    assert not watched.added_covariance.any()


def test_a_closed_loop_moves_the_map_and_raises_no_doubt():
    """The map was 0.4 m off, and a change before the loop was closed is not weighed yet."""
    watched = Watched()
    off = np.array([0.4, 0.4, 0.0])
    before = KnownMap(room(0.4, 0.4, 2.4, 2.4), FREE, SENSOR)
    for number in range(44):
        ranges = ranges_at(place(number), WALLS) - 0.1 * (number == 41)
        watched.goes_on(place(number) + off, ranges)
        if number < 40:
            watched.check(SURE, before)
    assert watched.status == Status()
    watched.forget_map()
    assert set(watched_levels(watched, 60, begin=44)) == {"ok"}


def test_a_jump_of_the_odometry_is_noticed_in_the_same_step():
    watched = Watched()
    watched_levels(watched, 40)
    assert watched.goes_on(place(40), ranges_at(place(40), WALLS), 5.0)
    watched.check(SURE, KNOWN)
    assert watched.status == Status("lost", "the odometry reports a motion of 5.0 m in one step")
    assert math.sqrt(watched.added_covariance[0, 0]) == pytest.approx(5.0)
    assert not watched.goes_on_blindly()


def test_a_motion_of_which_the_odometry_knows_nothing_is_a_jump():
    watched = Watched()
    watched_levels(watched, 40)
    unknown = {"wheels": np.zeros(2), "wheel_variances": np.full(2, 0.1**2)}
    assert watched.goes_on(place(40), ranges_at(place(40), WALLS), 0.0, observation=unknown)
    watched.check(SURE, KNOWN)
    reason = "how the robot moved in a gap of its odometry is not known"
    assert watched.status == Status("lost", reason)
    assert math.sqrt(watched.added_covariance[0, 0]) == pytest.approx(0.1 * math.sqrt(2.0))


def test_a_beam_alone_is_no_proof():
    """Its readings change again and again, and contradict the map."""
    watched = Watched()
    free = GridView(np.array([-3.0, -3.0]), 0.1, np.full((60, 60), 9, dtype=np.int16))
    for number in range(100):
        ranges = ROBOT.max_ranges.copy()
        ranges[2] = 0.3 + 0.1 * (number % 9)
        if watched.goes_on(place(number), ranges, 0.05):
            watched.check(SURE, KnownMap(np.zeros((0, 4)), free, SENSOR))
        assert watched.status.level != "lost"
    assert watched.status.level == "unsure"


@pytest.mark.parametrize("counts", [True, False])
def test_bodies_around_the_robot_make_it_lost_only_if_free_space_counts(counts):
    watched = Watched()
    levels = []
    known = KnownMap(WALLS, FREE, SENSOR, free_space_counts=counts)
    watched_levels(watched, 40, known=known)
    for number in range(40, 80):
        ranges = np.where(np.arange(6) < 5, 0.25, ranges_at(place(number), WALLS))
        if watched.goes_on(place(number), ranges):
            watched.check(SURE, known)
        levels.append(watched.status.level)
    assert ("lost" in levels) == counts


@pytest.mark.parametrize(
    ("std", "heading_std", "level"),
    [(0.15, 4.5, "ok"), (0.25, 1.0, "unsure"), (0.01, 5.5, "unsure")],
)
def test_a_pose_that_may_be_off_by_its_covariance_is_unsure(std, heading_std, level):
    watched = Watched()
    covariance = np.diag([std, std, math.radians(heading_std)]) ** 2
    watched_levels(watched, 10, covariance=covariance)
    assert (watched.status.level, watched.status.chance) == (level, chance_off(covariance))
    assert ("the chance that the pose is more than" in watched.status.reason) == (level != "ok")
    assert watched.by_readings == Status(), "the readings fit the map all the same"
    watched_levels(watched, 1, begin=10)
    assert watched.status == Status()


def test_the_worst_robot_counts_and_is_named():
    lost = Status("lost", "a jump")
    unsure = Status("unsure", "a doubt")
    assert worst([lost]) == lost
    assert worst([Status(), unsure, lost]) == Status("lost", "robot 3: a jump")
    assert worst([Status(), Status()]) == Status()
    assert (lost.words, Status().words) == ("lost: a jump", "ok")


def test_the_scores_say_how_long_each_level_lasted():
    time = 3.0 + np.arange(6.0)
    levels = np.array([[0, 0], [1, 0], [1, 0], [0, 2], [0, 2], [0, 1]])
    scores = status_scores(time, levels, Status("unsure", "a doubt"))
    assert scores == {
        "status": "unsure",
        "status_reason": "a doubt",
        "status_chance": 0.5,
        "ok_s": 1.0,
        "unsure_s": 2.0,
        "lost_s": 2.0,
        "first_lost_s": 3.0,
    }
    assert status_scores(time, np.zeros((6, 1), dtype=int), Status())["first_lost_s"] is None


def certain(std=0.05, heading_std=1.0):
    """Covariances of the poses of a path of one robot."""
    one = np.diag([std, std, math.radians(heading_std)]) ** 2
    return np.broadcast_to(one, (50, 1, 3, 3)).copy()


@pytest.mark.parametrize(("share", "level"), [(0.0, "ok"), (0.02, "ok"), (0.07, "lost")])
def test_contradictions_of_the_smoothed_map_count(share, level):
    status = smoothed_status(share, certain())
    assert status.level == level
    words = f"{100.0 * share:.2g} % of the readings contradict the smoothed map"
    assert status.reason == ("" if level == "ok" else words)


def test_the_smoothed_pose_that_is_off_most_likely_counts():
    covariances = certain()
    assert smoothed_status(0.0, covariances) == Status()
    covariances[30] = certain(std=0.3)[0]
    status = smoothed_status(0.0, covariances)
    assert status.chance == pytest.approx(math.exp(-0.5 * (0.5 / 0.3) ** 2), rel=1e-3)
    assert "a pose of the path is more than 0.5 m or 10 deg off is 25 %" in status.reason


def test_a_robot_that_was_lost_to_the_end_is_lost():
    since = lost_since(np.arange(10.0, 20.0), 4)
    assert since == 4.0
    assert lost_since(np.arange(10.0), None) is None
    lost = smoothed_status(0.0, certain(), lost_since=since)
    assert lost == Status("lost", "the place of the robot is unknown from 4 s on")


def test_the_scores_have_the_status_of_the_result_and_of_the_filter():
    levels = np.array([[0, 0], [0, 0], [0, 2], [2, 0], [0, 2]])
    scores = final_status_scores(Status(), Status("lost", "a jump"), 3.0 + np.arange(5.0), levels)
    assert scores == {
        "status": "ok",
        "status_reason": "",
        "status_chance": 0.0,
        "status_note": "lost while driving, from 2 s to the end",
        "status_online": "lost",
        "status_online_reason": "a jump",
    }


BEGIN = 30.0
NOISE = 0.02


@pytest.mark.parametrize(
    ("kind", "world", "seed"),
    [
        ("kidnapped", "env2", 1),
        ("reversed", "env3", 1),
        ("swapped", "env1", 2),
        ("jump", "env2", 3),
    ],
)
def test_a_fault_is_noticed_within_ten_seconds(kind, world, seed):
    levels = []
    agent, rows = steps_with(Fault(kind, BEGIN, seed), world, NOISE, 10.0, seed=seed, note=levels)
    before = levels[: round(BEGIN / 0.1)]
    after = levels[round(BEGIN / 0.1) :]
    assert set(before) == {"ok"}
    assert {"unsure", "lost"} & set(after)
    assert len(rows) == len(levels)
    assert agent.status_reason or agent.status == "ok"


def test_the_uncertainty_of_a_kidnapped_robot_outgrows_its_error():
    agent, rows = steps_with(
        Fault("kidnapped", BEGIN, 1), "env2", NOISE, 25.0, seed=1, finds_places=False
    )
    error = np.hypot(*(rows[-1]["pose"] - agent.snapshot().pose)[:2])
    snapshot = agent.snapshot()
    assert error > 1.0
    assert (agent.status, snapshot.status) == ("lost", "lost")
    assert snapshot.status_reason == snapshot.statuses[0].reason == agent.status_reason != ""
    assert np.sqrt(snapshot.covariance[0, 0] + snapshot.covariance[1, 1]) > error
    np.testing.assert_array_equal(agent.mapper.belief.covariance, snapshot.covariance)
    assert agent.mapper.belief.status == snapshot.statuses[0]
    assert np.trace(agent.slam.covariance) < 1.0
