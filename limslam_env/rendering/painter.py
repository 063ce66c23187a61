"""Rendering of a running simulation for the environments."""

from collections.abc import Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from limslam_env.geometry import FloatArray

if TYPE_CHECKING:
    from limslam_env.overlay import Overlay
    from limslam_env.rendering.window import Window
    from limslam_env.simulation.simulation import Readings, Simulation, Truth

RENDER_MODES = ("rgb_array", "human")


class Painter:
    """Pictures of a running simulation, in an array or in a window. Costs nothing while no mode is
    set.

    ``mode`` is ``"rgb_array"``, ``"human"`` or None; others are refused, and so is a window that
    needs what is not installed. A window shows ``fps`` pictures a second.

    Attributes
    ----------
    window
        The window of the human mode, once it is open.
    overlay
        The agents' estimates, drawn on top; agents set it.
    """

    def __init__(self, mode: str | None, fps: float) -> None:
        if mode == "human" and find_spec("pygame") is None:
            raise DependencyNotInstalled('a window needs pygame: pip install "limslam[play]"')
        if mode is not None and mode not in RENDER_MODES:
            raise ValueError(
                f"render_mode must be one of {', '.join(RENDER_MODES)} or None, not {mode!r}"
            )
        self.mode = mode
        self._fps = fps
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

            self.window = Window(f"LimSLAM: {simulation.world.name}", self._fps)
        self.window.show(picture)
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self.window is not None:
            self.window.close()
            self.window = None
