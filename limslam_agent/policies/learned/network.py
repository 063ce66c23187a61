"""The network of the learned policy in numpy. It needs no deep-learning library and executes no
code from files.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limslam_agent.policies.learned.polar_view import ViewConfig
from limslam_agent.safe_files import load_arrays
from limslam_env.messages import LONGEST_VALUE, one_line

Weights = NDArray[np.float32]

LAYERS = ("first", "state", "second", "third", "score")
"""Layers of the network. Each has a ``weight`` and a ``bias``."""

COMPASS = 2

SPREAD = {"second": 2, "third": 3}
"""Directions between two taps of a convolution, where it is not one. So a score knows what lies 105
degrees to both sides, where the beams at the sides look.
"""


@dataclass(frozen=True, eq=False)
class DirectionNetwork:
    """Scores directions with circular convolutions, so that each score depends on a direction and
    its neighbours.

    Attributes
    ----------
    weights
        Arrays by ``LAYER.weight`` and ``LAYER.bias``. Weights of circular convolutions have the
        shape (out, in, width), and the weight of ``state`` has the shape (out, in). The last layer,
        ``score``, gets the result of the third layer and the input.
    view
        The polar view that the network was trained with.
    """

    weights: dict[str, Weights]
    view: ViewConfig

    @property
    def readings(self) -> int:
        """Number of beams of the robot that the network was trained with."""
        return int(self.weights["state.weight"].shape[1]) - 2

    def scores(self, observation: NDArray[np.float32]) -> Weights:
        """Logits (directions,) of an observation (size,) that ``polar_view.observe`` has made."""
        directions = self.view.directions
        size = self.view.rows * self.view.directions
        angles = 2.0 * np.pi * np.arange(directions) / directions
        # The heading relative to the robot. Without it the scores would not change when the robot
        # turns.
        compass = np.stack((np.cos(angles), np.sin(angles)))
        told = np.concatenate((observation[:size].reshape(-1, directions), compass)).astype(
            np.float32
        )
        state = self.weights["state.weight"] @ observation[size:] + self.weights["state.bias"]
        values = np.maximum(self._around("first", told) + state[:, None], 0.0)
        values = np.maximum(self._around("second", values), 0.0)
        values = np.maximum(self._around("third", values), 0.0)
        return np.asarray(self._around("score", np.concatenate((values, told)))[0])

    def _around(self, layer: str, values: Weights) -> Weights:
        weight = self.weights[f"{layer}.weight"]
        bias = self.weights[f"{layer}.bias"]
        half = weight.shape[2] // 2
        spread = SPREAD.get(layer, 1)
        shifts = [spread * (half - tap) for tap in range(weight.shape[2])]
        total = sum(
            weight[:, :, tap] @ np.roll(values, shift, axis=1) for tap, shift in enumerate(shifts)
        )
        return np.asarray(total + bias[:, None])


def save_network(path: Path, network: DirectionNetwork) -> None:
    """Write the weights and the shape of the view to an ``.npz`` file that holds only numbers."""
    view = network.view
    shape = np.array([view.directions, view.rings, view.nearest, view.growth])
    with path.open("wb") as file:
        held: dict[str, Any] = {"view": shape, **network.weights}
        np.savez_compressed(file, **held)


def load_network(path: Path) -> DirectionNetwork:
    """Read a file of :func:`save_network`. Files with Python objects are refused, so reading cannot
    execute code.

    Raises
    ------
    ValueError
        If the file cannot be read, or holds another network.
    """
    try:
        held = load_arrays(path)
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: not the weights of a learned policy: {error}") from error
    wanted = {"view"} | {f"{layer}.{part}" for layer in LAYERS for part in ("weight", "bias")}
    if set(held) != wanted:
        names = one_line(", ".join(sorted(held)) or "nothing", LONGEST_VALUE)
        raise ValueError(f"{path}: not the weights of a learned policy: it holds {names}")
    if not all(values.dtype.kind == "f" and np.isfinite(values).all() for values in held.values()):
        raise ValueError(f"{path}: weights must be finite numbers")
    shape = held.pop("view")
    if shape.shape != (4,):
        raise ValueError(f"{path}: the shape of the view must be four numbers")
    view = ViewConfig(int(shape[0]), int(shape[1]), float(shape[2]), float(shape[3]))
    network = DirectionNetwork(
        {name: values.astype(np.float32) for name, values in held.items()}, view
    )
    try:
        network.scores(
            np.zeros(view.rows * view.directions + held["state.weight"].shape[1], np.float32)
        )
    except (ValueError, IndexError) as error:
        raise ValueError(f"{path}: the layers do not fit together: {error}") from error
    return network
