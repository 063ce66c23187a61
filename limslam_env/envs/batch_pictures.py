"""Pictures of a batch of environments, for the adapters that draw."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from limslam_env.batch.batch import BatchSimulation, Results
from limslam_env.geometry import FloatArray
from limslam_env.worlds.world import World

if TYPE_CHECKING:
    from limslam_env.rendering.rendering import Background


class BatchPictures:
    """Pictures of all environments of a batch, as the single environment draws them, but square.

    Parameters
    ----------
    simulation
        The batch.
    """

    def __init__(self, simulation: BatchSimulation) -> None:
        self._simulation = simulation
        self._last: Results | None = None
        # Positions (n, m, 2) after each step, and for each environment the row in which its episode begins.
        self._trail: list[FloatArray] = []
        self._begins = np.zeros(simulation.num_envs, dtype=np.int64)
        # Where environments are, until their next episodes: to draw a world takes longer than a picture.
        self._places: dict[int, tuple[World, Background]] = {}

    def begin(self, results: Results) -> None:
        """Remember the state after a reset of some environments. The others are where they were."""
        if self._trail:
            self._trail.pop()
        self.follow(results)

    def follow(self, results: Results) -> None:
        """Remember the state after a step."""
        # The caller may change these arrays, and the pictures must not change with them.
        self._last = results._replace(
            ranges=results.ranges.copy(), poses=results.poses.copy(), time=results.time.copy(),
            coverage=results.coverage.copy(), wall_seen=results.wall_seen.copy(),
        )  # fmt: skip
        self._trail.append(self._last.poses[:, :, :2])
        has_begun = results.time == 0.0
        if has_begun.any():
            for env in np.flatnonzero(has_begun):
                self._places.pop(int(env), None)
            self._begins[has_begun] = len(self._trail) - 1
            first = int(self._begins.min())
            del self._trail[:first]
            self._begins -= first

    def paint(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A picture (height, width, 3) of each environment; None before the first reset."""
        last = self._last
        if last is None:
            return None
        from limslam_env.rendering.rendering import RenderState, render, square_background

        trail, simulation = np.stack(self._trail), self._simulation
        pictures = []
        for env in range(simulation.num_envs):
            if env not in self._places:
                world = simulation.world(env)
                self._places[env] = world, square_background(world)
            (world, background), grid = self._places[env], simulation.coverage_grid(env)
            paths = trail[self._begins[env] :, env].swapaxes(0, 1)
            state = RenderState(
                world, simulation.robot, last.poses[env], last.wall_seen[env], last.ranges[env], list(paths),
                float(last.time[env]), float(last.coverage[env]), simulation.seen(env) & grid.coverable, grid.low,
            )  # fmt: skip
            pictures.append(render(state, background=background))
        return tuple(pictures)
