"""Planning with the true map: a roadmap of collision-free straight lines, short paths made of them,
and tours.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.geometry.segment import sample
from limslam_env.interface import RobotSpec
from limslam_env.worlds.free_space import cell_for, free_space
from limslam_env.worlds.world import World, WorldError

LEAST_GAP = 0.03
"""Least clearance between the robot's rim and a wall on any path, m."""

GAP = 0.08
"""Preferred clearance between the rim and a wall, m."""

SPACING = 0.35
"""Spacing of the places, m; larger in worlds that would have more than MOST_PLACES of them."""

MOST_PLACES = 1500

_TIGHT = 3.0  # what a metre with less than GAP costs
_FARTHEST = 4.0  # spacings; places farther apart are not joined by a straight line
_ESCAPE = 0.1  # m from a start to where there is room
_PAIRS_AT_ONCE = 1000
_NEAR = 16


class Roadmap:
    """The places that a robot can reach from its start, and paths between them.

    Places stand on a grid, and besides where the only ways to some of them turn. Two that see each
    other are joined: a probabilistic roadmap without chance (Kavraki, Svestka, Latombe and Overmars
    1996).

    The attribute ``places`` (n, 2), m, begins with the ``start`` (2,), m, of the robot, whose body
    has a ``radius``, m.

    Raises
    ------
    WorldError
        If there is no room to drive there.
    """

    def __init__(self, world: World, radius: float, start: FloatArray) -> None:
        self._cell = cell_for(world.edges, radius)
        space = free_space(world.edges, radius + LEAST_GAP, self._cell, world.obstacles)
        self._origin = space.origin
        start = np.asarray(start, dtype=float)
        room = space.centres(space.free)
        offsets = np.hypot(*(room - start).T)
        if not len(room) or offsets.min() > _ESCAPE:
            raise WorldError(
                f"world {world.name!r}: there is no room to drive at ({start[0]:g}, {start[1]:g})"
            )
        nearest = room[np.argmin(offsets)]
        # Cells that only touch at a corner are not joined, so a straight way leads from each cell
        # to the next.
        parts, _ = ndimage.label(space.free)
        self._drivable = np.asarray(parts == parts[tuple(self._cells(nearest))])
        # Robots may start nearer to a wall than they later drive.
        self._drivable[tuple(self._cells(np.linspace(start, nearest, 200)).T)] = True
        self._tight = ndimage.distance_transform_edt(self._drivable) * self._cell < GAP - LEAST_GAP
        self._known: dict[int, tuple[FloatArray, IntArray]] = {}
        self._join(np.vstack((start[None], self._grid_places())))

    def is_free(self, first: FloatArray, second: FloatArray) -> BoolArray:
        """Whether the robot can drive straight from points (n, 2) to others (n, 2), m."""
        return np.asarray(self._costs(np.atleast_2d(first), np.atleast_2d(second)) < np.inf)

    def way(self, first: FloatArray, second: FloatArray) -> FloatArray | None:
        """The turning points and the end (k, 2) of a path between two points (2,), m; None if there
        is no path.
        """
        if self.is_free(first, second)[0]:
            return np.array([second])
        begins = self._seen_from(first)
        ends = self._seen_from(second)
        if not len(begins) or not len(ends):
            return None
        lengths, before = self._tree(int(begins[0]))
        totals = lengths[ends] + np.hypot(*(self.places[ends] - second).T)
        place = int(ends[np.argmin(totals)])
        turns = [np.asarray(second)]
        while place >= 0:
            turns.append(self.places[place])
            place = int(before[place])
        return self.pulled(np.array([first, *turns[::-1]]))[1:]

    def pulled(self, points: FloatArray) -> FloatArray:
        """A path (n, 2), m, without the points that a straight line can skip."""
        kept = [points[0]]
        at = 0
        while at < len(points) - 1:
            ahead = points[at + 1 :]
            free = np.flatnonzero(self.is_free(np.broadcast_to(points[at], ahead.shape), ahead))
            at += 1 + (int(free[-1]) if free.size else 0)
            kept.append(points[at])
        return np.array(kept)

    def _cells(self, points: FloatArray) -> IntArray:
        """Row and column (..., 2) of points (..., 2)."""
        return np.floor((points - self._origin) / self._cell).astype(np.intp)[..., ::-1]

    def _costs(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Costs (n,) of straight lines between points (n, 2), m: higher with little clearance, inf
        through walls.
        """
        spans = second - first
        lengths = np.hypot(*spans.T)
        # The number of samples follows from the line's own length, so that its cost does not depend
        # on the other lines.
        counts = np.ceil(2.0 * lengths / self._cell)[:, None] + 1.0
        steps = np.arange(counts.max(initial=0.0) + 1.0)
        shares = np.minimum(steps / counts, 1.0)
        cells = self._cells(first[:, None] + spans[:, None] * shares[..., None])
        inside = (cells >= 0) & (cells < self._drivable.shape)
        rows = np.where(inside, cells, 0)[..., 0]
        columns = np.where(inside, cells, 0)[..., 1]
        free = (inside.all(axis=-1) & self._drivable[rows, columns]).all(axis=1)
        tight = (self._tight[rows, columns] & (steps <= counts)).sum(axis=1) / (counts[:, 0] + 1.0)
        return np.where(free, lengths * (1.0 + (_TIGHT - 1.0) * tight), np.inf)

    def _grid_places(self) -> FloatArray:
        """The place with the most clearance in each block of the grid, near the block's centre."""
        rows, columns = np.nonzero(self._drivable)
        spacing = max(SPACING, math.sqrt(len(rows) * self._cell**2 / MOST_PLACES))
        self._spacing = spacing
        points = self._origin + (np.column_stack((columns, rows)) + 0.5) * self._cell
        blocks = np.floor((points - self._origin) / spacing).astype(np.int64)
        off_middle = np.hypot(*(points - self._origin - (blocks + 0.5) * spacing).T)
        order = np.lexsort((off_middle, self._tight[rows, columns], blocks[:, 0], blocks[:, 1]))
        _, first = np.unique(blocks[order], axis=0, return_index=True)
        return np.asarray(points[order[first]])

    def _join(self, places: FloatArray) -> None:
        """Join the places by straight lines, with additional places where some would be
        unreachable.
        """
        self.places, self._graph = places, self._straight_ways(places)
        fine: _FineWays | None = None
        # The straight pieces of a way can be a little too near to a wall. Then the ways from cell
        # to cell are taken.
        for thinned in (self._thinned, np.asarray):
            _, part = csgraph.connected_components(self._graph, directed=False)
            firsts = np.unique(part, return_index=True)[1]
            lost = firsts[part[firsts] != part[0]]
            if not len(lost):
                return
            fine = fine or _FineWays(self._drivable, self._tight, self._cells(places[0]))
            ways = [fine.way_to(self._cells(places[number])) for number in lost]
            more = [thinned(self._origin + (way[:, ::-1] + 0.5) * self._cell) for way in ways]
            self.places = np.vstack((self.places, *more))
            self._graph = self._straight_ways(self.places)

    def _thinned(self, way: FloatArray) -> FloatArray:
        """The turning points of a path (n, 2), m, and points between them so that each is joined to
        the next.
        """
        turns = self.pulled(way)
        return sample(np.hstack((turns[:-1], turns[1:])), 0.9 * _FARTHEST * self._spacing)[0]

    def _straight_ways(self, places: FloatArray) -> sparse.csr_array:
        pairs = cKDTree(places).query_pairs(_FARTHEST * self._spacing, output_type="ndarray")
        batches = np.array_split(pairs, len(pairs) // _PAIRS_AT_ONCE + 1)
        costs = np.concatenate(
            [self._costs(places[batch[:, 0]], places[batch[:, 1]]) for batch in batches]
        )
        pairs = pairs[costs < np.inf]
        costs = np.maximum(costs[costs < np.inf], 1e-9)
        return sparse.csr_array(
            (costs, (pairs[:, 0], pairs[:, 1])), shape=(len(places), len(places))
        )

    def _tree(self, place: int) -> tuple[FloatArray, IntArray]:
        if place not in self._known:
            self._known[place] = _lengths_and_predecessors(self._graph, place)
        return self._known[place]

    def _seen_from(self, point: FloatArray) -> IntArray:
        """Places that a straight line from a point (2,) can reach, the nearest first."""
        near = np.argsort(np.hypot(*(self.places - point).T))[:_NEAR]
        free = self.is_free(np.broadcast_to(point, (len(near), 2)), self.places[near])
        return np.asarray(near[free])


def _lengths_and_predecessors(graph: sparse.csr_array, node: int) -> tuple[FloatArray, IntArray]:
    """Shortest paths from a node of an undirected graph: lengths (n,), and the predecessors (n,),
    negative for none.
    """
    # scipy's own types ask for an array of nodes, and then give rows.
    lengths, before = csgraph.dijkstra(
        graph, directed=False, indices=np.array([node]), return_predecessors=True
    )
    return np.asarray(lengths[0]), np.asarray(before[0])


class _FineWays:
    """Shortest paths from cell to cell, for passages that straight lines between places do not
    cross.
    """

    def __init__(self, drivable: BoolArray, tight: BoolArray, start: IntArray) -> None:
        self._numbers = np.cumsum(drivable).reshape(drivable.shape) - 1
        self._cells = np.argwhere(drivable)
        cost = np.where(tight, _TIGHT, 1.0)
        rows = []
        columns = []
        costs = []
        for step in ((0, 1), (1, 0)):
            beyond = self._cells + step
            inside = ((beyond >= 0) & (beyond < drivable.shape)).all(axis=1)
            here = self._cells[inside]
            there = beyond[inside]
            joined = drivable[tuple(there.T)]
            (row, column), (other_row, other_column) = here[joined].T, there[joined].T
            rows.append(self._numbers[row, column])
            columns.append(self._numbers[other_row, other_column])
            costs.append(0.5 * (cost[row, column] + cost[other_row, other_column]))
        shape = (len(self._cells), len(self._cells))
        graph = sparse.csr_array(
            (np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns))), shape=shape
        )
        first = int(self._numbers[tuple(start)])
        _, self._before = _lengths_and_predecessors(graph, first)

    def way_to(self, cell: IntArray) -> IntArray:
        """Cells (k, 2), row and column, from the start to a cell."""
        at = int(self._numbers[tuple(cell)])
        way = []
        while at >= 0:
            way.append(self._cells[at])
            at = int(self._before[at])
        return np.array(way[::-1])


