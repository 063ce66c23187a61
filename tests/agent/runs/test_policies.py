"""The policies of a run by their names, and the tour, which knows the true pose."""

import numpy as np
import pytest

from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.results import score
from limslam_agent.runs.run_config import RunConfig
from limslam_env import World

WALLS = [[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0], [2, 0, 2, 1.6]]
LOOP = [[1.0, 1.0], [1.0, 2.3], [3.0, 2.3], [3.0, 1.0], [3.0, 2.3], [1.0, 2.3]]
BARE = World("bare", (4.0, 3.0), WALLS)
ROOM = World("room", (4.0, 3.0), WALLS, starts=[[1.0, 0.8, 0.4], [3.0, 1.0, 2.0]], loop=LOOP)


def run(policy, **settings):
    return run_episode(RunConfig(ROOM, policy=policy, **{"noise": 0.02, "max_time": 120.0, **settings}))


@pytest.fixture(scope="module")
def tour():
    return run("tour")


@pytest.mark.parametrize("settings", [{"preset": "odometry"}, {"preset": "paper", "ablation": "no-ekf"}])
def test_every_estimator_listens_to_the_same_drive(tour, settings):
    other = run("tour", **settings)
    assert len(tour.time) > 100
    for name in ("time", "ranges", "wheels", "actions", "true", "wall_seen", "coverage"):
        np.testing.assert_array_equal(getattr(tour, name), getattr(other, name))
    assert not np.array_equal(tour.estimated, other.estimated)


def test_a_tour_is_no_exploration(tour):
    scores = score(tour)
    assert scores["stop_reason"] == "the tour is driven"
    assert scores["exploration_time_s"] is None
    assert scores["collisions"] == 0
    np.testing.assert_allclose(tour.true[-1, 0, :2], LOOP[0], atol=0.005)
    # The filter was there all the time.
    assert scores["ate_m"] > 0.0
    assert scores["landmarks"] >= 4


def test_a_tour_is_driven_as_often_as_laps_say(tour):
    twice = run("tour", laps=2)
    assert twice.time[-1] == pytest.approx(2.0 * tour.time[-1], rel=0.05)


@pytest.mark.parametrize("policy", ["wall_follower", "random"])
def test_policies_to_compare_with_drive_by_what_they_believe(policy):
    episode = run(policy, robots=2, max_time=20.0)
    lengths = np.abs(np.diff(episode.true[..., :2], axis=0)).sum(axis=(0, 2))
    assert (lengths > 0.5).all()
    again, other = run(policy, robots=2, max_time=20.0), run(policy, robots=2, max_time=20.0, seed=1)
    np.testing.assert_array_equal(again.true, episode.true)
    assert not np.array_equal(other.true, episode.true)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            {"policy": "magic"},
            "no policy is called 'magic'; there are frontier, frontier_fast, wall_follower, random, learned, tour",
        ),
        ({"policy": "random", "laps": 2}, "not with 'random'"),
        ({"policy": "tour", "robots": 2}, "'tour' is for one robot"),
        ({"laps": 1, "world": BARE}, "no loop"),
        ({"policy": "tour", "world": BARE}, "no loop"),
    ],
)
def test_what_cannot_be_driven_is_refused_before_it_begins(settings, words):
    with pytest.raises(ValueError, match=words) as refusal:
        RunConfig(**{"world": ROOM, **settings})
    assert "\n" not in str(refusal.value)
