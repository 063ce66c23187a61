"""What part of a world's floor robots can reach from where they start."""

import functools
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from limslam_env.geometry import BoolArray
from limslam_env.worlds.free_space import FreeSpace
from limslam_env.worlds.world import World

SMALL_SHARE = 0.5
"""Share of the floor below which a start region counts as small."""

# share of what is not solid in the rectangle around a building, below which its enclosed floor is
# hardly all of its floor
_OPEN_SHARE = 0.25


@dataclass(frozen=True)
class StartRegion:
    """The region in which the robots of a world start, beside the rest of the floor.

    Attributes
    ----------
    area
        Floor that robots can cover from the starts, m^2. In a world without starts, that of the
        largest closed region.
    floor, is_open
        All floor that is enclosed by walls, m^2, or the rectangle around all walls without its
        obstacles, if so little is enclosed that the outer wall must be open.
    """

    area: float
    floor: float
    is_open: bool

    @property
    def share(self) -> float:
        """Share of the floor that the region has, 0 to 1."""
        return min(self.area / self.floor, 1.0)

    @property
    def is_small(self) -> bool:
        """Whether most of the floor lies elsewhere."""
        return self.share < SMALL_SHARE

    @property
    def warning(self) -> str | None:
        """One line about an open outer wall or a small region. None if there is nothing to say."""
        region = (
            f"robots start in a region of {self.area:.1f} m^2, {self.share:.1%} of the floor of "
            f"{self.floor:.1f} m^2"
        )
        if self.is_open:
            return f"the outer wall is open, so most of the floor cannot be used; {region}"
        return f"{region}; the other regions cannot be reached" if self.is_small else None


@functools.lru_cache(maxsize=8)
def start_region(world: World, radius: float) -> StartRegion:
    """Measure the start region of robots of a ``radius`` (m)."""
    space = world.free_space(radius)
    closed = space.free & ~np.isin(space.labels, space.border_labels)
    area = covered_area(starting_cells(world, space), space, radius)
    floor = covered_area(closed, space, radius)
    solid = sum(cv2.contourArea(polygon.astype(np.float32)) for polygon in world.obstacles)
    around = float(np.prod(np.ptp(world.edges.reshape(-1, 2), axis=0))) - solid
    is_open = floor < _OPEN_SHARE * around
    return StartRegion(area, around if is_open else floor, is_open)


def starting_cells(world: World, space: FreeSpace) -> BoolArray:
    """The cells of a world's free space that robots can reach from its starts, or its largest
    closed region.
    """
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
