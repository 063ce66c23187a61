"""The inner loops, compiled by numba: rays, readings, and the cells that have been seen.

Functions of one ray or one reading come first; what the simulation calls is put together from them.
Walls come as a *scene*: ``edges`` (k, 4) in metres and a cell list, in which
``cell_edges[cell_starts[c]:cell_starts[c + 1]]`` are the walls that cross cell ``c``; ``grid`` holds the list's
lower left corner x, y and cell side in metres, its columns and its rows.
A grid of what has been seen comes as ``seen`` and ``coverable`` (rows, columns) with ``area``: its lower left
corner x, y and its cell side, m.
"""

import math

import numpy as np
from numba import njit

from limslam_env.geometry import BoolArray, FloatArray, IntArray, ReadingArray

compiled = njit(cache=True, nogil=True, error_model="numpy")
inlined = njit(cache=True, nogil=True, error_model="numpy", inline="always")
# The same, done by LLVM: for functions with loops and returns in their middle.
merged = njit(cache=True, nogil=True, error_model="numpy", forceinline=True)

# Rays that pass exactly through the joint of two walls must hit one of them.
_END_SLACK = 1e-9

# A body may stand this deep in a wall and must not be taken to see what is behind it, m.
BODY_MARGIN = 1e-3

# A ray ends this much of a cell before the wall it hits, so that it never marks the cell behind.
RAY_MARGIN = 1e-6

# Where the rays of a cone lie besides its middle, in shares of half its opening.
CONE = (-1.0, -0.5, 0.5, 1.0)

NOTHING, ROBOT = -1, -2
"""What a beam hits that hits no wall."""


@compiled
def list_walls(edges: FloatArray, grid: FloatArray, border: float, cell_starts: IntArray, cell_edges: IntArray) -> None:
    """Sort walls into the cells that they cross, or come as near to as ``border``, m.

    Called twice: with an empty ``cell_edges`` it fills ``cell_starts`` (cells + 1,), all 0 before; with one of
    ``cell_starts[-1]`` places it fills that.
    """
    columns, rows, side = int(grid[3]), int(grid[4]), grid[2]
    is_filling = len(cell_edges) > 0
    taken = np.zeros(columns * rows, dtype=np.int64)
    for edge in range(len(edges)):
        x1, y1, x2, y2 = edges[edge]
        normal_x, normal_y = y1 - y2, x2 - x1
        # Half a cell's width across the wall. Walls that run along the border of a cell are in both.
        half = 0.5 * side * (abs(normal_x) + abs(normal_y)) + border * math.hypot(normal_x, normal_y)
        for row in range(
            max(math.floor((min(y1, y2) - border - grid[1]) / side), 0),
            min(math.floor((max(y1, y2) + border - grid[1]) / side), rows - 1) + 1,
        ):
            for column in range(
                max(math.floor((min(x1, x2) - border - grid[0]) / side), 0),
                min(math.floor((max(x1, x2) + border - grid[0]) / side), columns - 1) + 1,
            ):
                x, y = grid[0] + (column + 0.5) * side, grid[1] + (row + 0.5) * side
                if abs((x - x1) * normal_x + (y - y1) * normal_y) > half:
                    continue
                cell = row * columns + column
                if is_filling:
                    cell_edges[cell_starts[cell] + taken[cell]] = edge
                taken[cell] += 1
    if not is_filling:
        cell_starts[1:] = np.cumsum(taken)


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
    cell = math.floor(place)
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


@inlined
def first_wall(
    x: float,
    y: float,
    dx: float,
    dy: float,
    reach: float,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    low_x: float,
    low_y: float,
    side: float,
    columns: int,
    rows: int,
    first_cell: int,
) -> tuple[float, int]:
    """:func:`cast_ray` in one of several cell lists that lie one after the other; its own begins at ``first_cell``.

    The ray starts inside the cell list's grid, goes from cell to cell, and stops in the first one that holds a hit.
    """
    column, column_step, next_column, per_column = crossings((x - low_x) / side, dx, side)
    row, row_step, next_row, per_row = crossings((y - low_y) / side, dy, side)
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
def cast_ray(
    x: float,
    y: float,
    dx: float,
    dy: float,
    reach: float,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    grid: FloatArray,
) -> tuple[float, int]:
    """Distance (m) and index of the first wall on a ray; ``reach`` and -1 where there is none."""
    return first_wall(
        x, y, dx, dy, reach, edges, cell_starts, cell_edges,
        grid[0], grid[1], grid[2], int(grid[3]), int(grid[4]), 0,
    )  # fmt: skip


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


