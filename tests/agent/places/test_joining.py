"""Two robots with unknown relative starts join when their maps fit together in one place only, and
else stay apart.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from limslam_agent import LimSlamTeam, Mapper, preset
from limslam_agent.grid.occupancy import GridView
from limslam_agent.mapping.joining import NOT_YET_CONFIRMED, NOT_YET_JOINED, JoiningMapper
from limslam_agent.output.summary import record_summary
from limslam_agent.places.other_map import Meeting
from limslam_agent.places.saved_map import SavedMap
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.results import final_status, write_episode
from limslam_agent.runs.run_config import RunConfig
from limslam_agent.status.status import LEVELS
from limslam_env import NominalNoise, RobotSpec
from limslam_env.geometry import se2

NOISE = 0.02
HERE = np.zeros(3)


def two_robots(seed, max_time):
    return RunConfig(
        "env2",
        NOISE,
        seed=seed,
        max_time=max_time,
        until="seen",
        robots=2,
        unknown_starts=True,
    )


@pytest.fixture(scope="module")
def episode():
    return run_episode(two_robots(201, 115.0))


@pytest.fixture(scope="module")
def early():
    """A run that ends before the maps overlap."""
    return run_episode(two_robots(201, 6.0))


def observations_of(episode, step):
    return [{"ranges": episode.ranges[step, n], "wheels": episode.wheels[step, n]} for n in (0, 1)]


def test_two_robots_become_a_team(episode):
    event, *_ = episode.places.records
    assert event["event"] == "joined"
    assert event["match"]["accepted"]
    assert episode.placed_robots == 2
    off = np.hypot(*(episode.estimated - episode.true)[..., :2].transpose(2, 0, 1))
    assert off.max() < 0.5
    assert episode.snapshot.statuses[1] == NOT_YET_CONFIRMED
    before = slice(event["step"])
    assert (episode.levels[before, 1] == 1).all()
    assert (episode.levels[before, 0] == 0).mean() > 0.9
    # The start of the second robot is uncertain in the shared frame, and its error is as large as
    # it says.
    start = np.array(event["start"]) - episode.true[0, 1]
    covariance = episode.covariances[0, 1]
    start[2] = se2.wrap_angle(start[2])
    assert start @ np.linalg.solve(covariance, start) < 16.3, (
        "the 99.9 % limit of three degrees of freedom"
    )
    np.testing.assert_allclose(episode.odometry[0, 1], event["start"], atol=1e-9)


def test_a_joining_to_which_something_objects_is_taken_back(episode, monkeypatch):
    mapper = JoiningMapper(RobotSpec(), preset("graph", NominalNoise(NOISE)))
    mapper.reset(np.array([episode.true[0, 0], HERE]))
    last = episode.places.records[0]["step"]
    for step in range(last + 1):
        mapper.step(*observations_of(episode, step))
    assert not mapper.is_apart
    monkeypatch.setattr(Meeting, "objection", lambda *_, **__: "made up")
    while not mapper.is_apart:
        step += 1
        mapper.step(*observations_of(episode, step))
    assert [each["event"] for each in mapper.places.records] == ["joined", "parted"]
    assert mapper.places.records[1]["reason"] == "made up"
    assert len(mapper.earlier.poses) == step + 1
    np.testing.assert_array_equal(mapper.earlier.poses[-1], mapper.poses)
    np.testing.assert_allclose(mapper.earlier.odometry[-1], mapper.odometry, atol=1e-9)
    # Each robot has the map that it makes by itself.
    alone = Mapper(
        RobotSpec(), replace(preset("graph", NominalNoise(NOISE)), free_space_counts=False), HERE
    )
    for number in range(step + 1):
        alone.step(observations_of(episode, number)[1])
    np.testing.assert_array_equal(mapper.poses[1], alone.slam.pose)
    while mapper.is_apart:
        step += 1
        mapper.step(*observations_of(episode, step))
    assert mapper.places.records[-1]["event"] == "joined", "the search goes on"


def test_a_joined_run_is_smoothed_with_an_unknown_start(episode):
    smoothed = episode.smoothed
    off = np.hypot(*(smoothed.poses - episode.true)[..., :2].transpose(2, 0, 1))
    assert off.max() < 0.3
    np.testing.assert_array_equal(smoothed.covariances[0, 1], smoothed.covariances[1, 1])
    assert np.trace(smoothed.covariances[0, 1]) > 0.0
    assert final_status(episode)["status"] == "unsure", "the joining is not confirmed"


def test_robots_that_do_not_join_leave_two_maps(early, tmp_path):
    assert not early.is_joined
    assert early.smoothed is None
    assert early.placed_robots == 1
    (event,) = early.places.records
    assert event["event"] == "not joined"
    assert np.sqrt(early.covariances[:, 1, 0, 0]).min() >= 10.0
    assert early.snapshot.statuses[1] == NOT_YET_JOINED
    result = write_episode(tmp_path, early)
    assert result["metrics"]["ate_m"] < 0.1, "the metrics are those of the first robot"
    assert json.loads((tmp_path / "map_unplaced.json").read_text())["frame"] == "local"
    (line,) = [line for line in record_summary(result) if line.startswith("place ")]
    assert "the map of the second robot is in map_unplaced.json" in line


def test_the_body_of_a_robot_that_is_not_known_contradicts_no_map():
    met = run_episode(two_robots(9309, 52.0))
    assert not met.is_joined
    assert (met.wall_seen[:, 0] == -2).sum() > 50, "the first robot has seen the second one"
    assert met.levels[:, 0].max() < LEVELS.index("lost")


def test_a_team_with_unknown_starts_is_two_robots():
    with pytest.raises(ValueError, match="two robots"):
        LimSlamTeam(RobotSpec(), num_robots=3, unknown_starts=True)
    empty = SavedMap(
        np.zeros((0, 4)), [], GridView(np.zeros(2), 0.1, np.zeros((1, 1), dtype=np.int16))
    )
    with pytest.raises(ValueError, match="without the map"):
        LimSlamTeam(RobotSpec(), num_robots=2, prior_map=empty, unknown_starts=True)
    mapper = JoiningMapper(RobotSpec())
    with pytest.raises(ValueError, match="1 observations for 2 robots"):
        mapper.step({"ranges": np.full(6, 1.0), "wheels": np.zeros(2)})
    with pytest.raises(ValueError, match="wheel travel"):
        mapper.step(*[{"ranges": np.full(6, 1.0), "odometry": np.zeros(3)}] * 2)
