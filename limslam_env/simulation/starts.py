"""Start poses of robots: given ones, those of the world, or random free ones."""

from dataclasses import dataclass

import numpy as np

from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import RobotSpec
from limslam_env.worlds.world import World, WorldError

TRIES = 10_000
"""Number of random poses that are tried before the world counts as too small."""


@dataclass(frozen=True, eq=False)
class StartingPlaces:
    """The known start poses, and the cells in which the other robots may start."""

    given: FloatArray  # poses (g, 3) of the first robots, m and rad
    # cells, space: numbers (k,) of the free cells, row by row, for robots without a pose, none if
    # each robot has one; and their grid (4,): lower left corner x, y and side of the cells, m, and
    # columns
    cells: IntArray
    space: FloatArray
    # (k,), which of the cells lie in a pocket
    # (:meth:`limslam_env.worlds.free_space.FreeSpace.pockets`). No robot is put there, since it
    # could hardly get out.
    is_pocket: BoolArray

    @property
    def known(self) -> FloatArray:
        """Poses (n, 3), one at least, m and rad: the regions that robots will start in are those of
        these.
        """
        if len(self.given):
            return self.given
        return np.array([[*self.centre(int(self.cells[0])), 0.0]])

    def centre(self, cell: int) -> FloatArray:
        """Centre (2,) of a cell, m."""
        row, column = divmod(cell, int(self.space[3]))
        return np.asarray(self.space[:2] + (np.array([column, row]) + 0.5) * self.space[2])


def least_distance(robot: RobotSpec) -> float:
    """Least distance (m) between two robots at the start."""
    return 2.5 * robot.radius


def starting_places(
    world: World, robot: RobotSpec, num_robots: int, start: FloatArray | None
) -> StartingPlaces:
    """Find the places that robots may start at: ``start``, pose (3,) or poses (n, 3), then the
    world's, then free ones.

    A WorldError says that a given start cannot be used (:func:`known_poses`), or that there is no
    room at all.
    """
    given = np.zeros((0, 3)) if start is None else np.atleast_2d(np.asarray(start, dtype=float))
    known, counts = known_poses(world, robot, num_robots, given[None])
    poses = known[0, : counts[0]]
    cells = np.zeros(0, dtype=np.int64)
    space = np.array([0.0, 0.0, 1.0, 1.0])
    is_pocket = np.zeros(0, dtype=bool)
    if len(poses) < num_robots:
        grid = world.free_space(robot.radius)
        region = grid.region_of(poses[0, :2]) if len(poses) else grid.largest_closed_region()
        cells = np.flatnonzero(region)
        space = np.array([*grid.origin, grid.cell, region.shape[1]])
        is_pocket = grid.pockets(region)[region]
        if not len(cells):
            raise no_room(world, num_robots)
    return StartingPlaces(poses, cells, space, is_pocket)


def known_poses(
    world: World, robot: RobotSpec, num_robots: int, given: FloatArray
) -> tuple[FloatArray, IntArray]:
    """The given poses (k, s, 3) of the first robots in k environments, and after them those of the
    world that fit in.

    Returns poses (k, num_robots, 3), m and rad, 0 where a robot has none, and how many there are
    (k,). A WorldError says that a given start collides or lies outside, or that two start in one
    place.
    """
    count, number = given.shape[:2]
    if number > num_robots:
        raise WorldError(f"{number} starts for {num_robots} robots")
    if number:
        world.check_poses(given.reshape(count * number, given.shape[2]), robot.radius)
    poses = np.zeros((count, num_robots, 3))
    counts = np.full(count, number)
    poses[:, :number] = given
    for robot_number in range(1, number):
        if not are_apart(poses[:, robot_number], poses[:, :robot_number], robot).all():
            raise WorldError(f"world {world.name!r}: two robots are to start in one place")
    for start in world.starts:
        is_known = np.arange(num_robots) < counts[:, None]
        fits = are_apart(start[None], poses, robot, is_known) & (counts < num_robots)
        poses[fits, counts[fits]] = start
        counts += fits
    return poses, counts


def drawn_starts(
    places: StartingPlaces,
    world: World,
    robot: RobotSpec,
    num_robots: int,
    generator: np.random.Generator,
) -> FloatArray:
    """Poses (num_robots, 3) of all robots, m and rad, random free ones for some; a WorldError if
    there is no room.
    """
    poses = list(places.given)
    if len(poses) == num_robots:
        return places.given
    for number in generator.choice(len(places.cells), TRIES):
        pose = np.array(
            [*places.centre(int(places.cells[number])), generator.uniform(-np.pi, np.pi)]
        )
        others = np.array(poses).reshape(1, -1, 3)
        if not places.is_pocket[number] and are_apart(pose[None], others, robot)[0]:
            poses.append(pose)
        if len(poses) == num_robots:
            return np.array(poses)
    raise no_room(world, num_robots)


def no_room(world: World, num_robots: int) -> WorldError:
    """The error for a world without space for all robots."""
    return WorldError(f"world {world.name!r}: no room for {num_robots} robots")


def are_apart(
    poses: FloatArray, others: FloatArray, robot: RobotSpec, counted: BoolArray | None = None
) -> BoolArray:
    """Whether poses (k, 3) are far enough from others (k, n, 3) for robots to start at both.

    Only the ``counted`` (k, n) of the others matter, or all.
    """
    x, y = np.moveaxis(poses[:, None, :2] - others[..., :2], -1, 0)
    is_far = np.hypot(x, y) > least_distance(robot)
    return np.asarray((is_far if counted is None else is_far | ~counted).all(axis=1))
