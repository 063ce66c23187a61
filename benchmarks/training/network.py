"""The trainable version of `DirectionNetwork`, for PPO of Stable-Baselines3."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import Tensor, nn
from torch.nn import functional

from limslam_agent.policies.learned.network import COMPASS, LAYERS, SPREAD, DirectionNetwork
from limslam_agent.policies.learned.polar_view import ViewConfig

WIDTH = 48
_SMALL = 0.01


class DirectionExtractor(nn.Module):
    """Circular convolutions that give a score for each direction, and features for the value.

    In an observation, ``readings`` entries follow the view.
    """

    def __init__(self, view: ViewConfig, readings: int) -> None:
        super().__init__()
        self.view, self.latent_dim_pi, self.latent_dim_vf = view, view.directions, 64
        inputs = view.rows
        self._size = inputs * view.directions
        self.first = nn.Conv1d(inputs + COMPASS, WIDTH, 5)
        self.state = nn.Linear(readings, WIDTH)
        self.second = nn.Conv1d(WIDTH, WIDTH, 3, dilation=SPREAD["second"])
        self.third = nn.Conv1d(WIDTH, WIDTH, 3, dilation=SPREAD["third"])
        self.score = nn.Conv1d(WIDTH + inputs + COMPASS, 1, 1)
        self.value = nn.Sequential(nn.Linear(2 * WIDTH + readings, 64), nn.ReLU())
        angles = 2.0 * np.pi * np.arange(view.directions) / view.directions
        compass = torch.as_tensor(np.stack((np.cos(angles), np.sin(angles))), dtype=torch.float32)
        self.register_buffer("compass", compass)

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Scores (n, directions), and features for the value (n, 64)."""
        features, told, state = self._trunk(observation)
        return self._scores(features, told), self._summary(features, state)

    def forward_actor(self, observation: Tensor) -> Tensor:
        """Scores (n, directions)."""
        features, told, _ = self._trunk(observation)
        return self._scores(features, told)

    def forward_critic(self, observation: Tensor) -> Tensor:
        """Features for the value (n, 64)."""
        features, _, state = self._trunk(observation)
        return self._summary(features, state)

    def _scores(self, features: Tensor, told: Tensor) -> Tensor:
        return torch.as_tensor(self.score(torch.cat((features, told), dim=1))[:, 0])

    def _trunk(self, observation: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        count = len(observation)
        state = observation[:, self._size :]
        view = observation[:, : self._size].reshape(count, -1, self.view.directions)
        compass = torch.as_tensor(self.compass).expand(count, -1, -1)
        told = torch.cat((view, compass), dim=1)
        values = _around(self.first, told) + self.state(state)[:, :, None]
        values = functional.relu(_around(self.second, functional.relu(values)))
        return functional.relu(_around(self.third, values)), told, state

    def _summary(self, features: Tensor, state: Tensor) -> Tensor:
        return torch.as_tensor(self.value(torch.cat((features.mean(dim=2), features.amax(dim=2), state), dim=1)))

    def to_numpy(self) -> DirectionNetwork:
        """The policy in the form that a robot runs."""
        weights = {
            f"{layer}.{part}": getattr(getattr(self, layer), part).detach().cpu().numpy().copy()
            for layer in LAYERS
            for part in ("weight", "bias")
        }
        return DirectionNetwork(weights, self.view)


def _around(layer: nn.Conv1d, values: Tensor) -> Tensor:
    half = layer.dilation[0] * (layer.kernel_size[0] // 2)
    if half == 0:
        return torch.as_tensor(layer(values))
    return torch.as_tensor(layer(torch.cat((values[:, :, -half:], values, values[:, :, :half]), dim=2)))


class DirectionPolicy(ActorCriticPolicy):
    """Actor and critic with shared layers; the scores are the logits. The view is the only argument of its own."""

    def __init__(self, *args: Any, view: ViewConfig, **kwargs: Any) -> None:
        self._view = view
        super().__init__(*args, ortho_init=False, **kwargs)

    def _build_mlp_extractor(self) -> None:
        view = self._view
        readings = self.features_dim - view.rows * view.directions
        self.mlp_extractor = DirectionExtractor(view, readings)

    def _build(self, lr_schedule: Callable[[float], float]) -> None:
        super()._build(lr_schedule)
        # No parameters are needed between scores and logits. Small initial weights of the last layer give nearly equal
        # probabilities.
        self.action_net = nn.Identity()
        with torch.no_grad():
            self.mlp_extractor.score.weight.mul_(_SMALL)
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)
