"""Which clone is in which slot of the filter's state, and memory for the covariance of a state that changes its size.

In a large map, the slot of a clone that is gone means nothing until the next clone takes it. So clones come and go all
the time, while the covariance is hardly ever copied. In a small map, copies take less time than the work on free slots.
"""

import numpy as np

from limslam_env.geometry import FloatArray, IntArray

_LARGE = 120
"""Number of states without clones from which slots may be free."""

_MORE, _MOST_FREE = 12, 24
"""By how many slots a large state grows, and how many of its slots may be free."""


class CloneSlots:
    """The slots of all clones. Clones are numbered in the order in which they were made.

    Attributes
    ----------
    next
        Number of the next clone.
    """

    def __init__(self) -> None:
        self._slots: dict[int, int] = {}
        self._free: list[int] = []
        self.next = 0
        self._found = ((0, 0), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))

    def __len__(self) -> int:
        return len(self._slots)

    @property
    def numbers(self) -> IntArray:
        """Numbers of the clones (n,), in ascending order."""
        return np.array(list(self._slots), dtype=np.int64)

    def missing(self, size: int) -> int:
        """How many slots a state of a size, without clones, has to get before the next clone; 0 if one is free."""
        if self._free:
            return 0
        return _MORE if size >= _LARGE else 1

    def append(self, count: int) -> None:
        """The state has got so many free slots."""
        end = len(self._slots) + len(self._free) + count
        self._free += range(end - 1, end - 1 - count, -1)

    def fill(self) -> tuple[int, int]:
        """The number of a new clone, and the slot that it has taken."""
        number, slot = self.next, self._free.pop()
        self._slots[number], self.next = slot, number + 1
        return number, slot

    def keep(self, wanted: set[int], size: int) -> bool:
        """Give up the slots of all clones but the wanted ones; whether a state of this size has to close free slots."""
        gone = sorted(self._slots.keys() - wanted)
        self._free += [self._slots.pop(number) for number in gone]
        return len(self._free) > (_MOST_FREE if size >= _LARGE else 0)

    def close(self) -> IntArray:
        """Put all clones into the first slots; their slots so far (n,), in the new order."""
        old = np.array(list(self._slots.values()), dtype=np.int64)
        self._slots, self._free = dict(zip(self._slots, range(len(old)), strict=True)), []
        self._found = ((0, 0), old[:0], old[:0])
        return old

    def clear(self) -> None:
        """The state has no clones and no slots any more."""
        self._slots, self._free = {}, []

    def of(self, clones: IntArray) -> IntArray:
        """Slots (n,) of clones (n,)."""
        # Numbers only grow, so the next one and the number of clones tell whether any clone has come or gone.
        key = len(self._slots), self.next
        if self._found[0] != key:
            self._found = key, self.numbers, np.array(list(self._slots.values()), dtype=np.int64)
        _, numbers, slots = self._found
        return np.asarray(slots[numbers.searchsorted(clones)])


class SpareMemory:
    """Two blocks of memory that take turns: one holds a covariance, and the other one the next covariance.

    Copies of an estimate are made often and need no spare memory: a copy has none.
    """

    def __init__(self) -> None:
        self._blocks = [np.empty(0), np.empty(0)]

    def square(self, size: int) -> FloatArray:
        """An uninitialised matrix (size, size) outside of the last one. Allocating one takes longer than filling it."""
        self._blocks.reverse()
        if self._blocks[0].size < size**2:
            self._blocks[0] = np.empty(2 * size**2)
        return self._blocks[0][: size**2].reshape(size, size)

    def __reduce__(self) -> tuple[type["SpareMemory"], tuple[()]]:
        return type(self), ()
