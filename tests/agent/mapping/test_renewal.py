"""Renewal of the online estimate: a stretch is smoothed and joined with the map from before."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.drives import along, drive, room

from limslam_agent import LineSlam, Mapper, preset
from limslam_agent.config.smoother import RenewalConfig
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.mapping.renewal import Renewal
from limslam_agent.record import Drive, Scan
from limslam_env import NominalNoise, RobotSpec
from limslam_env.geometry import se2

ROBOT = RobotSpec()
NOISE = NominalNoise(0.02)
START = np.array([0.6, 0.6, 0.0])
CORNERS = [(0.6, 0.6), (2.4, 0.6), (2.4, 1.8), (0.6, 1.8)]
WALLS = room(0.0, 0.0, 3.0, 2.4)
ROUND_S = 24.0  # longer than one of the rounds takes
NEVER = replace(preset("graph", NOISE), renewal=None)


def config(period):
    return replace(NEVER, renewal=RenewalConfig(period=period))


def rounds(count, seed=0):
    """Noisy observations on some rounds through a room, and the true poses (t, 3)."""
    told, true = drive(
        WALLS, START, along([*CORNERS * count, CORNERS[0]]), noise=NOISE.range_std, seed=seed
    )
    generator = np.random.default_rng(seed)
    for each in told:
        travel = each["wheels"]
        each["wheels"] = travel + np.sqrt(
            NOISE.wheel_variance * np.abs(travel)
        ) * generator.standard_normal(2)
    return told, true


def driven(settings, told):
    """The SLAM after a drive, its poses (t, 3) and covariances (t, 3, 3), and the steps after which
    it was renewed.
    """
    slam = LineSlam(ROBOT, settings, START)
    drive = Drive()
    renewal = Renewal(slam, settings, OccupancyGrid(settings.grid), drive)
    poses = []
    covariances = []
    renewed = []
    for step, observation in enumerate(told):
        slam.step(observation)
        ranges = slam.robots[0].reported
        drive.scans.append(Scan(slam.pose, ranges, slam.increments[0], observation))
        if renewal.is_possible:
            renewal.note(observation)
            if renewal.renew_if_due():
                renewed.append(step)
        poses.append(slam.pose)
        covariances.append(slam.covariance)
    return slam, np.array(poses), np.array(covariances), renewed


@pytest.fixture(scope="module")
def long_drive():
    told, true = rounds(8)
    return told, true, driven(config(ROUND_S), told)


def test_a_renewed_estimate_stays_accurate_and_honest(long_drive):
    _, true, (slam, poses, covariances, renewed) = long_drive
    assert len(renewed) >= 5
    error = poses - true
    error[:, 2] = se2.wrap_angle(error[:, 2])
    last = slice(-200, None)
    assert np.hypot(*error[last, :2].T).max() < 0.1
    nees = (
        np.einsum("ni,nij,nj->n", error[last], np.linalg.inv(covariances[last]), error[last]) / 3.0
    )
    assert nees.mean() < 3.0
    assert len(slam.all_landmarks) == 4


def test_renewals_say_nothing_about_the_global_heading(long_drive):
    # No reading tells it, however often the same walls are seen.
    *_, (_, _, covariances, renewed) = long_drive
    stds = np.sqrt(covariances[renewed, 2, 2])
    assert stds[-1] > 0.8 * stds[0]
    assert stds[-1] < math.radians(4.0)


def test_a_stretch_with_a_step_by_odometry_is_not_renewed():
    told, _ = rounds(1)
    told = [dict(observation) for observation in told]
    for observation in told[50::100]:
        observation["odometry"] = [float(np.mean(observation.pop("wheels"))), 0.0, 0.0]
    assert not driven(config(20.0), told)[-1]
    assert driven(config(5.0), told)[-1]


def test_a_stretch_that_contradicts_itself_is_not_used():
    told, _ = rounds(3)
    # The robot is carried to another place in the middle of the stretch.
    told = told[: len(told) // 2] + told[len(told) // 2 + 120 :]
    slam, poses, _, renewed = driven(config(0.1 * len(told)), told)
    _, plain, _, _ = driven(NEVER, told)
    assert not renewed
    np.testing.assert_array_equal(poses, plain)
    assert len(slam.all_landmarks) > 0


def test_a_renewal_that_moves_the_path_far_begins_a_new_frame(monkeypatch):
    told, _ = rounds(2)
    frames = []
    for far in (0.3, 0.0):
        monkeypatch.setattr("limslam_agent.mapping.renewal.LARGE_CORRECTION", far)
        mapper = Mapper(ROBOT, config(ROUND_S), START)
        for observation in told:
            mapper.step(observation)
        frames.append(mapper.belief.frame)
        assert mapper.belief.status.level == "ok"
    assert frames[0] == 0
    assert frames[1] >= 1


def test_a_robot_that_stands_still_is_not_renewed():
    told, _ = drive(WALLS, START, [(0.0, 0.0)] * 300)
    _, _, _, renewed = driven(config(10.0), told)
    assert not renewed


def test_a_team_is_never_renewed():
    slam = LineSlam(ROBOT, config(10.0), np.array([START, START + 1.0]))
    assert not Renewal(slam, slam.config, OccupancyGrid(slam.config.grid), Drive()).is_possible
    with pytest.raises(TypeError, match="single robot"):
        _ = slam.map_state


def misled(told, at, off):
    """A mapper whose filter is put at a wrong pose after a step, and the events of its search for
    its place.
    """
    mapper = Mapper(ROBOT, preset("graph", NOISE), START)
    for step, observation in enumerate(told):
        mapper.step(observation)
        if step == at:
            mapper.slam.relocate(se2.compose(mapper.slam.pose, np.array(off)), 1e-4 * np.eye(3))
    return mapper, [record["event"] for record in mapper.places.records]


def test_a_robot_that_a_wrong_estimate_has_made_lost_is_renewed(monkeypatch):
    """The filter is put at a wrong pose, as by a wrong association, and cannot take that back."""
    told, true = rounds(3)
    monkeypatch.setattr("limslam_agent.mapping.recovery.Recovery._seek_near", lambda *_: None)
    mapper, events = misled(told, 330, (0.35, 0.3, 0.4))
    assert events[:2] == ["lost", "renewed"]
    assert mapper.frame > 0
    assert np.hypot(*(mapper.slam.pose - true[-1])[:2]) < 0.15
    begin = mapper.places.revisions[0].begin
    revised = mapper.places.revisions[0].poses
    assert np.hypot(*(revised - true[begin : begin + len(revised)])[:, :2].T).max() < 0.15, (
        "also the earlier poses"
    )
