"""A run in a small part of a world does not call the world explored."""

import numpy as np
import pytest

from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.results import score
from limslam_agent.runs.run_config import RunConfig
from limslam_env import World

# A room of 1.4 m x 1.4 m in the corner of a hall, with a gap in the hall's outer wall or without one.
ROOM = [[0, 1.4, 1.4, 1.4], [1.4, 1.4, 1.4, 0]]
CLOSED = [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]]
OPEN = [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 4, 4], [3, 4, 0, 4], [0, 4, 0, 0]]
INSIDE = {"starts": np.array([[0.7, 0.7, 0.0]])}


@pytest.mark.parametrize(
    ("walls", "more", "words"), [(CLOSED, INSIDE, "other regions"), (OPEN, {}, "outer wall is open")]
)
def test_a_small_region_is_not_called_the_world(walls, more, words):
    config = RunConfig(World("hall", (6.0, 4.0), np.array(walls + ROOM, dtype=float), **more), seed=1, max_time=200.0)
    (warning,) = config.warnings
    assert words in warning
    episode = run_episode(config)
    assert episode.is_finished
    assert episode.stop_reason.startswith("stopped: the start region is explored, but 9")
    assert episode.stop_reason.endswith("of the floor cannot be reached from it: not explored")
    assert score(episode)["exploration_time_s"] is None


def test_a_whole_world_is_called_explored():
    config = RunConfig(World("room", (6.0, 4.0), np.array(CLOSED, dtype=float)), seed=1, max_time=400.0)
    assert config.warnings == []
    episode = run_episode(config)
    assert episode.stop_reason == "explored: no frontier is left"
    assert score(episode)["exploration_time_s"] == episode.time[-1]
