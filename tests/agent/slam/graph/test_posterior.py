"""The expected error of a smoothed path, by the posterior covariance of its graph."""

import numpy as np
import pytest

from limslam_agent.slam.graph.posterior import aligned_covariance


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
