"""A wrapper around :class:`limslam_env.envs.env.LimSlamEnv` that is common in reinforcement learning.

Gymnasium's own wrappers do the rest: ``FlattenObservation``, ``FrameStackObservation``, ``TransformAction``.
"""

from typing import Any, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium import spaces

Observation: TypeAlias = dict[str, Any]


class NormalizedObservation(gym.ObservationWrapper[Observation, Any, Observation]):
    """Ranges from 0 (a beam's shortest) to 1 (its longest, or nothing seen), wheel travel from -1 to 1.

    Parameters
    ----------
    env
        An environment with ``ranges`` and ``wheels`` in its observation; other keys stay as they are.

    Raises
    ------
    ValueError
        If the observation has no such keys.
    """

    def __init__(self, env: gym.Env[Observation, Any]) -> None:
        super().__init__(env)
        space = env.observation_space
        if not isinstance(space, spaces.Dict) or not {"ranges", "wheels"} <= set(space.spaces):
            raise ValueError(f"the observation must hold ranges and wheels, not {space}")
        self._ranges: Any = space["ranges"]
        self._wheels: Any = space["wheels"]
        scaled = {
            "ranges": spaces.Box(0.0, 1.0, self._ranges.shape, np.float32),
            "wheels": spaces.Box(-1.0, 1.0, self._wheels.shape, np.float32),
        }
        self.observation_space = spaces.Dict({**space.spaces, **scaled})

    def observation(self, observation: Observation) -> Observation:
        """The observation, scaled."""
        low, high = self._ranges.low, self._ranges.high
        ranges = np.clip((observation["ranges"] - low) / (high - low), 0.0, 1.0)
        wheels = np.clip(observation["wheels"] / self._wheels.high, -1.0, 1.0)
        return {**observation, "ranges": ranges.astype(np.float32), "wheels": wheels.astype(np.float32)}
