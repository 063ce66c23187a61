"""Exploration tours that are planned with the true map: a bound for the exploration time.

The shortest path from which everything is visible is the watchman route problem, which is NP-hard with obstacles (Chin
and Ntafos, 1988). Therefore a greedy tour, which prefers near places that show many cells, is built and then improved
by simulated annealing (Kirkpatrick, Gelatt and Vecchi, 1983).
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from limslam_env.bounds.roadmap import Roadmap
from limslam_env.geometry import BoolArray, FloatArray, IntArray, no_rows
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec
from limslam_env.simulation.coverage import BeamSweep, coverage_grid
from limslam_env.worlds.world import World, WorldError

GOAL = 0.99
"""Fraction of the coverable cells that a tour has to see, as in the environments."""

EVALUATIONS = 2000
"""Number of changes that are tried to improve a tour."""

MOST_CELLS = 300_000
"""Coverable cells (3000 m^2) of the largest buildings that tours are planned for: planning takes minutes there."""

# Exponents of the number of new cells, which is weighed against the travel time.
_POWERS = (0.5, 0.75, 1.0, 1.5)
_CANDIDATES, _NEIGHBOURHOOD, _MOST_VISITS = 12, 400, 2
_PRICE = 0.25  # s for a cell that a tour leaves out: more than seeing one cell takes
_VIEW = 0.05  # rad between the headings of a robot that turns around
_MOST_POSES = 5_000_000  # that all evaluations may drive through together
_WARMTH = 0.3  # s that a change may cost at first
_OFFSETS = (0.05, 0.15, 0.4)  # m
_LONGEST_CUT, _LONGEST_MOVE, _LONGEST_TURN = 4, 6, 12  # waypoints


class Worth(NamedTuple):
    """The value of a tour: its cost (s), the number of required cells that it misses, and the cells it misses (k,)."""

    cost: float
    missing: int
    left: IntArray


class Speeds(NamedTuple):
    """Speeds of a tour: m/s on straight lines, and rad/s of turns on the spot."""

    drive: float
    turn: float


def top_speeds(robot: RobotSpec) -> Speeds:
    """The largest speeds that the wheels allow. Straight lines and turns on the spot are then time-optimal.

    Balkcom and Mason, "Time optimal trajectories for bounded velocity differential drive vehicles" (2002).
    """
    return Speeds(robot.max_wheel_speed, 2.0 * robot.max_wheel_speed / robot.axle)


def poses_along(start: FloatArray, way: FloatArray, robot: RobotSpec, speeds: Speeds) -> FloatArray:
    """Poses (n, 3) at each control step from ``start`` (3,) on along waypoints (k, 2), m.

    The robot turns on the spot towards each waypoint, drives there on a straight line, and continues in the next step.
    """
    points = np.vstack((start[None, :2], way))
    spans = np.diff(points, axis=0)
    lengths = np.hypot(*spans.T)
    moves = lengths > 1e-9
    points, spans, lengths = points[np.append(True, moves)], spans[moves], lengths[moves]
    turns = wrap_angle(np.diff(np.append(start[2], np.arctan2(spans[:, 1], spans[:, 0]))))
    headings = start[2] + np.append(0.0, np.cumsum(turns))
    # Numbers of control steps: of the turn, of the drive, and of the rest of the step in which the drive ends.
    turning = np.abs(turns) / (speeds.turn * robot.control_period)
    driving = lengths / (speeds.drive * robot.control_period)
    waiting = np.ceil(turning + driving - 1e-6) - turning - driving
    times = np.append(0.0, np.cumsum(np.column_stack((turning, driving, waiting))))
    steps = np.arange(round(times[-1]) + 1)
    x, y = (np.interp(steps, times, np.repeat(points[:, axis], 3)[1:-1]) for axis in (0, 1))
    return np.column_stack((x, y, np.interp(steps, times, np.repeat(headings, 3)[2:])))


def coverage_tour(
    world: World,
    robot: RobotSpec,
    start: FloatArray,
    *,
    seen: BoolArray | None = None,
    evaluations: int = EVALUATIONS,
) -> FloatArray:
    """A short tour at top speed from which the beams see ``GOAL``: a bound for the exploration time.

    Parameters
    ----------
    world
        The map.
    robot
        Body and beams.
    start
        Pose that the tour begins at (3,), m and rad.
    seen
        Cells that have been covered already (rows, columns); none if left out.
    evaluations
        Changes that are tried to improve it.

    Returns
    -------
    waypoints
        (k, 2), m: the robot turns on the spot towards each and drives there straight, at least
        ``roadmap.LEAST_GAP`` off every wall. Empty where nothing is left to see. Where beams can see
        what this robot cannot drive to safely, the tour may end before the goal. The same for the same arguments.

    Raises
    ------
    WorldError
        If there is no room to drive at the start, or the building is too large.
    """
    if seen is None:
        return _tour(world, robot, _tuple(start), evaluations)
    return Tours(world, robot, start, seen).best(evaluations)


def closed_tour(
    world: World, robot: RobotSpec, start: FloatArray, laps: int = 1, *, evaluations: int = EVALUATIONS
) -> FloatArray:
    """Waypoints (k, 2), m, of ``laps`` rounds: of the world's loop, or of a coverage tour that leads back to its start.

    Raises
    ------
    WorldError
        If there is no room to drive at the start or along the loop, or the building is too large.
    """
    if not len(world.loop):
        return np.tile(_tour(world, robot, _tuple(start), evaluations, is_closed=True), (laps, 1))
    place = np.asarray(start, dtype=float)[:2]
    first = (int(np.argmin(np.hypot(*(world.loop - place).T))) + 1) % len(world.loop)
    corners = np.tile(np.roll(world.loop, -first, axis=0), (laps, 1))
    roads = Roadmap(world, robot.radius, place)
    ways = [roads.way(here, there) for here, there in zip((place, *corners[:-1]), corners, strict=True)]
    if any(way is None for way in ways):
        raise WorldError(f"world {world.name!r}: a robot of {robot.radius:g} m radius cannot drive along its loop")
    return np.vstack([way for way in ways if way is not None])


@functools.lru_cache(maxsize=64)
def _tour(
    world: World, robot: RobotSpec, start: tuple[float, ...], evaluations: int, *, is_closed: bool = False
) -> FloatArray:
    way = Tours(world, robot, np.array(start), is_closed=is_closed).best(evaluations)
    way.setflags(write=False)
    return way


def _tuple(start: FloatArray) -> tuple[float, ...]:
    return tuple(np.asarray(start, dtype=float).tolist())


class Tours:
    """The tours of one robot from one start, and what they are worth.

    Parameters
    ----------
    world, robot, start, seen
        As :func:`coverage_tour` takes them.
    is_closed
        Whether tours lead back to the start.
    """

    def __init__(
        self,
        world: World,
        robot: RobotSpec,
        start: FloatArray,
        seen: BoolArray | None = None,
        *,
        is_closed: bool = False,
    ) -> None:
        self._robot, self._speeds, self._is_closed = robot, top_speeds(robot), is_closed
        self.start = np.asarray(start, dtype=float)
        self._grid = coverage_grid(world, robot, self.start[None])
        if self._grid.total > MOST_CELLS:
            raise WorldError(f"world {world.name!r}: {self._grid.total} cells are too many for a tour ({MOST_CELLS})")
        self.roads = Roadmap(world, robot.radius, self.start[:2])
        self._sweep = BeamSweep(world, robot, self._grid)
        self._seen = np.zeros_like(self._grid.coverable) if seen is None else seen
        wanted = math.ceil(GOAL * self._grid.total - 1e-9)
        self._needed = max(wanted - int(np.count_nonzero(self._seen & self._grid.coverable)), 0)
        self._views = np.array([self._view(place) for place in self.roads.places])

    def best(self, evaluations: int) -> FloatArray:
        """The best tour (k, 2) that is found, m."""
        ways = [self._greedy(power) for power in _POWERS]
        way = min(ways, key=lambda tour: self.worth(tour).cost)
        if not len(way):
            return way
        # Large buildings have long tours, and fewer changes are tried.
        length = len(poses_along(self.start, way, self._robot, self._speeds))
        return self.whole(_improved(self, way, min(evaluations, _MOST_POSES // length), np.random.default_rng(0)))

    def worth(self, way: FloatArray) -> Worth:
        """What a tour (k, 2), m, costs, s, and what it misses."""
        seen = self._seen.copy()
        way = self.whole(way)
        covered = np.cumsum(self._sweep.mark(poses_along(self.start, way, self._robot, self._speeds), seen))
        missing = max(self._needed - int(covered[-1]), 0)
        # An open tour is over as soon as enough has been seen.
        last = len(covered) - 1 if missing or self._is_closed else int(np.searchsorted(covered, self._needed))
        left = np.flatnonzero((self._grid.coverable & ~seen).ravel())
        return Worth(last * self._robot.control_period + _PRICE * missing, missing, left)

    def whole(self, way: FloatArray) -> FloatArray:
        """A tour (k, 2), m, with the way back to the start if it is to be closed."""
        if not self._is_closed or not len(way):
            return way
        back = self.roads.way(way[-1], self.start[:2])
        return way if back is None else np.vstack((way, back))

    def places_that_see(self, cell: int) -> IntArray:
        """Numbers of the places from which a cell, by its number in the coverage grid, can be seen."""
        return np.flatnonzero(self._views[:, cell >> 3] >> (7 - (cell & 7)) & 1)

    def _view(self, place: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
        """The coverable cells that a robot sees when it turns around, one bit each."""
        headings = np.arange(0.0, 2.0 * math.pi, _VIEW)
        seen = np.zeros_like(self._grid.coverable)
        self._sweep.mark(np.column_stack((np.broadcast_to(place, (len(headings), 2)), headings)), seen)
        return np.packbits(seen & self._grid.coverable)

    def _greedy(self, power: float) -> FloatArray:
        """Go again and again to where the most new cells are seen in the least time: nearest neighbours first."""
        at, pose, seen, way = 0, self.start, self._seen.copy(), [no_rows(2)]
        covered = int(self._sweep.mark(pose[None], seen).sum())
        visits = np.zeros(len(self.roads.places), dtype=np.intp)
        while covered < self._needed:
            best, best_score = None, -1.0
            for place in self._worth_a_visit(at, seen, visits, power):
                leg = self.roads.way(self.roads.places[at], self.roads.places[place])
                if leg is None:
                    continue
                poses, then = poses_along(pose, leg, self._robot, self._speeds), seen.copy()
                new = int(self._sweep.mark(poses, then).sum())
                # If no path shows a new cell, go to the nearest place.
                score = (new**power + 1e-9) / len(poses)
                if score > best_score:
                    best, best_score = (int(place), leg, poses[-1], then, new), score
            if best is None:
                break
            at, leg, pose, seen, new = best
            covered += new
            visits[at] += 1
            way.append(leg)
        return np.vstack(way)

    def _worth_a_visit(self, at: int, seen: BoolArray, visits: IntArray, power: float) -> IntArray:
        """Places with something new to see: the nearest, and those with the most of it for their distance."""
        lengths = np.where(visits < _MOST_VISITS, self.roads.lengths_from(at), np.inf)
        lengths[at] = np.inf
        near, unseen = np.argsort(lengths, kind="stable"), np.packbits(~seen)
        for some in (near[:_NEIGHBOURHOOD], near):
            places = some[lengths[some] < np.inf]
            new = np.bitwise_count(self._views[places] & unseen).sum(axis=1)
            places, new = places[new > 0], new[new > 0]
            if len(places):
                rich = np.argsort(-(new**power) / (lengths[places] + 0.3), kind="stable")
                return np.union1d(places[:_CANDIDATES], places[rich[:_CANDIDATES]])
        return np.zeros(0, dtype=np.intp)


def _improved(problem: "Tours", way: FloatArray, evaluations: int, generator: np.random.Generator) -> FloatArray:
    """The best tour (k, 2), m, that so many changes to one lead to."""
    search = _Search(problem, generator)
    worth = problem.worth(way)
    best, best_worth = way, worth
    for number in range(evaluations):
        changed = search.changed(way, worth)
        if changed is None:
            continue
        other = problem.worth(changed)
        warmth = _WARMTH * (1.0 - number / evaluations)
        if other.cost > worth.cost and generator.random() >= math.exp((worth.cost - other.cost) / warmth):
            continue
        way, worth = _trimmed(problem, changed, other), other
        if (worth.missing, worth.cost) < (best_worth.missing, best_worth.cost):
            best, best_worth = way, worth
    return best


def _trimmed(problem: "Tours", way: FloatArray, worth: Worth) -> FloatArray:
    """Without the waypoints after which nothing is needed any more."""
    while len(way) > 1 and problem.worth(way[:-1]).cost <= worth.cost:
        way = way[:-1]
    return way


class _Search:
    """Ways to change a tour."""

    def __init__(self, problem: "Tours", generator: np.random.Generator) -> None:
        self._problem, self._generator = problem, generator
        self._changes: Sequence[Callable[[FloatArray, Worth], FloatArray | None]] = (
            self._without, self._shifted, self._reversed, self._reordered, self._seeing, self._refined,
        )  # fmt: skip

    def changed(self, way: FloatArray, worth: Worth) -> FloatArray | None:
        """Another tour, at random; None if that cannot be driven."""
        return self._changes[int(self._generator.integers(len(self._changes)))](way, worth)

    def _cut(self, way: FloatArray, longest: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        first = int(self._generator.integers(len(way)))
        last = first + int(self._generator.integers(1, longest + 1))
        return way[:first], way[first:last], way[last:]

    def _without(self, way: FloatArray, _worth: Worth) -> FloatArray | None:
        before, _, after = self._cut(way, _LONGEST_CUT)
        return self._joined(before, after)

    def _shifted(self, way: FloatArray, _worth: Worth) -> FloatArray | None:
        before, point, after = self._cut(way, 1)
        return self._joined(before, point + self._offset(), after)

    def _reversed(self, way: FloatArray, _worth: Worth) -> FloatArray | None:
        before, part, after = self._cut(way, _LONGEST_TURN)
        return self._joined(before, part[::-1], after)

    def _reordered(self, way: FloatArray, _worth: Worth) -> FloatArray | None:
        before, part, after = self._cut(way, _LONGEST_MOVE)
        part = part if self._generator.random() < 0.5 else part[::-1]
        at = int(self._generator.integers(len(before) + len(after) + 1))
        beyond = max(at - len(before), 0)
        if beyond:
            return self._joined(before, after[:beyond], part, after[beyond:])
        return self._joined(before[:at], part, before[at:], after)

    def _seeing(self, way: FloatArray, worth: Worth) -> FloatArray | None:
        """Past a place from which something is seen that was not."""
        if not len(worth.left):
            return None
        places = self._problem.places_that_see(int(self._generator.choice(worth.left)))
        if not len(places):
            return None
        place = self._problem.roads.places[self._generator.choice(places)]
        points = np.vstack((self._problem.start[None, :2], way))
        away = np.hypot(*(points - place).T)
        detours = np.append(away[:-1] + away[1:] - np.hypot(*np.diff(points, axis=0).T), away[-1])
        at = int(np.argsort(detours, kind="stable")[min(int(self._generator.geometric(0.5)), len(detours)) - 1])
        return self._joined(way[:at], place[None], way[at:])

    def _refined(self, way: FloatArray, _worth: Worth) -> FloatArray | None:
        at = int(self._generator.integers(len(way)))
        before = way[at - 1] if at else self._problem.start[:2]
        return self._joined(way[:at], 0.5 * (before + way[at])[None] + self._offset(), way[at:])

    def _offset(self) -> FloatArray:
        return np.asarray(self._generator.normal(0.0, self._generator.choice(_OFFSETS), 2))

    def _joined(self, *parts: FloatArray) -> FloatArray | None:
        """The parts of a tour one after the other, each of which can be driven, by ways between them."""
        at, tour = self._problem.start[:2], [no_rows(2)]
        for part in parts:
            if len(part):
                link = self._problem.roads.way(at, part[0])
                if link is None:
                    return None
                tour += [link, part[1:]]
                at = part[-1]
        joined = np.vstack(tour)
        return joined if len(joined) else None
