"""The compact form of a recording: what is packed comes out again, and lengths lose less than half a step."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from support.inspection import unpacked

from limslam_agent.grid.occupancy import GridView
from limslam_agent.inspect.columns import packed
from limslam_agent.inspect.grid import FREE, OCCUPIED, UNKNOWN, GridChanges


def test_what_is_packed_comes_out_again():
    arrays = {
        "odd": np.arange(3, dtype=np.uint8), "times": np.linspace(0.0, 1.0, 5), "empty": np.zeros((0, 2), np.int16),
        "strided": np.arange(12, dtype=np.float32).reshape(3, 4).T, "big": np.arange(2, dtype=">i4"),
    }  # fmt: skip
    found, meta = unpacked(packed(arrays, {"title": "Ü, <b> & </script>", "none": None}))
    assert meta == {"title": "Ü, <b> & </script>", "none": None}
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        assert np.array_equal(found[name], array), name


def restored(changes, cells):
    """The kinds of cells after some changes, as the page restores them."""
    for row, column, length, kind in changes.tolist():
        for place in range(column, column + length):
            cells[row, place] = kind
    return {place: kind for place, kind in cells.items() if kind != UNKNOWN}


def kinds_of(view):
    column, row = np.rint(view.low / view.cell).astype(int).tolist()
    found = np.where(view.values > 0, FREE, np.where(view.values < 0, OCCUPIED, UNKNOWN))
    return {(row + r, column + c): int(kind) for (r, c), kind in np.ndenumerate(found) if kind != UNKNOWN}


@given(st.integers(0, 10_000))
def test_the_changes_of_a_growing_and_moving_grid_restore_it(seed):
    draws, changes, cells = np.random.default_rng(seed), GridChanges(), {}
    for _ in range(4):
        low = 0.1 * draws.integers(-5, 5, 2)
        values = draws.integers(-2, 3, draws.integers(1, 6, 2)).astype(np.int16)
        view = GridView(low, 0.1, values)
        cells = restored(changes.since_last(view), cells)
        assert cells == kinds_of(view)
    assert not len(changes.since_last(view))
