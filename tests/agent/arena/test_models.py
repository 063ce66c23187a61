"""Models of Stable-Baselines3 and ONNX. Neither library is needed here: stand-ins show what is asked of them."""

import importlib.util
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from limslam_agent.arena.models import load_model
from limslam_env.interface import RobotSpec

SEEN = {"ranges": np.full(6, 0.5, dtype=np.float32), "wheels": np.zeros(2, dtype=np.float32)}


@pytest.mark.parametrize(("name", "library"), [("m.zip", "stable_baselines3"), ("m.onnx", "onnxruntime")])
def test_a_library_that_is_not_installed_is_named(tmp_path, monkeypatch, name, library):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ValueError, match="is not installed: pip install"):
        load_model(tmp_path / name, "PPO", RobotSpec())


def stand_in(name, **parts):
    module = ModuleType(name)
    module.__dict__.update(parts)
    return module


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
    monkeypatch.setitem(sys.modules, "stable_baselines3", stand_in("stable_baselines3", PPO=Model))
    np.testing.assert_array_equal(load_model(tmp_path / "m.zip", "PPO", RobotSpec()).act(SEEN), [0.5, 0.5])
    with pytest.raises(ValueError, match="Stable-Baselines3 has no 'Best'"):
        load_model(tmp_path / "m.zip", "Best", RobotSpec())
    with pytest.raises(ValueError, match=r"bad\.zip: cannot be loaded as a model of PPO"):
        load_model(tmp_path / "bad.zip", "PPO", RobotSpec())
    monkeypatch.setattr(Model, "observation_space", SimpleNamespace(shape=(8,)))
    with pytest.raises(ValueError, match="was trained with wrappers"):
        load_model(tmp_path / "m.zip", "PPO", RobotSpec())


class Session:
    """What the arena uses of a session of ONNX Runtime."""

    inputs = ("ranges", "wheels")

    def __init__(self, content, options, providers):
        assert (options.intra_op_num_threads, providers) == (1, ["CPUExecutionProvider"])
        if content != b"model":
            raise RuntimeError("not a model")

    def get_inputs(self):
        return [SimpleNamespace(name=name) for name in self.inputs]

    def run(self, _names, told):
        assert {name: each.shape for name, each in told.items()} == {"ranges": (1, 6), "wheels": (1, 2)}
        return [np.array([[5.0, -0.5]], dtype=np.float32)]


def test_an_onnx_model_acts_on_plain_readings(tmp_path, monkeypatch):
    library = stand_in("onnxruntime", InferenceSession=Session, SessionOptions=SimpleNamespace)
    monkeypatch.setitem(sys.modules, "onnxruntime", library)
    (tmp_path / "m.onnx").write_bytes(b"model")
    np.testing.assert_array_equal(load_model(tmp_path / "m.onnx", "", RobotSpec()).act(SEEN), [1.0, -0.5])
    (tmp_path / "bad.onnx").write_bytes(b"text")
    with pytest.raises(ValueError, match=r"bad\.onnx: cannot be loaded by ONNX Runtime: not a model"):
        load_model(tmp_path / "bad.onnx", "", RobotSpec())
    monkeypatch.setattr(Session, "inputs", ("observation",))
    with pytest.raises(ValueError, match="inputs are observation, not ranges and wheels"):
        load_model(tmp_path / "m.onnx", "", RobotSpec())


def test_a_real_onnx_model_acts(tmp_path):
    if not (importlib.util.find_spec("onnx") and importlib.util.find_spec("onnxruntime")):
        pytest.skip("onnx and onnxruntime are not installed")
    import onnx
    from onnx import TensorProto, helper

    inputs = [helper.make_tensor_value_info(n, TensorProto.FLOAT, [1, k]) for n, k in (("ranges", 6), ("wheels", 2))]
    graph = helper.make_graph(
        [helper.make_node("Identity", ["wheels"], ["speeds"])], "still", inputs,
        [helper.make_tensor_value_info("speeds", TensorProto.FLOAT, [1, 2])],
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    (tmp_path / "m.onnx").write_bytes(model.SerializeToString())
    assert onnx.checker.check_model(model) is None
    np.testing.assert_array_equal(load_model(tmp_path / "m.onnx", "", RobotSpec()).act(SEEN), [0.0, 0.0])