@inlined
def mark_ray(
    seen: BoolArray, coverable: BoolArray, area: FloatArray, x: float, y: float, dx: float, dy: float, reach: float
) -> int:
    """Set every cell that a ray crosses; the number of coverable cells that are new."""
    cell = area[2]
    x, y = (x - area[0]) / cell, (y - area[1]) / cell
    end = reach / cell - RAY_MARGIN
    rows, columns = seen.shape
    column, column_step, next_column, per_column = crossings(x, dx, 1.0)
    row, row_step, next_row, per_row = crossings(y, dy, 1.0)
    travelled, new = 0.0, 0
    while travelled <= end:
        if 0 <= row < rows and 0 <= column < columns and not seen[row, column]:
            seen[row, column] = True
            new += coverable[row, column]
        if next_column < next_row:
            travelled = next_column
            next_column += per_column
            column += column_step
        else:
            travelled = next_row
            next_row += per_row
            row += row_step
    return new


@inlined
def is_touched(column: int, row: int, x: float, y: float, radius: float) -> bool:
    """Whether a disc touches a cell; all in cells."""
    aside = x - min(max(x, column), column + 1.0)
    above = y - min(max(y, row), row + 1.0)
    return aside * aside + above * above < radius * radius


@inlined
def mark_disc(seen: BoolArray, coverable: BoolArray, area: FloatArray, x: float, y: float, radius: float) -> int:
    """Set every cell that a body touches; the number of coverable cells that are new."""
    cell = area[2]
    x, y, radius = (x - area[0]) / cell, (y - area[1]) / cell, (radius - BODY_MARGIN) / cell
    rows, columns = seen.shape
    new = 0
    for row in range(math.floor(y - radius), math.floor(y + radius) + 1):
        for column in range(math.floor(x - radius), math.floor(x + radius) + 1):
            if (
                is_touched(column, row, x, y, radius)
                and 0 <= row < rows
                and 0 <= column < columns
                and not seen[row, column]
            ):
                seen[row, column] = True
                new += coverable[row, column]
    return new


@inlined
def noisy_reading(
    ideal: float,
    hit: int,
    shortest: float,
    longest: float,
    deviation: float,
    growth: float,
    dropout: float,
    resolution: float,
    fold_back: float,
    normal: float,
    uniform: float,
) -> float:
    """What a beam reads of a wall at ``ideal`` (m), with numbers drawn from N(0, 1) and U(0, 1).

    Noise: standard deviation (m), its growth (1/m, times the squared range), chance of a dropout,
    resolution (m) and fold-back (m per metre nearer than ``shortest``). A beam that hits nothing reads
    ``longest`` exactly.
    """
    if hit == NOTHING or uniform < dropout:
        return longest
    std = math.hypot(deviation, growth * ideal * ideal) if growth > 0.0 else deviation
    folds = fold_back > 0.0 and ideal < shortest
    reading = (shortest + fold_back * (shortest - ideal) if folds else ideal) + std * normal
    if resolution > 0.0:
        reading = math.floor(reading / resolution + 0.5) * resolution
    return min(max(reading, shortest), longest)


@inlined
def reported_travel(
    travel: float, untold: float, factor: float, variance: float, resolution: float, limit: float, normal: float
) -> tuple[float, float]:
    """What an encoder says of a wheel's ``travel`` (m), and what it will have to say later (m).

    It counts ``factor`` times the travel, with noise of ``variance`` per metre from the N(0, 1) number ``normal``,
    and what was ``untold`` so far (m); in steps of ``resolution`` (m; 0 for none), and no more than ``limit`` (m).
    """
    counted = travel * factor + math.sqrt(variance * abs(travel)) * normal + untold
    told = np.trunc(counted / resolution) * resolution if resolution > 0.0 else counted
    told = min(max(told, -limit), limit)
    return told, counted - told


