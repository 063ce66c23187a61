"""A long drive in one building: error, consistency and the size of the map stay bounded."""

from dataclasses import replace

import numpy as np
import pytest

from limslam_agent import preset
from limslam_agent.config.smoother import RenewalConfig
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.run_config import RunConfig
from limslam_env.interface import NominalNoise
from limslam_env.metrics import consistency_metrics


@pytest.mark.slow
def test_ten_minutes_in_one_building_end_as_they_began():
    settings = replace(preset("graph", NominalNoise(0.02)), renewal=RenewalConfig(period=120.0))
    run = RunConfig("env3", 0.02, seed=100, policy="tour", laps=100, max_time=600.0, settings=settings)
    landmarks = []
    episode = run_episode(run, lambda team, *_: landmarks.append(len(team.slam.all_landmarks)))
    error = np.hypot(*(episode.estimated - episode.true)[:, 0, :2].T)
    quarters = np.array_split(np.arange(len(error)), 4)
    first, *_, last = (np.sqrt(np.mean(error[part] ** 2)) for part in quarters)
    assert last <= 1.5 * max(first, 0.03)
    part = quarters[-1]
    scores = consistency_metrics(episode.true[part, 0], episode.estimated[part, 0], episode.covariances[part, 0])
    assert scores["anees"] <= 3.0
    assert landmarks[-1] <= 1.3 * landmarks[len(landmarks) // 4]
