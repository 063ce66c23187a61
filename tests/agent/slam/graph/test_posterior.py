"""The expected error of a smoothed path, by the posterior covariance of its graph."""

import numpy as np
import pytest
from support.corridors import corridor_log

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.chunk_graph import Loop
from limslam_agent.slam.graph.key_poses import ERRORS, Trajectory, choose_keys
from limslam_agent.slam.graph.posterior import aligned_covariance, position_std
from limslam_agent.slam.graph.smooth import relations_of
from limslam_env.geometry import se2

CONFIG = GraphConfig()
MIDDLES = 10
NO_LOOPS = relations_of([], np.zeros(1, dtype=np.int64))


@pytest.fixture(scope="module")
def laps():
    """Two laps of a corridor: its data, key poses, and true path."""
    data, truth = corridor_log(bias=0.0)
    keys = choose_keys(data, CONFIG.keys)
    return data, keys, Trajectory(truth[keys.first_event], np.zeros(ERRORS))


def loops_between_laps(keys, path, chunks):
    """Exact loops between key poses of the first lap and those at the same places in the second one."""
    half = np.searchsorted(keys.key_travel, 0.5 * keys.key_travel[-1])
    firsts = [n for n in range(len(chunks)) if chunks[n] < half]
    seconds = [n for n in range(len(chunks)) if chunks[n] >= half]
    pairs = []
    for first in firsts:
        apart = np.hypot(*(path.poses[chunks[seconds], :2] - path.poses[chunks[first], :2]).T)
        pairs.append((first, seconds[int(np.argmin(apart))]))
    information = np.diag([400.0, 400.0, 2500.0])
    relative = [se2.between(path.poses[chunks[a]], path.poses[chunks[b]]) for a, b in pairs]
    loops = [Loop(*pair, motion, information, 1.0) for pair, motion in zip(pairs, relative, strict=True)]
    return relations_of(loops, chunks)


def test_loops_make_a_path_better_known(laps):
    data, keys, path = laps
    chunks = np.arange(0, len(keys), MIDDLES)
    held = position_std(keys, path, loops_between_laps(keys, path, chunks), CONFIG, data.range_std)
    loose = position_std(keys, path, NO_LOOPS, CONFIG, data.range_std)
    assert 0.0 < held < 0.7 * loose


def test_alignment_removes_what_moves_and_turns_all_positions():
    generator = np.random.default_rng(3)
    places = generator.normal(size=(40, 2)) * [6.0, 2.0]
    centred = places - places.mean(axis=0)
    rigid = np.column_stack([np.tile([1.0, 0.0], 40), np.tile([0.0, 1.0], 40), centred[:, ::-1].ravel()])
    rigid[0::2, 2] *= -1.0
    scattered = np.diag(generator.uniform(0.01, 0.02, 80))
    left = aligned_covariance(scattered + rigid @ np.diag([4.0, 1.0, 0.1]) @ rigid.T, places)
    assert left == pytest.approx(aligned_covariance(scattered, places), abs=1e-9)
    # Sampled positions have this error after alignment.
    samples = places + np.sqrt(np.diag(scattered)).reshape(40, 2) * generator.normal(size=(4000, 40, 2))
    errors = []
    for sample in samples:
        turn = np.arctan2(
            *np.sum([[a * d - b * c, a * c + b * d] for (a, b), (c, d) in zip(sample, centred, strict=True)], axis=0)
        )
        cos, sin = np.cos(turn), np.sin(turn)
        moved = (sample - sample.mean(axis=0)) @ np.array([[cos, sin], [-sin, cos]])
        errors.append(((moved - centred) ** 2).sum(axis=1).mean())
    assert np.mean(errors) == pytest.approx(np.trace(left) / 40.0, rel=0.02)
