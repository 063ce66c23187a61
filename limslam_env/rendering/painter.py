"""Rendering of a running simulation for the environments, and what agents may draw over it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from limslam_env.geometry import FloatArray, no_rows

if TYPE_CHECKING:
    from limslam_env.rendering.window import Window
    from limslam_env.simulation.simulation import Readings, Simulation, Truth

RENDER_MODES = ("rgb_array", "human")
RENDER_FPS = 10


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


class Painter:
    """Pictures of a running simulation, in an array or in a window. Costs nothing while no mode is
    set.

    ``mode`` is ``"rgb_array"``, ``"human"`` or None; others are refused, and so is a window that
    needs what is not installed.

    Attributes
    ----------
    window
        The window of the human mode, once it is open.
    overlay
        The agents' estimates, drawn on top; agents set it.
    """

    def __init__(self, mode: str | None) -> None:
        if mode == "human" and find_spec("pygame") is None:
            raise DependencyNotInstalled("a window needs pygame: pip install 'limslam[play]'")
        if mode is not None and mode not in RENDER_MODES:
            raise ValueError(
                f"render_mode must be one of {', '.join(RENDER_MODES)} or None, not {mode!r}"
            )
        self.mode = mode
        self.window: Window | None = None
        self._last: tuple[Readings, Truth] | None = None
        self._paths: list[list[FloatArray]] = []
        self.overlay: Sequence[Overlay] = ()

    def follow(self, simulation: "Simulation", readings: "Readings", truth: "Truth") -> None:
        """Remember the state for a later picture; with a window, show it now."""
        if self.mode is None:
            return
        if truth.time == 0.0:
            self._paths = [[] for _ in truth.poses]
        # The caller may change these arrays, and the picture must not change with them.
        self._last = (
            readings._replace(ranges=readings.ranges.copy()),
            truth._replace(poses=truth.poses.copy(), wall_seen=truth.wall_seen.copy()),
        )
        for path, pose in zip(self._paths, self._last[1].poses, strict=True):
            path.append(pose[:2])
        if self.mode == "human":
            self.paint(simulation)

    def paint(self, simulation: "Simulation") -> NDArray[np.uint8] | None:
        """The picture (height, width, 3); None before a reset, and when it is shown in the
        window.
        """
        if self._last is None:
            return None
        from limslam_env.rendering.rendering import RenderState, render

        readings, truth = self._last
        grid = simulation.coverage_grid
        picture = render(
            RenderState(
                simulation.world,
                simulation.robot,
                truth.poses,
                truth.wall_seen,
                readings.ranges,
                [np.array(path) for path in self._paths],
                truth.time,
                truth.coverage,
                simulation.seen & grid.coverable,
                grid.low,
                overlay=self.overlay,
            )
        )
        if self.mode == "rgb_array":
            return picture
        if self.window is None:
            from limslam_env.rendering.window import Window

            self.window = Window(f"LimSLAM: {simulation.world.name}", RENDER_FPS)
        self.window.show(picture)
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self.window is not None:
            self.window.close()
            self.window = None
