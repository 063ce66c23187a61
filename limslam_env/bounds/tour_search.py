"""Better tours out of good ones, by simulated annealing (Kirkpatrick, Gelatt and Vecchi 1983)."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from limslam_env.bounds.roadmap import Roadmap
from limslam_env.geometry import FloatArray, IntArray, no_rows

_WARMTH = 0.3  # s that a change may cost at first
_OFFSETS = (0.05, 0.15, 0.4)  # m
_LONGEST_CUT, _LONGEST_MOVE, _LONGEST_TURN = 4, 6, 12  # waypoints


class Worth(NamedTuple):
    """The value of a tour: its cost (s), the number of required cells that it misses, and the cells it misses (k,)."""

    cost: float
    missing: int
    left: IntArray


class Problem(Protocol):
    """Tours that can be told from each other."""

    start: FloatArray
    roads: Roadmap

    def worth(self, way: FloatArray) -> Worth:
        """The value of a tour (k, 2), m."""
        ...

    def places_that_see(self, cell: int) -> IntArray:
        """Numbers of the places from which a cell can be seen."""
        ...


def improved(problem: Problem, way: FloatArray, evaluations: int, generator: np.random.Generator) -> FloatArray:
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


def _trimmed(problem: Problem, way: FloatArray, worth: Worth) -> FloatArray:
    """Without the waypoints after which nothing is needed any more."""
    while len(way) > 1 and problem.worth(way[:-1]).cost <= worth.cost:
        way = way[:-1]
    return way


class _Search:
    """Ways to change a tour."""

    def __init__(self, problem: Problem, generator: np.random.Generator) -> None:
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