@inlined
def turned(x: float, y: float, cos: float, sin: float) -> tuple[float, float]:
    """A point or direction of the robot's frame in the world's, for a heading with this cosine and sine."""
    return cos * x - sin * y, sin * x + cos * y


@inlined
def measure(
    robot: int,
    poses: FloatArray,
    radius: float,
    x: float,
    y: float,
    dx: float,
    dy: float,
    reach: float,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    grid: FloatArray,
) -> tuple[float, int]:
    """Distance (m) of the first wall or other robot on a ray of one robot, and which it is."""
    distance, hit = cast_ray(x, y, dx, dy, reach, edges, cell_starts, cell_edges, grid)
    if len(poses) > 1:
        disc = cast_at_discs(x, y, dx, dy, distance, robot, poses, radius)
        if disc < distance:
            return disc, ROBOT
    return distance, hit


@compiled
def observe(
    poses: FloatArray,
    travel: FloatArray,
    step: int,
    radius: float,
    beams: FloatArray,
    noise: FloatArray,
    draws: FloatArray,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    grid: FloatArray,
    seen: BoolArray,
    coverable: BoolArray,
    area: FloatArray,
    untold: FloatArray,
    hits: IntArray,
    ranges: ReadingArray,
    wheels: ReadingArray,
    new_cells: IntArray,
) -> None:
    """Take all robots' measurements of one step, and mark what their true beams and bodies cover.

    Parameters
    ----------
    poses, travel
        Robots (n, 3), m and rad, and how far their wheels have turned (n, 2), m.
    step
        Number of this step; beams whose turn it is not keep ``hits`` and ``ranges``.
    radius
        Of their bodies, m.
    beams
        (n_beams, 9): origin x, y (m), angle (rad), how far before the origin the ray starts (m), shortest and
        longest reading (m), the period in steps, and the direction's x and y.
    noise
        What :func:`noisy_reading` needs, half the opening of the beams' cone (rad), then the factor of the left and
        the right wheel and what follows it in :func:`reported_travel`.
    draws
        (n, n_beams + 2, 2) numbers from N(0, 1) and U(0, 1): for each beam, then for each wheel.
    edges, cell_starts, cell_edges, grid
        The walls.
    seen, coverable, area
        The grid of what has been seen.
    untold
        (n, 2), kept from step to step: travel that the encoders have not told so far, m.
    hits, ranges
        (n, n_beams), kept from step to step: the wall that each beam hit, and its reading, m.
    wheels
        (n, 2), set to what the encoders say, m.
    new_cells
        (n,), set to the number of cells that each robot covered as the first.
    """
    # Numbers are taken out of the arrays one by one: a slice costs as much as a ray.
    for robot in range(len(poses)):
        body_x, body_y, heading = poses[robot, 0], poses[robot, 1], poses[robot, 2]
        cos, sin = math.cos(heading), math.sin(heading)
        new = mark_disc(seen, coverable, area, body_x, body_y, radius)
        for number in range(len(beams)):
            if step % int(beams[number, 6]) != 0:
                continue
            offset, longest = beams[number, 3], beams[number, 5]
            # The rim may touch a wall, and a ray from there start behind it: rays start inside the body.
            rim_x, rim_y = turned(beams[number, 0], beams[number, 1], cos, sin)
            rim_x, rim_y = body_x + rim_x, body_y + rim_y
            dx, dy = turned(beams[number, 7], beams[number, 8], cos, sin)
            x, y, reach = rim_x - offset * dx, rim_y - offset * dy, longest + offset
            distance, hit = measure(
                robot, poses, radius, x, y, dx, dy, reach, edges, cell_starts, cell_edges, grid
            )  # fmt: skip
            new += mark_ray(seen, coverable, area, x, y, dx, dy, distance)
            if noise[5] > 0.0:
                angle = heading + beams[number, 2]
                for share in CONE:
                    dx, dy = math.cos(angle + share * noise[5]), math.sin(angle + share * noise[5])
                    x, y = rim_x - offset * dx, rim_y - offset * dy
                    aside, other = measure(
                        robot, poses, radius, x, y, dx, dy, reach, edges, cell_starts, cell_edges, grid
                    )  # fmt: skip
                    if aside < distance:
                        distance, hit = aside, other
            normal, uniform = draws[robot, number, 0], draws[robot, number, 1]
            hits[robot, number] = hit
            ranges[robot, number] = noisy_reading(
                distance - offset, hit, beams[number, 4], longest,
                noise[0], noise[1], noise[2], noise[3], noise[4], normal, uniform,
            )  # fmt: skip
        new_cells[robot] = new
        for side in range(2):
            wheels[robot, side], untold[robot, side] = reported_travel(
                travel[robot, side], untold[robot, side],
                noise[6 + side], noise[8], noise[9], noise[10], draws[robot, len(beams) + side, 0],
            )  # fmt: skip


