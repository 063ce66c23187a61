"""The worlds of a batch's environments, and the start poses in them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from limslam_env.batch.worlds import Site, Sites, prepare
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.interface import RobotSpec
from limslam_env.kernels.random_numbers import Words, draw_starts
from limslam_env.simulation.starts import TRIES, least_distance, no_room
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig, floor_plan
from limslam_env.worlds.world import World


class Places:
    """Worlds for a batch of environments, and starts in them.

    Parameters
    ----------
    source
        One world, one world per environment, or the settings of random floor plans.
    robot, num_robots
        The robots' specification, and their number in each environment.
    num_envs
        How many environments there are.
    plans
        Seeds of the floor plans that are made beforehand; an environment gets one of them at each reset. None draws
        every environment a plan of its own at each reset.

    Raises
    ------
    WorldError
        If a world cannot be used.
    ValueError
        If floor plans for such a robot cannot be drawn.
    """

    def __init__(
        self,
        source: World | Sequence[World] | FloorPlanConfig,
        robot: RobotSpec,
        num_robots: int,
        num_envs: int,
        plans: Sequence[int] | None = None,
    ) -> None:
        self.num_envs, self.num_robots, self.sites = num_envs, num_robots, Sites()
        self.world_of: IntArray = np.zeros(num_envs, dtype=np.int64)
        self._robot = robot
        self._config: FloorPlanConfig | None = None
        self._known: list[tuple[World, Site]] = []
        self._variants: dict[tuple[World, bytes], int] = {}
        self._is_drawn = False
        if isinstance(source, FloorPlanConfig):
            if plans is None:
                self._config = source
                # This plan is not used: it shows at once whether the settings can be used.
                floor_plan(source, np.random.default_rng(0), robot.radius)
                return
            self._is_drawn = True
            source = [floor_plan(source, np.random.default_rng(seed), robot.radius) for seed in plans]
        worlds = [source] if isinstance(source, World) else list(source)
        numbers = {world: number for number, world in enumerate(dict.fromkeys(worlds))}
        for number, world in enumerate(numbers):
            if not self._is_drawn:
                world.check(robot.radius)
            self._known.append((world, prepare(world, robot, num_robots)))
            self.sites.put(number, self._known[-1][1])
        if len(worlds) > 1 and not self._is_drawn:
            self.world_of[:] = [numbers[world] for world in worlds]
        self._home = self.world_of.copy()

    def begin(self, envs: IntArray, keys: Words, start: FloatArray | None) -> FloatArray:
        """Give environments (k,) their worlds, and their robots poses (k, m, 3), m and rad.

        Parameters
        ----------
        envs
            Their numbers.
        keys
            (k,), of the random numbers for it.
        start
            (k, s, 3), poses of the first robots.

        Raises
        ------
        WorldError
            If a start cannot be used, or there is no room. Then all is as it was.
        """
        if self._config is not None:
            return self._begin_drawn(self._config, envs, keys, start)
        poses = np.zeros((len(envs), self.num_robots, 3))
        slots = self._home[envs]
        if self._is_drawn:
            slots = ((keys >> np.uint64(11)) % np.uint64(len(self._known))).astype(np.int64)
        moves: list[tuple[IntArray, tuple[World, bytes], Site]] = []
        for slot in np.unique(slots):
            rows = np.flatnonzero(slots == slot)
            world, site = self._known[slot]
            if start is None:
                poses[rows] = self._started(world, site, keys[rows])
            else:
                moves += self._start_at(rows, world, start, keys, poses)
        # No error may be raised from here on, and nothing above changes this object.
        for rows, variant, site in moves:
            if variant not in self._variants:
                self._variants[variant] = len(self.sites)
                self.sites.put(len(self.sites), site)
            slots[rows] = self._variants[variant]
        self.world_of[envs] = slots
        return poses

    def _begin_drawn(
        self, config: FloorPlanConfig, envs: IntArray, keys: Words, start: FloatArray | None
    ) -> FloatArray:
        """Generate a separate floor plan for each environment."""
        poses = np.zeros((len(envs), self.num_robots, 3))
        sites: list[Site] = []
        for row, key in enumerate(keys):
            world = floor_plan(config, np.random.default_rng(int(key)), self._robot.radius)
            site = prepare(world, self._robot, self.num_robots, None if start is None else start[row])
            poses[row : row + 1] = self._started(world, site, keys[row : row + 1])
            # Starting places are most of a site, and not needed any more: only the first one's are kept.
            sites.append(replace(site, places=sites[0].places if sites else site.places))
        for env, site in zip(envs, sites, strict=True):
            self._settle(int(env), site)
        return poses

    def _started(self, world: World, site: Site, keys: Words) -> FloatArray:
        places, robot = site.places, self._robot
        poses = np.zeros((len(keys), self.num_robots, 3))
        given = places.given[: self.num_robots]
        poses[:, : len(given)] = given
        if not draw_starts(keys, len(given), places.cells, places.space, least_distance(robot), poses, TRIES):
            raise no_room(world, self.num_robots)
        return poses

    def _settle(self, env: int, site: Site) -> None:
        # Slots in the order of the environments.
        while len(self.sites) <= env:
            self.sites.put(len(self.sites), site)
        self.sites.put(env, site)
        self.world_of[env] = env

    def _start_at(
        self, rows: IntArray, world: World, start: FloatArray, keys: Words, poses: FloatArray
    ) -> list[tuple[IntArray, tuple[World, bytes], Site]]:
        """Start environments that share a world at poses of their own; what can be seen from there may differ.

        Which rows are to have which variant of the world, and what it is by, comes back.
        """
        kinds, kind_of = np.unique(start[rows], axis=0, return_inverse=True)
        moves = []
        for kind, wanted in enumerate(kinds):
            mine = rows[kind_of.ravel() == kind]
            site = prepare(world, self._robot, self.num_robots, wanted)
            poses[mine] = self._started(world, site, keys[mine])
            moves.append((mine, (world, site.grid.coverable.tobytes()), site))
        return moves
