"""Walls sorted into the cells of a grid, so that rays and bodies look at those near them only; and
what a ray meets.
"""

import math
from typing import NamedTuple

import numpy as np

from limslam_env.compilation import compiled, floored, inlined, lean_entry, merged
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.kernels.readings import NOTHING, ROBOT

# Of a cell, in its sides; a little more, for rounding.
_HALF_DIAGONAL = 0.70711

# Rays that pass exactly through the joint of two walls must hit one of them.
_END_SLACK = 1e-9

SHARES = (-1.0, -0.5, 0.5, 1.0)
"""Directions of the further rays of a cone, besides its middle, in shares of half its opening
angle.
"""


class Walls(NamedTuple):
    """The walls of one world as the kernels hand them on: a cell list that may lie among those of
    other worlds.

    Attributes
    ----------
    edges
        (k, 4): x1, y1, x2, y2 of each wall, m.
    cell_starts, cell_edges, first_cell
        ``cell_edges[cell_starts[c]:cell_starts[c + 1]]`` are the walls that cross cell ``c -
        first_cell``.
    low_x, low_y, side, columns, rows
        Lower left corner of the grid and side of a cell, m, and its size in cells.
    """

    edges: FloatArray
    cell_starts: IntArray
    cell_edges: IntArray
    low_x: float
    low_y: float
    side: float
    columns: int
    rows: int
    first_cell: int


class Ray(NamedTuple):
    """A ray: where it starts, m, its direction as a unit vector, and its longest length, m."""

    x: float
    y: float
    dx: float
    dy: float
    reach: float


class Discs(NamedTuple):
    """The robots of one environment, as a ray of one of them meets the others.

    Attributes
    ----------
    owner
        Number of the robot that the ray belongs to.
    poses
        Of all of them (n, 2 or more columns), m.
    radius
        Of their bodies, m.
    """

    owner: int
    poses: FloatArray
    radius: float


class Cone(NamedTuple):
    """The cone of a beam: a point on the rim of the body, m, the direction of its middle and half
    its opening, rad, how far before that point its rays start, m, and their length, m.
    """

    x: float
    y: float
    angle: float
    half_angle: float
    offset: float
    reach: float


@lean_entry
def list_walls(
    walls: Walls, border: float, taken: IntArray, cell_starts: IntArray, cell_edges: IntArray
) -> None:
    """Sort walls into the cells that they cross, or come as near to as ``border``, m.

    Called twice: with an empty ``cell_edges`` it fills ``cell_starts`` (cells + 1,), all 0 before;
    with one of ``cell_starts[-1]`` places it fills that. ``taken`` (cells,) is scratch memory, all
    0 before.
    """
    edges = walls.edges
    columns = walls.columns
    rows = walls.rows
    side = walls.side
    is_filling = len(cell_edges) > 0
    for edge in range(len(edges)):
        x1 = edges[edge, 0]
        y1 = edges[edge, 1]
        x2 = edges[edge, 2]
        y2 = edges[edge, 3]
        normal_x = y1 - y2
        normal_y = x2 - x1
        # Half a cell's width across the wall. Walls that run along the border of a cell are in
        # both.
        half = 0.5 * side * (abs(normal_x) + abs(normal_y)) + border * math.hypot(
            normal_x, normal_y
        )
        squared = normal_x * normal_x + normal_y * normal_y
        farthest = border + _HALF_DIAGONAL * side
        for row in range(
            max(math.floor((min(y1, y2) - border - walls.low_y) / side), 0),
            min(math.floor((max(y1, y2) + border - walls.low_y) / side), rows - 1) + 1,
        ):
            for column in range(
                max(math.floor((min(x1, x2) - border - walls.low_x) / side), 0),
                min(math.floor((max(x1, x2) + border - walls.low_x) / side), columns - 1) + 1,
            ):
                x = walls.low_x + (column + 0.5) * side
                y = walls.low_y + (row + 0.5) * side
                if abs((x - x1) * normal_x + (y - y1) * normal_y) > half:
                    continue
                # The ends of the wall, too, must come that near.
                share = min(max(((x - x1) * normal_y - (y - y1) * normal_x) / squared, 0.0), 1.0)
                if math.hypot(x - x1 - share * normal_y, y - y1 + share * normal_x) > farthest:
                    continue
                cell = row * columns + column
                if is_filling:
                    cell_edges[cell_starts[cell] + taken[cell]] = edge
                taken[cell] += 1
    if not is_filling:
        for cell in range(columns * rows):
            cell_starts[cell + 1] = cell_starts[cell] + taken[cell]


@inlined
def crossings(place: float, direction: float, side: float) -> tuple[int, int, float, float]:
    """How a ray crosses the cells of a grid along one axis, for the walk from cell to cell.

    The walk is that of Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing"
    (1987). The ray starts at ``place``, in cells, and ``direction`` is its unit vector's part on
    this axis. A cell's ``side`` is in the unit of the ray's length. Returns the first cell and the
    step, 1 or -1; then how far along the ray the first crossing lies, and further ones from each
    other, infinite if there are none.
    """
    cell = floored(place)
    if direction == 0.0:
        return cell, -1, np.inf, np.inf
    first = ((cell + (direction > 0.0)) - place) * side / direction
    return cell, (1 if direction > 0.0 else -1), first, abs(side / direction)


