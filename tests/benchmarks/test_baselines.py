"""Baselines: the table of sample efficiency, and a small training (extra rl)."""

import json

import numpy as np
import pytest

pytest.importorskip("sb3_contrib", reason="needs the extra rl")

from benchmarks.baselines import (
    LEARNERS,
    REFERENCES,
    BaselineConfig,
    RawReadings,
    efficiency_table,
    environment,
    train_baselines,
)


def test_both_learn_for_some_steps_and_go_on(tmp_path):
    config = BaselineConfig(steps=64, seeds=1, every=32, plans=2, held_out=2, envs=2, episode=6, hold=2)
    said, folder = [], tmp_path / "run"
    train_baselines(config, folder, say=said.append)
    assert [line.split(":")[0] for line in said] == [f"{name}-0" for name in (*REFERENCES, *LEARNERS)]
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    for name in (*REFERENCES, *LEARNERS):
        scores = json.loads(before[f"{name}-0.json"])
        assert list(scores) == (["0"] if name in REFERENCES else ["32", "64"])
        assert all(len(each) == 2 and min(each) > 0.0 for each in scores.values())
    assert "| belief | 64 | " in efficiency_table(folder)
    # As if it had been killed before the last learner had ended.
    (folder / "belief-0.json").unlink()
    train_baselines(config, folder, say=said.append)
    assert len(said) == 6
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    with pytest.raises(ValueError, match="other settings"):
        train_baselines(BaselineConfig(steps=65), folder)


def test_the_table_has_what_was_tried(tmp_path):
    scores = {"recurrent": {"100": [0.1, 0.3], "200": [0.2, 0.4]}, "belief": {"100": [0.2, 0.4], "200": [0.5, 0.7]}}
    for name in (*REFERENCES, *LEARNERS):
        for seed in range(3 if name in LEARNERS else 1):
            path = tmp_path / f"{name}-{seed}.json"
            path.write_text(json.dumps(scores.get(name, {"0": [0.3, 0.3]})), encoding="utf-8")
    text = efficiency_table(tmp_path)
    assert "| belief | 200 | 0.60 | 3 |" in text
    assert "P(recurrent sees more than belief after training) = 0.00" in text
    assert "P(recurrent sees more than frontier after training) = 0.50" in text
    assert "| frontier | 0 | 0.30 | 1 |" in text
    assert "P(frontier" not in text


def test_a_decision_is_several_steps():
    """Rewards add up, all readings of a decision are seen, and an episode's last ones are in ``final_obs``."""
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
