"""Models of Stable-Baselines3, which is not needed here: a stand-in shows what is asked of it."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from limslam_agent.arena.models import Model as LoadedModel

SEEN = {"ranges": np.full(6, 0.5, dtype=np.float32), "wheels": np.zeros(2, dtype=np.float32)}


def test_a_library_that_is_not_installed_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(ValueError, match="is not installed: pip install"):
        LoadedModel(tmp_path / "m.zip", "PPO")


class Model:
    """What the arena uses of a model of Stable-Baselines3."""

    observation_space = SimpleNamespace(spaces={"ranges": None, "wheels": None})
    action_space = SimpleNamespace(shape=(2,))

    @classmethod
    def load(cls, path, device):
        assert device == "cpu"
        if path.name == "bad.zip":
            raise KeyError("policy")
        return cls()

    def predict(self, observation, deterministic):
        assert deterministic
        return observation["ranges"][:2], None


def test_a_model_of_stable_baselines_acts_on_plain_readings(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "stable_baselines3", SimpleNamespace(PPO=Model))
    np.testing.assert_array_equal(LoadedModel(tmp_path / "m.zip", "PPO").act(SEEN), [0.5, 0.5])
    with pytest.raises(ValueError, match="Stable-Baselines3 has no 'Best'"):
        LoadedModel(tmp_path / "m.zip", "Best")
    with pytest.raises(ValueError, match=r"bad\.zip: cannot be loaded as a model of PPO"):
        LoadedModel(tmp_path / "bad.zip", "PPO")
    monkeypatch.setattr(Model, "observation_space", SimpleNamespace(shape=(8,)))
    with pytest.raises(ValueError, match="was trained with wrappers"):
        LoadedModel(tmp_path / "m.zip", "PPO")
