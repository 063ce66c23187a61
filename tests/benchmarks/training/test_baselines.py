"""Sample efficiency: its statistics, its table, and a small training where the extra rl is."""

import json

import numpy as np
import pytest
from scipy import stats

from benchmarks.training.efficiency import (
    FORMAT,
    curves_of,
    draw_efficiency,
    efficiency_table,
    interquartile_mean,
    probability_of_improvement,
)
from limslam_agent.measurements.store import RESULTS, read_rows


def written(folder, scores):
    """Trials of learners: scores by learner, seed and steps."""
    rows = [
        {
            "learner": learner,
            "seed": seed,
            "coverage": tried,
            "returns": {k: [10.0 * x for x in tried[k]] for k in tried},
        }
        for learner, seeds in scores.items()
        for seed, tried in enumerate(seeds)
    ]
    (folder / RESULTS).write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")


def test_the_interquartile_mean_is_that_of_all_scores():
    scores = np.random.default_rng(1).random((4, 6))
    found = interquartile_mean(scores)
    assert found.value == pytest.approx(np.sort(scores.ravel())[6:18].mean())
    assert scores.min() < found.low < found.value < found.high < scores.max()
    assert found == interquartile_mean(scores)


def test_seeds_are_resampled_as_wholes():
    """Plans that differ among themselves say nothing about other seeds."""
    found = interquartile_mean(np.tile(np.linspace(0.0, 1.0, 9), (3, 1)))
    assert found.low == found.value == found.high


def test_the_probability_of_improvement_is_the_mean_statistic_of_mann_and_whitney():
    draws = np.random.default_rng(2)
    first, second = draws.random((5, 3)).round(1), draws.random((4, 3)).round(1)
    expected = np.mean([stats.mannwhitneyu(first[:, k], second[:, k]).statistic / 20.0 for k in range(3)])
    assert probability_of_improvement(first, second).value == pytest.approx(expected)
    assert probability_of_improvement(first, first).value == pytest.approx(0.5)
    certain = probability_of_improvement(first + 2.0, second)
    assert (certain.value, certain.low, certain.high) == (1.0, 1.0, 1.0)


def test_a_policy_that_does_not_learn_is_known():
    """Only the seeds of the learner are resampled."""
    learner, known = np.array([[0.2], [0.4], [0.6], [0.8]]), np.array([[0.5]])
    found = probability_of_improvement(learner, known)
    assert found.value == 0.5
    assert found.low < 0.5 < found.high
    assert probability_of_improvement(known, learner).low is None


def test_the_table_has_what_was_tried(tmp_path):
    belief, recurrent = {"100": [0.2, 0.4], "200": [0.5, 0.7]}, {"100": [0.1, 0.3], "200": [0.2, 0.4]}
    written(tmp_path, {"frontier": [{"0": [0.3, 0.3]}], "recurrent": [recurrent] * 3, "belief": [belief] * 3})
    text = efficiency_table(tmp_path)
    assert "| belief | 200 | 0.60 | 6.0 | 3 |" in text
    assert "P(recurrent sees more than belief after training) = 0.00" in text
    assert "P(recurrent sees more than frontier after training) = 0.50" in text
    assert "| frontier | 0 | 0.30 | 3.0 | 1 |" in text
    assert "P(frontier" not in text
    draw_efficiency(tmp_path, tmp_path / "efficiency.png")
    assert (tmp_path / "efficiency.png").stat().st_size > 1000
    (tmp_path / RESULTS).write_text("")
    with pytest.raises(ValueError, match="no trials of learners"):
        efficiency_table(tmp_path)


def test_both_learn_for_some_steps_and_go_on(tmp_path):
    pytest.importorskip("sb3_contrib", reason="needs the extra rl")
    from benchmarks.training.baselines import REFERENCES, BaselineConfig, train_baselines

    config = BaselineConfig(steps=64, seeds=1, every=32, plans=2, held_out=2, envs=2, episode=6, hold=2)
    said = []
    train_baselines(config, tmp_path / "run", say=said.append)
    assert [line.split(":")[0] for line in said] == ["recurrent, seed 0", "belief, seed 0"]
    curves = curves_of(read_rows(FORMAT, tmp_path / "run"), "coverage")
    tried = {name: [0] for name in REFERENCES} | {"recurrent": [32, 64], "belief": [32, 64]}
    assert {learner: list(curve) for learner, curve in curves.items()} == tried
    assert all(
        (scores > 0.0).all() and scores.shape == (1, 2) for curve in curves.values() for scores in curve.values()
    )
    # As if it had been killed before the last row.
    path = tmp_path / "run" / RESULTS
    before = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(before[:-1]))
    train_baselines(config, tmp_path / "run", say=said.append)
    assert path.read_bytes().splitlines(keepends=True) == before
    with pytest.raises(ValueError, match="other settings"):
        train_baselines(BaselineConfig(steps=65), tmp_path / "run")


def test_a_decision_is_several_steps():
    """Rewards add up, all readings of a decision are seen, and an episode's last ones are in ``final_obs``."""
    pytest.importorskip("sb3_contrib", reason="needs the extra rl")
    from benchmarks.training.baselines import BaselineConfig, RawReadings, environment

    config = BaselineConfig(plans=2, envs=2, episode=2, hold=3)
    held, once = environment("recurrent", config, is_trial=False), environment("recurrent", config, is_trial=False)
    single = RawReadings(once.env, 1)
    seen, _ = held.reset(seed=1)
    first, _ = single.reset(seed=1)
    np.testing.assert_array_equal(seen, np.tile(first, 3))
    action = np.full((2, 2), 0.4, dtype=np.float32)
    for decision in range(2):
        parts = [single.step(action) for _ in range(3)]
        seen, reward, _, truncated, info = held.step(action)
        np.testing.assert_allclose(reward, sum(part[1] for part in parts))
        assert truncated.all() == (decision == 1)
        last = [part[0] for part in parts]
        if decision == 1:
            np.testing.assert_array_equal(seen, np.tile(last[-1], 3))
            last[-1], seen = np.stack(list(parts[-1][-1]["final_obs"])), np.stack(list(info["final_obs"]))
        np.testing.assert_array_equal(seen, np.concatenate(last, axis=1))