@inlined
def meeting(ax: float, ay: float, ex: float, ey: float, dx: float, dy: float) -> tuple[float, bool]:
    """How far along a ray (dx, dy) a wall from (ax, ay), seen from its start, along (ex, ey) is
    met, and whether.
    """
    # Parallel ones divide by 0, and compare as not met.
    cross = dx * ey - dy * ex
    distance = (ax * ey - ay * ex) / cross
    fraction = (ax * dy - ay * dx) / cross
    return distance, (distance >= 0.0) & (fraction >= -_END_SLACK) & (fraction <= 1.0 + _END_SLACK)


@merged
def first_wall(ray: Ray, walls: Walls) -> tuple[float, int]:
    """Distance (m) and index of the first wall on a ray; its reach and ``NOTHING`` if it meets no
    wall.

    The ray starts inside the grid of the walls' cells, goes from cell to cell, and stops in the
    first cell with a hit.
    """
    x, y, dx, dy, best = ray
    edges = walls.edges
    cell_starts = walls.cell_starts
    cell_edges = walls.cell_edges
    side = walls.side
    columns = walls.columns
    rows = walls.rows
    first_cell = walls.first_cell
    column, column_step, next_column, per_column = crossings((x - walls.low_x) / side, dx, side)
    row, row_step, next_row, per_row = crossings((y - walls.low_y) / side, dy, side)
    hit = NOTHING
    travelled = 0.0
    while travelled <= best and 0 <= column < columns and 0 <= row < rows:
        cell = first_cell + row * columns + column
        for item in range(cell_starts[cell], cell_starts[cell + 1]):
            edge = cell_edges[item]
            ax = edges[edge, 0] - x
            ay = edges[edge, 1] - y
            ex = edges[edge, 2] - edges[edge, 0]
            ey = edges[edge, 3] - edges[edge, 1]
            distance, is_met = meeting(ax, ay, ex, ey, dx, dy)
            if is_met and distance < best:
                best = distance
                hit = edge
        if next_column < next_row:
            travelled = next_column
            next_column += per_column
            column += column_step
        else:
            travelled = next_row
            next_row += per_row
            row += row_step
    return best, hit


@inlined
def turned(x: float, y: float, cos: float, sin: float) -> tuple[float, float]:
    """A point or direction of the robot's frame in the world's, for a heading with this cosine and
    sine.
    """
    return cos * x - sin * y, sin * x + cos * y


@compiled
def cast_at_discs(ray: Ray, discs: Discs) -> float:
    """Distance (m) of the first of the discs on a ray, but not of its owner's; else its reach."""
    best = ray.reach
    for disc in range(len(discs.poses)):
        if disc == discs.owner:
            continue
        ox = discs.poses[disc, 0] - ray.x
        oy = discs.poses[disc, 1] - ray.y
        ahead = ox * ray.dx + oy * ray.dy
        aside = discs.radius * discs.radius - (ox * ox + oy * oy - ahead * ahead)
        if aside > 0.0 and ahead > 0.0:
            best = min(best, max(ahead - math.sqrt(aside), 0.0))
    return best


@merged
def measure(ray: Ray, discs: Discs, walls: Walls) -> tuple[float, int]:
    """Distance (m) of the first wall or other robot on a ray of one robot, and which it is."""
    distance, hit = first_wall(ray, walls)
    if len(discs.poses) > 1:
        disc = cast_at_discs(Ray(ray.x, ray.y, ray.dx, ray.dy, distance), discs)
        if disc < distance:
            return disc, ROBOT
    return distance, hit


@merged
def nearest_in_cone(
    cone: Cone, distance: float, hit: int, discs: Discs, walls: Walls
) -> tuple[float, int]:
    """The nearest of what the rays of a cone meet: ``distance`` (m) and ``hit`` of its middle, or
    nearer ones.
    """
    for share in SHARES:
        dx = math.cos(cone.angle + share * cone.half_angle)
        dy = math.sin(cone.angle + share * cone.half_angle)
        x = cone.x - cone.offset * dx
        y = cone.y - cone.offset * dy
        aside, other = measure(Ray(x, y, dx, dy, cone.reach), discs, walls)
        if aside < distance:
            distance = aside
            hit = other
    return distance, hit


@lean_entry
def cast_rays(
    origins: FloatArray,
    directions: FloatArray,
    lengths: FloatArray,
    walls: Walls,
    distances: FloatArray,
    hits: IntArray,
) -> None:
    """Fill in distance (n,), m, and wall (n,) of rays from (n, 2) along unit vectors (n, 2) of
    reaches (n,), m.
    """
    for ray in range(len(origins)):
        start_x = origins[ray, 0]
        start_y = origins[ray, 1]
        along = Ray(start_x, start_y, directions[ray, 0], directions[ray, 1], lengths[ray])
        distances[ray], hits[ray] = first_wall(along, walls)
