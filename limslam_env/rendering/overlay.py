"""An agent's estimate as plain arrays, to be drawn over a picture."""

from dataclasses import dataclass, field

import numpy as np

from limslam_env.geometry import FloatArray, no_rows


@dataclass(frozen=True, eq=False)
class Overlay:
    """One agent's estimate in the world frame, drawn over the true world. The arrays are read-only copies.

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
    """

    pose: FloatArray | None = None
    covariance: FloatArray | None = None
    segments: FloatArray = field(default_factory=lambda: no_rows(4))
    frontier: FloatArray = field(default_factory=lambda: no_rows(2))
    plan: FloatArray = field(default_factory=lambda: no_rows(2))

    def __post_init__(self) -> None:
        for name, shape in (("pose", (3,)), ("covariance", (3, 3))):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _frozen(getattr(self, name), name, shape))
        for name, width in (("segments", 4), ("frontier", 2), ("plan", 2)):
            object.__setattr__(self, name, _frozen(getattr(self, name), name, (None, width)))
        if self.covariance is not None and self.pose is None:
            raise ValueError("an overlay's covariance needs a pose to lie around")


def _frozen(value: FloatArray, name: str, shape: tuple[int | None, ...]) -> FloatArray:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"an overlay's {name} must be an array of numbers") from None
    if array.shape == (0,) and shape[0] is None:
        array = np.zeros((0, shape[-1] or 0))
    fits = array.ndim == len(shape) and all(want in {None, side} for want, side in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = ", ".join("n" if side is None else str(side) for side in shape)
        raise ValueError(f"an overlay's {name} must have shape ({wanted}), not {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"an overlay's {name} holds a number that is not finite")
    array.setflags(write=False)
    return array
