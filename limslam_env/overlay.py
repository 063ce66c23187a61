"""What agents may draw over a picture of the truth: their estimates."""

from dataclasses import dataclass, field

import numpy as np

from limslam_env.geometry import FloatArray, no_rows


@dataclass(frozen=True, eq=False)
class Overlay:
    """One agent's estimate in the world frame, drawn over the true world. The arrays are read-only
    copies.

    Attributes
    ----------
    pose
        Estimated pose (3,), m, m, rad; None draws no robot.
    covariance
        Of the pose (3, 3), m^2, m rad and rad^2; None draws no ellipse.
    segments
        Walls of its map (k, 4): x1, y1, x2, y2, m.
    frontier
        Frontier points between known and unknown space (m, 2), m.
    plan
        Planned path (p, 2), m. The last point is the goal.

    Raises
    ------
    ValueError
        If a shape is wrong, a number is not finite, or a covariance has no pose.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import numpy as np
    >>> import limslam_env
    >>> from limslam_env import Overlay
    >>> env = gym.make("LimSlam-Env1-v0", render_mode="rgb_array")
    >>> _, info = env.reset(seed=0)
    >>> walls = np.array([[0.0, 0.0, 7.0, 0.0]])
    >>> env.unwrapped.overlay = Overlay(pose=info["pose"], segments=walls)
    >>> env.render().shape
    (640, 640, 3)
    """

    pose: FloatArray | None = None
    covariance: FloatArray | None = None
    segments: FloatArray = field(default_factory=lambda: no_rows(4))
    frontier: FloatArray = field(default_factory=lambda: no_rows(2))
    plan: FloatArray = field(default_factory=lambda: no_rows(2))

    def __post_init__(self) -> None:
        for name, shape in _SHAPES.items():
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _frozen(getattr(self, name), name, shape))
        if self.covariance is not None and self.pose is None:
            raise ValueError("an overlay's covariance needs a pose to lie around")


_SHAPES = {
    "pose": (3,),
    "covariance": (3, 3),
    "segments": (0, 4),
    "frontier": (0, 2),
    "plan": (0, 2),
}
"""The shapes of the arrays; 0 stands for any number of rows."""


def _frozen(value: FloatArray, name: str, shape: tuple[int, ...]) -> FloatArray:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"an overlay's {name} must be an array of numbers") from None
    if not array.size and not shape[0]:
        array = np.zeros(shape)
    if array.ndim != len(shape) or array.shape[1:] != shape[1:] or shape[0] not in {0, len(array)}:
        wanted = ", ".join(str(side or "n") for side in shape)
        raise ValueError(f"an overlay's {name} must have shape ({wanted}), not {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"an overlay's {name} holds a number that is not finite")
    array.setflags(write=False)
    return array
