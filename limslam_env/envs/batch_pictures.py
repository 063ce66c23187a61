"""Pictures of a batch of environments, for the adapters that draw."""

from typing import TYPE_CHECKING, NamedTuple

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
        self._episodes = np.zeros(simulation.num_envs, dtype=np.int64)
        self._places: dict[int, _Place] = {}

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
            self._episodes += has_begun
            self._begins[has_begun] = len(self._trail) - 1
            first = int(self._begins.min())
            del self._trail[:first]
            self._begins -= first

    def paint(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A picture (height, width, 3) of each environment; None before the first reset."""
        last = self._last
        if last is None:
            return None
        from limslam_env.rendering.rendering import RenderState, render

        trail, simulation = np.stack(self._trail), self._simulation
        pictures = []
        for env in range(simulation.num_envs):
            place, grid = self._place(env), simulation.coverage_grid(env)
            paths = trail[self._begins[env] :, env].swapaxes(0, 1)
            state = RenderState(
                place.world, simulation.robot, last.poses[env], last.wall_seen[env], last.ranges[env], list(paths),
                float(last.time[env]), float(last.coverage[env]), simulation.seen(env) & grid.coverable, grid.low,
            )  # fmt: skip
            pictures.append(render(state, background=place.background))
        return tuple(pictures)

    def _place(self, env: int) -> "_Place":
        """Where an environment is: kept until its next episode, since drawing it takes longer than a picture."""
        from limslam_env.rendering.rendering import square_background

        place, episode = self._places.get(env), int(self._episodes[env])
        if place is None or place.episode != episode:
            world = self._simulation.world(env)
            place = self._places[env] = _Place(episode, world, square_background(world))
        return place


class _Place(NamedTuple):
    """The world of an environment in the episode with a number, and the background of its pictures."""

    episode: int
    world: World
    background: "Background"
