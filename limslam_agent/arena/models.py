"""A model of Stable-Baselines3 as an actor. The library need not be installed."""

from pathlib import Path
from typing import Any

import numpy as np

from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation

INPUTS = ("ranges", "wheels")
"""What a model acts on, as the environments give it."""


class Model:
    """A model of Stable-Baselines3 that was trained on the plain observation, a dict of ranges and wheels.

    Parameters
    ----------
    path
        The file of the model.
    algorithm
        The class that made it: ``PPO`` and so on.

    Raises
    ------
    ValueError
        If the library is not installed, the file cannot be read, or the model takes other inputs.
    """

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
