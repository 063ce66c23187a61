"""Outlines of the cells of a picture that block: straight walls and polygons."""

import cv2
import numpy as np
from numpy.typing import NDArray

from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.segment import polygon_edges
from limslam_env.worlds.world import WorldError

# Noise has a patch or a corner at every other cell, and would take minutes; floor plans stay far
# below.
_MAX_OUTLINES = 20_000
_MAX_CORNERS = 1_000_000
_PILLAR_CORNERS = 100


def outlines_of(occupied: BoolArray) -> tuple[FloatArray, list[FloatArray]]:
    """The walls (n, 4) that make up the outlines of occupied cells, and polygons around the solid
    patches, each (k, 2).

    Lengths are in cells, from the lower left corner of ``occupied`` (rows, columns), uppermost row
    first; y is up.
    """
    rows, columns = (np.nonzero(occupied.any(axis=axis))[0] for axis in (1, 0))
    if not rows.size:
        raise WorldError("no cell is occupied")
    part = occupied[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    if _corner_count(part) > _MAX_CORNERS:
        raise WorldError(
            f"its walls have more than {_MAX_CORNERS} corners: noise, or no floor plan"
        )
    # Twice as fine: the outline of a wall of one cell would otherwise run forth and back on one
    # line.
    doubled = part.astype(np.uint8).repeat(2, axis=0).repeat(2, axis=1)
    contours, hierarchy = cv2.findContours(doubled, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    if len(contours) > _MAX_OUTLINES:
        raise WorldError(
            f"{len(contours)} separate outlines: noise, or no floor plan; up to {_MAX_OUTLINES} "
            "can be used"
        )
    polygons = []
    walls = [np.zeros((0, 4))]
    for contour, (_, _, hole, around) in zip(contours, hierarchy[0], strict=True):
        is_solid = hole < 0 and around < 0
        corners = _corners_of(contour[:, 0].astype(np.int32), doubled, is_solid=is_solid)
        placed = _placed(corners, (int(columns[0]), int(rows[0])), len(occupied))
        if is_solid and _is_simple(corners):
            polygons.append(placed)
        elif len(corners) > 1:
            # The outline of a thin wall is one line, there and back.
            walls.append(polygon_edges(placed)[: None if len(corners) > 2 else 1])
    return np.vstack(walls), polygons


def _placed(corners: IntArray, first: tuple[int, int], height: int) -> FloatArray:
    """Corners (k, 2), columns and rows of half cells, as x and y in cells, in a picture of a height
    in cells. Column and row ``first`` of the picture are theirs.
    """
    cells = (corners + 0.5) / 2.0 + first
    return np.column_stack((cells[:, 0], height - cells[:, 1]))


def pieces_of(solid: BoolArray) -> list[FloatArray]:
    """Polygons, each (k, 2), that together cover the patches of cells (rows, columns), which may
    have holes.

    Patches with holes are cut through the hole that is nearest to the middle, at a column that both
    parts keep, until no part has one. Lengths are as for :func:`outlines_of`.
    """
    found = list[FloatArray]()
    parts = [(solid, 0)]
    while parts:
        cells, first = parts.pop()
        doubled = cells.astype(np.uint8).repeat(2, axis=0).repeat(2, axis=1)
        contours, hierarchy = cv2.findContours(doubled, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
        if not contours:
            continue
        holes = np.flatnonzero(hierarchy[0][:, 3] >= 0)
        if holes.size:
            boxes = [cv2.boundingRect(contours[int(number)]) for number in holes]
            middles = np.array([left + width // 2 for left, _, width, _ in boxes]) // 2
            cut = int(middles[np.argmin(np.abs(middles - cells.shape[1] // 2))])
            parts += [(cells[:, : cut + 1], first), (cells[:, cut:], first + cut)]
            continue
        for contour in contours:
            corners = _corners_of(contour[:, 0].astype(np.int32), doubled, is_solid=True)
            if len(corners) >= 3:  # others have no area
                found.append(_placed(corners, (first, 0), len(solid)))
    return found


def _corners_of(contour: IntArray, occupied: NDArray[np.uint8], *, is_solid: bool) -> IntArray:
    """The corners (n, 2) of a contour (k, 2) of columns and rows, without the steps of slanted
    walls.
    """
    outline = _with_corners(contour, occupied)
    corners = cv2.approxPolyDP(outline[:, None], 2.0, closed=True)[:, 0].astype(np.int64)
    # A patch of a cell or so is still in the way.
    return outline if is_solid and len(corners) == 1 else corners


def _corner_count(occupied: BoolArray) -> int:
    """How often the outlines of the occupied cells (rows, columns) turn, those along the border
    left out.
    """
    change = occupied[1:] ^ occupied[:-1]
    # Along an outline that runs straight on, two cells beside each other differ from those below
    # alike.
    turns = change[:, 1:] ^ change[:, :-1]
    touching = change[:, 1:] & change[:, :-1] & (occupied[1:, 1:] ^ occupied[1:, :-1])
    return int(np.count_nonzero(turns) + 2 * np.count_nonzero(touching))


def _with_corners(outline: IntArray, occupied: NDArray[np.uint8]) -> IntArray:
    """An outline (k, 2) of columns and rows with the inner corners, which OpenCV cuts off by a
    diagonal step.
    """
    step = np.roll(outline, -1, axis=0) - outline
    at = np.nonzero(np.abs(step).min(axis=1) == 1)[0]
    ahead = outline[at] + step[at] * (1, 0)
    aside = outline[at] + step[at] * (0, 1)
    # One side of the step is open, and the corner is on the other; where two patches touch, both
    # are open.
    corner = np.where(occupied[ahead[:, 1], ahead[:, 0], None] > 0, ahead, aside)
    inner = occupied[corner[:, 1], corner[:, 0]] > 0
    return np.insert(outline, at[inner] + 1, corner[inner], axis=0)


def _is_simple(corners: IntArray) -> bool:
    """Whether a polygon (k, 2) of whole numbers has an area and touches itself nowhere."""
    if not 3 <= len(corners) <= _PILLAR_CORNERS:
        return False
    a = corners
    b = np.roll(corners, -1, axis=0)
    span = b - a
    after = np.roll(b - a, -1, axis=0)
    turns = span[:, 0] * after[:, 1] - span[:, 1] * after[:, 0]
    if ((turns == 0) & ((span * after).sum(axis=1) < 0)).any():  # it runs back on itself
        return False

    def side(points: IntArray) -> IntArray:
        """On which side of edge i point j lies: -1, 0, 1."""
        offset = points[None] - a[:, None]
        return np.asarray(
            np.sign(span[:, None, 0] * offset[..., 1] - span[:, None, 1] * offset[..., 0])
        )

    straddles = side(a) * side(b) <= 0
    low = np.minimum(a, b)
    high = np.maximum(a, b)
    overlap = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=-1)
    index = np.arange(len(corners))
    apart = (index[:, None] - index[None]) % len(corners)
    strangers = (apart != 0) & (apart != 1) & (apart != len(corners) - 1)
    return not (straddles & straddles.T & overlap & strangers).any()
