"""Rays: the first wall or robot that a ray meets."""

import math

import numpy as np

from limslam_env.compilation import compiled, floored, inlined, lean_entry, merged
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.kernels.tables import PERIOD
from limslam_env.kernels.wall_cells import Walls, scene_walls

# Rays that pass exactly through the joint of two walls must hit one of them.
_END_SLACK = 1e-9

NOTHING, ROBOT = -1, -2
"""What a beam hits that hits no wall."""

SHARES = (-1.0, -0.5, 0.5, 1.0)
"""Directions of the further rays of a cone, besides its middle, in shares of half its opening angle."""


@inlined
def is_due(beams: FloatArray, number: int, step: int) -> bool:
    """Whether a beam measures in a step."""
    return beams[number, PERIOD] == 1.0 or step % int(beams[number, PERIOD]) == 0


@inlined
def crossings(place: float, direction: float, side: float) -> tuple[int, int, float, float]:
    """How a ray crosses the cells of a grid along one axis.

    The walk from cell to cell is that of Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing" (1987).

    Parameters
    ----------
    place
        Where it starts, in cells.
    direction
        Its unit vector's part on this axis.
    side
        Of a cell, in the unit of the ray's length.

    Returns
    -------
    cell, step
        Where it starts, and 1 or -1.
    first, spacing
        How far along the ray its first crossing lies, and further ones from each other; infinite if there are none.
    """
    cell = floored(place)
    if direction == 0.0:
        return cell, -1, np.inf, np.inf
    first = ((cell + (direction > 0.0)) - place) * side / direction
    return cell, (1 if direction > 0.0 else -1), first, abs(side / direction)


@inlined
def meeting(ax: float, ay: float, ex: float, ey: float, dx: float, dy: float) -> tuple[float, bool]:
    """How far along a ray (dx, dy) a wall from (ax, ay), seen from its start, along (ex, ey) is met, and whether."""
    # Parallel ones divide by 0, and compare as not met.
    cross = dx * ey - dy * ex
    distance = (ax * ey - ay * ex) / cross
    fraction = (ax * dy - ay * dx) / cross
    return distance, (distance >= 0.0) & (fraction >= -_END_SLACK) & (fraction <= 1.0 + _END_SLACK)


@merged
def first_wall(x: float, y: float, dx: float, dy: float, reach: float, walls: Walls) -> tuple[float, int]:
    """Distance (m) and index of the first wall on a ray; ``reach`` and ``NOTHING`` if it meets no wall.

    The ray starts inside the grid of the walls' cells, goes from cell to cell, and stops in the first cell with a hit.
    """
    edges, cell_starts, cell_edges = walls.edges, walls.cell_starts, walls.cell_edges
    side, columns, rows, first_cell = walls.side, walls.columns, walls.rows, walls.first_cell
    column, column_step, next_column, per_column = crossings((x - walls.low_x) / side, dx, side)
    row, row_step, next_row, per_row = crossings((y - walls.low_y) / side, dy, side)
    best, hit, travelled = reach, NOTHING, 0.0
    while travelled <= best and 0 <= column < columns and 0 <= row < rows:
        cell = first_cell + row * columns + column
        for item in range(cell_starts[cell], cell_starts[cell + 1]):
            edge = cell_edges[item]
            ax, ay = edges[edge, 0] - x, edges[edge, 1] - y
            ex, ey = edges[edge, 2] - edges[edge, 0], edges[edge, 3] - edges[edge, 1]
            distance, is_met = meeting(ax, ay, ex, ey, dx, dy)
            if is_met and distance < best:
                best, hit = distance, edge
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
    """A point or direction of the robot's frame in the world's, for a heading with this cosine and sine."""
    return cos * x - sin * y, sin * x + cos * y


@compiled
def cast_at_discs(
    x: float, y: float, dx: float, dy: float, reach: float, owner: int, centres: FloatArray, radius: float
) -> float:
    """Distance (m) of the first of the discs ``centres`` (m, 2 or more columns) on a ray; not of its owner's."""
    best = reach
    for disc in range(len(centres)):
        if disc == owner:
            continue
        ox, oy = centres[disc, 0] - x, centres[disc, 1] - y
        ahead = ox * dx + oy * dy
        aside = radius * radius - (ox * ox + oy * oy - ahead * ahead)
        if aside > 0.0 and ahead > 0.0:
            best = min(best, max(ahead - math.sqrt(aside), 0.0))
    return best


@merged
def measure(
    robot: int,
    poses: FloatArray,
    radius: float,
    x: float,
    y: float,
    dx: float,
    dy: float,
    reach: float,
    walls: Walls,
) -> tuple[float, int]:
    """Distance (m) of the first wall or other robot on a ray of one robot, and which it is."""
    distance, hit = first_wall(x, y, dx, dy, reach, walls)
    if len(poses) > 1:
        disc = cast_at_discs(x, y, dx, dy, distance, robot, poses, radius)
        if disc < distance:
            return disc, ROBOT
    return distance, hit


@merged
def nearest_in_cone(
    robot: int,
    distance: float,
    hit: int,
    x: float,
    y: float,
    angle: float,
    offset: float,
    reach: float,
    cone: float,
    radius: float,
    poses: FloatArray,
    walls: Walls,
) -> tuple[float, int]:
    """The nearest of what the rays of a cone meet: ``distance`` (m) and ``hit`` of its middle, or nearer ones.

    The cone opens by ``cone`` (rad) to both sides of ``angle`` (rad) at the point (x, y), m, on the rim of the body;
    its rays start ``offset`` (m) before that point and have the length ``reach`` (m).
    """
    for share in SHARES:
        dx, dy = math.cos(angle + share * cone), math.sin(angle + share * cone)
        aside, other = measure(robot, poses, radius, x - offset * dx, y - offset * dy, dx, dy, reach, walls)
        if aside < distance:
            distance, hit = aside, other
    return distance, hit


@lean_entry
def cast_rays(
    origins: FloatArray,
    directions: FloatArray,
    lengths: FloatArray,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    grid: FloatArray,
    distances: FloatArray,
    hits: IntArray,
) -> None:
    """Fill in distance (n,), m, and wall (n,) of rays from (n, 2) along unit vectors (n, 2) of reaches (n,), m."""
    walls = scene_walls(edges, cell_starts, cell_edges, grid)
    for ray in range(len(origins)):
        distances[ray], hits[ray] = first_wall(
            origins[ray, 0], origins[ray, 1], directions[ray, 0], directions[ray, 1], lengths[ray], walls
        )
