"""What part of a world's floor robots can reach from where they start, and where an outer wall is open."""

import functools
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.worlds.free_space import FreeSpace
from limslam_env.worlds.world import World

SMALL_SHARE = 0.5
"""Share of the floor below which a start region counts as small."""

_GAPS = (1.0, 2.0, 4.0)  # widths of gaps that are looked for, m
_LEAST_AREA = 1.0  # m^2, of an open region that is worth a warning
_EIGHT = np.ones((3, 3), dtype=int)


@dataclass(frozen=True)
class StartRegion:
    """The region in which the robots of a world start, beside the rest of the floor.

    Attributes
    ----------
    area
        Floor that robots can cover from the starts, m^2. In a world without starts, that of the largest closed region.
    floor
        All floor that is enclosed by walls, m^2, with the region behind ``gap``.
    open_area
        Floor of the largest region that would be closed if its outer wall had no gap, m^2. 0 if there is none.
    gap
        Middle of that gap: x, y, m. None if there is none.
    """

    area: float
    floor: float
    open_area: float
    gap: tuple[float, float] | None

    @property
    def share(self) -> float:
        """Share of the floor that the region has, 0 to 1."""
        return min(self.area / self.floor, 1.0) if self.floor > 0.0 else 1.0

    @property
    def is_small(self) -> bool:
        """Whether most of the floor lies elsewhere."""
        return self.share < SMALL_SHARE

    @property
    def warning(self) -> str | None:
        """One line about an open outer wall or a small region. None if there is nothing to say."""
        region = (
            f"robots start in a region of {self.area:.1f} m^2, {self.share:.1%} of the floor of {self.floor:.1f} m^2"
        )
        if self.gap is not None:
            x, y = self.gap
            return (
                f"the outer wall is open near ({x:.1f}, {y:.1f}), so the region of {self.open_area:.1f} m^2 behind it "
                f"cannot be used; {region}"
            )
        return f"{region}; the other regions cannot be reached" if self.is_small else None


@functools.lru_cache(maxsize=8)
def start_region(world: World, radius: float) -> StartRegion:
    """Measure the start region of robots of a ``radius`` (m), and look for a gap of up to 4 m in the outer wall."""
    space = world.free_space(radius)
    labels = space.labels
    border = np.unique(np.concatenate((labels[0], labels[-1], labels[:, 0], labels[:, -1])))
    closed = space.free & ~np.isin(labels, border[border > 0])
    area, floor = covered_area(starting_cells(world, space), space, radius), covered_area(closed, space, radius)
    open_area, gap = _open_region(space, radius)
    return StartRegion(area, floor + open_area, open_area, gap)


def starting_cells(world: World, space: FreeSpace) -> BoolArray:
    """The cells of a world's free space that robots can reach from its starts, or its largest closed region."""
    if not len(world.starts):
        return space.largest_closed_region()
    labels = {space.label_of(start[:2]) for start in world.starts} - {0}
    return np.isin(space.labels, list(labels))


def covered_area(centres: BoolArray, space: FreeSpace, radius: float) -> float:
    """Floor (m^2) that a disc of ``radius`` (m) covers from some cells of a free space."""
    if not centres.any():
        return 0.0
    within = ndimage.distance_transform_edt(~centres, sampling=space.cell) <= radius
    return float(np.count_nonzero(within)) * space.cell**2


def _open_region(space: FreeSpace, radius: float) -> tuple[float, tuple[float, float] | None]:
    """Area (m^2) of the largest region behind a gap in the outer wall, and the gap's middle. 0 and None without a gap.

    A region is behind a gap if the robot's disc can leave it, but a disc as wide as the gap could not.
    """
    # The grid ends close to the walls. Larger discs need more space to pass around the building.
    around = int(np.ceil(_GAPS[-1] / space.cell))
    free = np.pad(space.free, around, constant_values=True)
    labels, _ = ndimage.label(free, structure=_EIGHT)
    outside = labels == labels[0, 0]
    room = radius + ndimage.distance_transform_edt(free, sampling=space.cell)
    for width in _GAPS:
        if width <= 2.0 * radius:
            continue
        wide, _ = ndimage.label(outside & (room >= 0.5 * width), structure=_EIGHT)
        sizes = np.bincount(wide.ravel())
        sizes[[0, wide[0, 0]]] = 0
        if not sizes.any():
            continue
        hall = wide == np.argmax(sizes)
        within = ndimage.distance_transform_edt(~hall, sampling=space.cell)
        area = float(np.count_nonzero(within <= 0.5 * width)) * space.cell**2
        if area >= _LEAST_AREA:
            beyond = ndimage.distance_transform_edt(wide != wide[0, 0], sampling=space.cell)
            return area, _middle(space, outside, within, beyond, around)
    return 0.0, None


def _middle(
    space: FreeSpace, outside: BoolArray, within: FloatArray, beyond: FloatArray, around: int
) -> tuple[float, float]:
    """The point (x, y), m, on the shortest way from the region to the outside. A way through a wall is longer than one
    through a gap.
    """
    way = np.where(outside, within + beyond, np.inf)
    shortest = way <= way.min() + space.cell
    halfway = np.where(shortest, np.abs(within - beyond), np.inf)
    row, column = np.unravel_index(int(np.argmin(halfway)), halfway.shape)
    x, y = space.origin + (np.array([column, row]) - around + 0.5) * space.cell
    return float(x), float(y)
