"""The worlds of a batch's environments, and the start poses in them."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np

from limslam_env.batch.worlds import Site, Sites, StartCells, prepare
from limslam_env.geometry import FloatArray, IntArray, no_rows
from limslam_env.interface import RobotSpec
from limslam_env.kernels.batch_state import Starts
from limslam_env.kernels.random_numbers import FreeCells, Words, draw_starts
from limslam_env.messages import announce
from limslam_env.simulation.starts import TRIES, known_poses, least_distance, no_room
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig, floor_plan
from limslam_env.worlds.world import World

_NO_STARTS = StartCells(no_rows(3), FreeCells(np.zeros((0, 2), dtype=np.int32), 0, np.zeros(4)))


def cores() -> int:
    """Number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Places:
    """Worlds for a batch of environments, and starts in them.

    Parameters
    ----------
    source
        One world, one world per environment, or the settings of random floor plans.
    robot, num_robots, num_envs
        The robots' specification, and their number in each of so many environments.
    plans
        Seeds of the floor plans that are made beforehand; an environment gets one of them at each
        reset. None draws every environment a plan of its own at each reset.
    num_threads
        How many threads prepare floor plans; None for one a core.

    Raises
    ------
    WorldError, ValueError
        If a world cannot be used, or floor plans for such a robot cannot be drawn.
    """

    def __init__(
        self,
        source: World | Sequence[World] | FloorPlanConfig,
        robot: RobotSpec,
        num_robots: int,
        num_envs: int,
        plans: Sequence[int] | None = None,
        num_threads: int | None = None,
    ) -> None:
        self.num_envs = num_envs
        self.num_robots = num_robots
        self.sites = Sites()
        self.world_of: IntArray = np.zeros(num_envs, dtype=np.int64)
        self._robot = robot
        self._threads = num_threads or cores()
        self._config: FloorPlanConfig | None = None
        self._seeds: Sequence[int] = ()
        self._worlds: list[World] = []
        self._starts: list[StartCells] = []
        self._variants: dict[tuple[int, bytes], int] = {}
        if isinstance(source, FloorPlanConfig):
            self._config = source
            source.check(robot.radius)
            if plans is not None:
                self._seeds = list(dict.fromkeys(plans))
                announce(
                    f"{len(self._seeds)} floor plans are drawn, some 10 ms of processor time each"
                )
                with ThreadPoolExecutor(self._threads) as pool:
                    self._keep(
                        pool.map(
                            lambda seed: prepare(self._plan(source, seed), robot, num_robots),
                            self._seeds,
                        )
                    )
        else:
            worlds = [source] if isinstance(source, World) else list(source)
            numbers = {world: number for number, world in enumerate(dict.fromkeys(worlds))}
            self._worlds = list(numbers)
            for world in self._worlds:
                world.check(robot.radius)
            self._keep(prepare(world, robot, num_robots) for world in self._worlds)
            if len(worlds) > 1:
                self.world_of[:] = [numbers[world] for world in worlds]
        self.home = self.world_of.copy()

    @property
    def num_plans(self) -> int | None:
        """How many floor plans there are to draw from at each reset; 0 without any, None if there
        is no end of them.
        """
        return 0 if self._config is None else len(self._seeds) or None

    def starts(self) -> Starts:
        """Where robots start in all worlds, as one set of arrays."""
        each = self._starts
        given = np.zeros((len(each), self.num_robots, 3))
        for slot, starts in enumerate(each):
            given[slot, : len(starts.given)] = starts.given
        return Starts(
            given,
            np.array([len(starts.given) for starts in each]),
            np.concatenate([starts.cells.runs for starts in each]),
            np.array([starts.cells.number for starts in each]),
            np.array([starts.cells.space for starts in each]),
            np.cumsum([0, *(len(starts.cells.runs) for starts in each)]),
            least_distance(self._robot),
        )

    def begin(self, envs: IntArray, keys: Words, start: FloatArray | None) -> FloatArray:
        """Give environments (k,) their worlds, and their robots poses (k, m, 3), m and rad, by
        random ``keys`` (k,).

        ``start`` (k, s, 3) are poses of the first robots.

        Raises
        ------
        WorldError
            If a start cannot be used, or there is no room. Then all is as it was.
        """
        if self._config is not None and not self._seeds:
            return self._begin_drawn(self._config, envs, keys, start)
        poses = np.zeros((len(envs), self.num_robots, 3))
        slots = self._slots(envs, keys)
        moves: list[tuple[IntArray, int, Site]] = []
        for slot, rows in _groups(slots):
            if start is None:
                poses[rows] = self._started(
                    self._starts[slot], keys[rows], None, partial(self._world, slot)
                )
            else:
                moves += self._start_at(rows, slot, start[rows], keys[rows], poses)
        # No error may be raised from here on, and nothing above changes this object.
        for rows, slot, site in moves:
            slots[rows] = self._slot_of(slot, site)
        self.world_of[envs] = slots
        return poses

    def world(self, env: int, key: Words) -> World:
        """The world that :meth:`begin` gave an environment by a key (1,). Floor plans are drawn
        again.
        """
        if self._config is not None and not self._seeds:
            return self._plan(self._config, int(key[0]))
        return self._world(int(self._slots(np.array([env]), key)[0]))

    def _slots(self, envs: IntArray, keys: Words) -> IntArray:
        """The slots (k,) of the worlds that environments (k,) get by keys (k,)."""
        if self._seeds:
            return ((keys >> np.uint64(11)) % np.uint64(len(self._seeds))).astype(np.int64)
        return self.home[envs]

    def _plan(self, config: FloorPlanConfig, seed: int) -> World:
        return floor_plan(config, np.random.default_rng(seed), self._robot.radius)

    def _keep(self, sites: Iterable[Site]) -> None:
        """Take the sites of the first slots."""
        for site in sites:
            self._starts.append(site.starts)
            self.sites.put(len(self.sites), site)

    def _world(self, slot: int) -> World:
        """The world of a slot. Floor plans are drawn again, because thousands of them would be much
        memory.
        """
        if self._config is None:
            return self._worlds[slot]
        return self._plan(self._config, self._seeds[slot])

    def _begin_drawn(
        self, config: FloorPlanConfig, envs: IntArray, keys: Words, start: FloatArray | None
    ) -> FloatArray:
        """Generate a separate floor plan for each environment."""

        def begun(row: int) -> tuple[Site, FloatArray]:
            world = self._plan(config, int(keys[row]))
            site = prepare(
                world, self._robot, self.num_robots, None if start is None else start[row]
            )
            poses = self._started(site.starts, keys[row : row + 1], None, lambda: world)
            # The places to start are most of a site, and not needed any more.
            return replace(site, starts=_NO_STARTS), poses

        with ThreadPoolExecutor(self._threads) as pool:
            made = list(pool.map(begun, range(len(envs))))
        for env, (site, _) in zip(envs.tolist(), made, strict=True):
            # Slots in the order of the environments.
            while len(self.sites) <= env:
                self.sites.put(len(self.sites), site)
            self.sites.put(env, site)
            self.world_of[env] = env
        return np.concatenate([poses for _, poses in made])

    def _started(
        self, starts: StartCells, keys: Words, known: FloatArray | None, world: Callable[[], World]
    ) -> FloatArray:
        """Poses (k, m, 3) for environments of these keys: ``known`` (k, g, 3) or the given ones,
        then drawn ones.
        """
        robot = self._robot
        poses = np.zeros((len(keys), self.num_robots, 3))
        given = starts.given if known is None else known
        count = given.shape[-2]
        poses[:, :count] = given
        apart = least_distance(robot)
        if not draw_starts(keys, count, starts.cells, apart, poses, TRIES):
            raise no_room(world(), self.num_robots)
        return poses

    def _start_at(
        self, rows: IntArray, slot: int, start: FloatArray, keys: Words, poses: FloatArray
    ) -> list[tuple[IntArray, int, Site]]:
        """Start environments that share a world at poses of their own; what can be seen from there
        may differ.

        Returns rows of environments, the slot of their world, and the site that suits their poses.
        """
        world = self._world(slot)
        known, counts = known_poses(world, self._robot, self.num_robots, start)
        labels = (
            world.free_space(self._robot.radius)
            .labels_of(known[..., :2].reshape(-1, 2))
            .reshape(counts.size, -1)
        )
        is_known = np.arange(self.num_robots) < counts[:, None]
        labels = np.where(is_known, labels, -1)
        # A robot may stand where the grid of free space is too coarse to hold it. Then its place
        # counts, too.
        alone = np.where((labels == 0).any(axis=1), np.arange(1, len(start) + 1), 0)
        _, kind_of = np.unique(
            np.column_stack((alone, counts, labels)), axis=0, return_inverse=True
        )
        moves = []
        for _, mine in _groups(kind_of.ravel()):
            site = prepare(world, self._robot, self.num_robots, start[mine[0]])
            given = known[mine, : counts[mine[0]]]
            poses[rows[mine]] = self._started(site.starts, keys[mine], given, lambda: world)
            moves.append((rows[mine], slot, site))
        return moves

    def _slot_of(self, home: int, site: Site) -> int:
        """The slot with the coverage of a site: the world's own, or one that is added."""
        tiles = site.tiles.ravel()
        if np.array_equal(self.sites.tiles[home, : tiles.size], tiles):
            return home
        variant = home, tiles.tobytes()
        if variant not in self._variants:
            self._variants[variant] = len(self.sites)
            self.sites.put(len(self.sites), site)
        return self._variants[variant]


def _groups(values: IntArray) -> Iterator[tuple[int, IntArray]]:
    """The different values of an array (n,), and where each of them is."""
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    for part in np.split(order, np.flatnonzero(np.diff(ordered)) + 1):
        yield int(values[part[0]]), part