class Speeds(NamedTuple):
    """Speeds of a tour: m/s on straight lines, and rad/s of turns on the spot."""

    drive: float
    turn: float


def poses_along(start: FloatArray, way: FloatArray, robot: RobotSpec, speeds: Speeds) -> FloatArray:
    """Poses (n, 3) at each control step from ``start`` (3,) on along waypoints (k, 2), m.

    The robot turns on the spot towards each waypoint, drives there on a straight line, and
    continues in the next step.
    """
    points = np.vstack((start[None, :2], way))
    spans = np.diff(points, axis=0)
    lengths = np.hypot(*spans.T)
    moves = lengths > 1e-9
    points = points[np.append(True, moves)]
    spans = spans[moves]
    lengths = lengths[moves]
    turns = wrap_angle(np.diff(np.append(start[2], np.arctan2(spans[:, 1], spans[:, 0]))))
    headings = start[2] + np.append(0.0, np.cumsum(turns))
    # Numbers of control steps: of the turn, of the drive, and of the rest of the step in which the
    # drive ends.
    turning = np.abs(turns) / (speeds.turn * robot.control_period)
    driving = lengths / (speeds.drive * robot.control_period)
    waiting = np.ceil(turning + driving - 1e-6) - turning - driving
    times = np.append(0.0, np.cumsum(np.column_stack((turning, driving, waiting))))
    steps = np.arange(round(times[-1]) + 1)
    x, y = (np.interp(steps, times, np.repeat(points[:, axis], 3)[1:-1]) for axis in (0, 1))
    return np.column_stack((x, y, np.interp(steps, times, np.repeat(headings, 3)[2:])))


def loop_tour(world: World, robot: RobotSpec, start: FloatArray, laps: int = 1) -> FloatArray:
    """Waypoints (k, 2), m, of ``laps`` rounds of the world's loop from a pose (3,).

    Raises
    ------
    WorldError
        If there is no room to drive at the start or along the loop.
    """
    place = np.asarray(start, dtype=float)[:2]
    first = (int(np.argmin(np.hypot(*(world.loop - place).T))) + 1) % len(world.loop)
    corners = np.tile(np.roll(world.loop, -first, axis=0), (laps, 1))
    roads = Roadmap(world, robot.radius, place)
    ways = [
        roads.way(here, there) for here, there in zip((place, *corners[:-1]), corners, strict=True)
    ]
    if any(way is None for way in ways):
        raise WorldError(
            f"world {world.name!r}: a robot of {robot.radius:g} m radius cannot drive along its "
            "loop"
        )
    return np.vstack([way for way in ways if way is not None])
