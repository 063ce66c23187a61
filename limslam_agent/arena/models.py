"""Trained models as actors: a file of Stable-Baselines3 or of ONNX. Both libraries need not be installed."""

from pathlib import Path
from typing import Any, Protocol

import numpy as np

from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation, RobotSpec

INPUTS = ("ranges", "wheels")
"""Inputs of an ONNX model by their names, float32 of the shapes (1, n_beams) and (1, 2), as the environments give
them.
"""


class Actor(Protocol):
    """Anything that turns an observation into wheel speeds."""

    def act(self, observation: Observation) -> FloatArray:
        """Wheel speeds (2,), left and right, as fractions from -1 to 1."""
        ...


def load_model(path: Path, algorithm: str, robot: RobotSpec) -> Actor:
    """The actor of a model's file.

    Raises
    ------
    ValueError
        If the library is not installed, the file cannot be read, or the model takes other inputs.
    """
    return _OnnxActor(path, robot) if path.suffix == ".onnx" else _StableBaselinesActor(path, algorithm)


class _StableBaselinesActor:
    """A model of Stable-Baselines3 that was trained on the plain observation, a dict of ranges and wheels."""

    def __init__(self, path: Path, algorithm: str) -> None:
        try:
            import stable_baselines3
        except ImportError as error:
            raise ValueError(f"{path}: Stable-Baselines3 is not installed: pip install 'limslam[rl]'") from error
        maker: Any = getattr(stable_baselines3, algorithm, None)
        if not hasattr(maker, "load"):
            raise ValueError(f"{path}: algorithm: Stable-Baselines3 has no {algorithm!r}")
        try:
            self._model: Any = maker.load(path, device="cpu")
        except Exception as error:  # a damaged file may raise anything
            raise ValueError(f"{path}: cannot be loaded as a model of {algorithm}: {error}") from error
        keys = getattr(self._model.observation_space, "spaces", {})
        if set(keys) != set(INPUTS) or self._model.action_space.shape != (2,):
            raise ValueError(
                f"{path}: was trained with wrappers of the environment, which a file does not hold: enter it as a "
                "python class that loads the model and applies them"
            )

    def act(self, observation: Observation) -> FloatArray:
        """Wheel speeds (2,), without exploration noise."""
        action, _ = self._model.predict(observation, deterministic=True)
        return np.asarray(action, dtype=float)


class _OnnxActor:
    """An ONNX model with the inputs of ``INPUTS`` and one output (1, 2). It runs in one thread, so that it repeats."""

    def __init__(self, path: Path, robot: RobotSpec) -> None:
        try:
            import onnxruntime
        except ImportError as error:
            raise ValueError(f"{path}: ONNX Runtime is not installed: pip install 'limslam[onnx]'") from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        try:
            self._session = onnxruntime.InferenceSession(path.read_bytes(), options, ["CPUExecutionProvider"])
        except Exception as error:  # a damaged file may raise anything
            raise ValueError(f"{path}: cannot be loaded by ONNX Runtime: {error}") from error
        names = {each.name for each in self._session.get_inputs()}
        if names != set(INPUTS):
            raise ValueError(f"{path}: the model's inputs are {', '.join(sorted(names))}, not {' and '.join(INPUTS)}")
        self._beams = len(robot.beams)

    def act(self, observation: Observation) -> FloatArray:
        """Wheel speeds (2,), clipped to -1 to 1."""
        told = {
            "ranges": np.asarray(observation["ranges"], np.float32).reshape(1, self._beams),
            "wheels": np.asarray(observation["wheels"], np.float32).reshape(1, 2),
        }
        answer: FloatArray = np.asarray(self._session.run(None, told)[0], dtype=float).reshape(2)
        return np.clip(answer, -1.0, 1.0)