@compiled
def sweep(
    poses: FloatArray,
    step: int,
    radius: float,
    beams: FloatArray,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    grid: FloatArray,
    seen: BoolArray,
    coverable: BoolArray,
    area: FloatArray,
    new_cells: IntArray,
) -> None:
    """Mark what one robot covers at poses (n, 3), m and rad, one after the other from ``step`` on, and alone there.

    Beams, walls and grid are those of :func:`observe`; ``new_cells`` (n,) is set to how many cells each pose adds.
    """
    for number in range(len(poses)):
        body_x, body_y, heading = poses[number, 0], poses[number, 1], poses[number, 2]
        cos, sin = math.cos(heading), math.sin(heading)
        new = mark_disc(seen, coverable, area, body_x, body_y, radius)
        for beam in range(len(beams)):
            if (step + number) % int(beams[beam, 6]) == 0:
                offset = beams[beam, 3]
                dx, dy = turned(beams[beam, 7], beams[beam, 8], cos, sin)
                x, y = turned(beams[beam, 0], beams[beam, 1], cos, sin)
                x, y, reach = body_x + x - offset * dx, body_y + y - offset * dy, beams[beam, 5] + offset
                distance, _ = cast_ray(x, y, dx, dy, reach, edges, cell_starts, cell_edges, grid)
                new += mark_ray(seen, coverable, area, x, y, dx, dy, distance)
        new_cells[number] = new


@compiled
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
    for ray in range(len(origins)):
        distances[ray], hits[ray] = cast_ray(
            origins[ray, 0], origins[ray, 1], directions[ray, 0], directions[ray, 1], lengths[ray],
            edges, cell_starts, cell_edges, grid,
        )  # fmt: skip


@compiled
def look_out(
    places: FloatArray,
    views: FloatArray,
    reach: float,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    grid: FloatArray,
    seen: BoolArray,
    area: FloatArray,
    reachable: BoolArray,
    reachable_area: FloatArray,
) -> None:
    """Set the cells that can be seen from ``places`` (n, 2), m, along unit vectors ``views`` (v, 2).

    A view that goes on inside of what is ``reachable`` (its own grid, with corner and cell side) is left out:
    what it leads to is seen from where it comes out.
    """
    rows, columns = reachable.shape
    low_x, low_y, side = reachable_area
    for place in range(len(places)):
        x, y = places[place, 0], places[place, 1]
        for view in range(len(views)):
            dx, dy = views[view, 0], views[view, 1]
            column = math.floor((x + 1.5 * side * dx - low_x) / side)
            row = math.floor((y + 1.5 * side * dy - low_y) / side)
            if 0 <= row < rows and 0 <= column < columns and reachable[row, column]:
                continue
            distance, _ = cast_ray(x, y, dx, dy, reach, edges, cell_starts, cell_edges, grid)
            mark_ray(seen, seen, area, x, y, dx, dy, distance)
