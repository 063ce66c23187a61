"""The inner loops of many worlds at once: random numbers, contact, and what is left to see.

Rays, readings and encoders are those of :mod:`limslam_env.kernels`. Worlds lie in one set of arrays, each with its
first places in them; where this says *tiles*, a word of 64 bits stands for 8 x 8 cells of a coverage grid, one bit a
cell, row by row from the lower left, and so do the tiles of a world.
"""

import math

import numpy as np
from numpy.typing import NDArray

from limslam_env.geometry import BoolArray, FloatArray, IntArray, ReadingArray, se2
from limslam_env.kernels import (
    BODY_MARGIN,
    CONE,
    RAY_MARGIN,
    ROBOT,
    cast_at_discs,
    compiled,
    crossings,
    first_wall,
    inlined,
    is_touched,
    meeting,
    merged,
    noisy_reading,
    reported_travel,
    turned,
)

Words = NDArray[np.uint64]

SOURCE_STAMP = ""
"""What ``kernels`` and ``se2`` were like when this file was last changed: numba's cache looks at this file alone."""

SKIP, STEP, BEGIN = 0, 1, 2
"""What becomes of an environment: nothing, a step, or a new episode's first observation."""

TILE = 8

_TOUCH, _DEEPEST, _MAX_PUSHES, _LONGEST_MOVE = 1e-5, 5e-4, 24, 0.5

# How far is looked for things that could be touched in later steps, m.
_OUTLOOK = 0.3

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_S27, _S30, _S31, _S11 = np.uint64(27), np.uint64(30), np.uint64(31), np.uint64(11)
_NONE, _ONE, _LAYER = np.uint64(0), np.uint64(1), np.uint64(127)
_EIGHT, _SIXTEEN = np.uint64(8), np.uint64(16)
_FULL, _BYTE, _EACH_ROW = np.uint64(0xFFFFFF), np.uint64(0xFF), np.uint64(0x0101010101010101)

# Whole rows of a tile, for each set of rows as bits.
_ROW_MASKS = np.array([sum(0xFF << 8 * row for row in range(8) if rows >> row & 1) for rows in range(256)], np.uint64)
_UNIT = 2.0**-53

_NUM_LAYERS = 128
_TAIL, _VOLUME = 3.442619855899, 9.91256303526217e-3

arc_end = inlined(se2.arc_end)


def _layer_edges() -> FloatArray:
    edges = np.zeros(_NUM_LAYERS + 1)
    density = math.exp(-0.5 * _TAIL * _TAIL)
    edges[0], edges[1] = _VOLUME / density, _TAIL
    for layer in range(2, _NUM_LAYERS):
        density += _VOLUME / edges[layer - 1]
        edges[layer] = math.sqrt(-2.0 * math.log(density))
    return edges


_EDGES = _layer_edges()
_RATIOS = _EDGES[1:] / _EDGES[:-1]


@inlined
def mixed(state: np.uint64) -> np.uint64:
    """64 random bits from a number of a sequence: splitmix64 (Steele, Lea and Flood, 2014)."""
    state = (state ^ (state >> _S30)) * _MIX_1
    state = (state ^ (state >> _S27)) * _MIX_2
    return state ^ (state >> _S31)


@inlined
def unit(bits: np.uint64) -> float:
    """A number from U(0, 1) of random bits; 1 is left out."""
    number: float = float(bits >> _S11) * _UNIT
    return number


@merged
def normal(bits: np.uint64) -> float:
    """A number from N(0, 1) of random bits, exactly.

    The ziggurat of 128 layers, after Doornik, "An improved ziggurat method to generate normal random samples" (2005).
    """
    layer = bits & _LAYER
    share = 2.0 * unit(bits) - 1.0
    if abs(share) < _RATIOS[layer]:
        place: float = share * _EDGES[layer]
        return place
    return _rare_normal(bits)


@compiled
def _rare_normal(bits: np.uint64) -> float:
    """:func:`normal`, for one number in eighty; further bits that it needs are mixed from the first."""
    while True:
        layer = bits & _LAYER
        share = 2.0 * unit(bits) - 1.0
        place: float = share * _EDGES[layer]
        if abs(share) < _RATIOS[layer]:
            return place
        bits = mixed(bits + _GOLDEN)
        if layer == 0:
            break
        outer = math.exp(-0.5 * (_EDGES[layer] * _EDGES[layer] - place * place))
        inner = math.exp(-0.5 * (_EDGES[layer + _ONE] * _EDGES[layer + _ONE] - place * place))
        if inner + unit(bits) * (outer - inner) < 1.0:
            return place
        bits = mixed(bits + _GOLDEN)
    while True:
        beyond = -math.log(1.0 - unit(bits)) / _TAIL
        bits = mixed(bits + _GOLDEN)
        height = -math.log(1.0 - unit(bits))
        bits = mixed(bits + _GOLDEN)
        if 2.0 * height > beyond * beyond:
            return math.copysign(_TAIL + beyond, share)


@compiled
def derive_keys(homes: Words, episodes: IntArray, purpose: int) -> Words:
    """Keys (n,) of random numbers for one purpose in episodes (n,) of environments with keys ``homes`` (n,)."""
    keys = np.empty_like(homes)
    for row in range(len(homes)):
        keys[row] = mixed(mixed(homes[row] + np.uint64(episodes[row]) * _GOLDEN) + np.uint64(purpose) * _GOLDEN)
    return keys


@compiled
def fill_units(keys: Words, numbers: FloatArray) -> None:
    """Set ``numbers`` (n, k) to numbers from U(0, 1), each row by its key (n,)."""
    for row in range(len(keys)):
        for place in range(numbers.shape[1]):
            numbers[row, place] = unit(mixed(keys[row] + np.uint64(place + 1) * _GOLDEN))


@compiled
def draw_starts(
    keys: Words, num_given: int, places: IntArray, space: FloatArray, apart: float, poses: FloatArray, tries: int
) -> bool:
    """Put robots from the ``num_given``-th on at free places; whether there was room.

    Parameters
    ----------
    keys
        (n,), of random numbers.
    places
        Numbers of free cells, row by row, in a grid ``space``: lower left corner x, y, cell side (m) and columns.
    apart
        Least distance of two robots, m.
    poses
        (n, m, 3), those that are given set already, m and rad.
    tries
        How many places are tried for all robots of one environment.
    """
    columns = int(space[3])
    for env in range(len(keys)):
        state, placed = keys[env], num_given
        for _ in range(tries):
            if placed == poses.shape[1] or len(places) == 0:
                break
            cell = places[int(unit(mixed(state + _GOLDEN)) * len(places))]
            heading = (2.0 * unit(mixed(state + _GOLDEN + _GOLDEN)) - 1.0) * math.pi
            state = state + _GOLDEN + _GOLDEN
            x, y = space[0] + (cell % columns + 0.5) * space[2], space[1] + (cell // columns + 0.5) * space[2]
            is_free = True
            for other in range(placed):
                is_free &= math.hypot(poses[env, other, 0] - x, poses[env, other, 1] - y) > apart
            if is_free:
                poses[env, placed, 0], poses[env, placed, 1], poses[env, placed, 2] = x, y, heading
                placed += 1
        if placed < poses.shape[1]:
            return False
    return True


@merged
def nearest_wall(
    x: float,
    y: float,
    outlook: float,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    low_x: float,
    low_y: float,
    side: float,
    columns: int,
    rows: int,
    first_cell: int,
) -> tuple[float, float, float]:
    """Distance (m) of the nearest wall, and the unit vector from it; ``outlook`` (m) and 0 if there is none as near.

    The walls are given as to :func:`limslam_env.kernels.first_wall`.
    """
    best, best_x, best_y, normal_x, normal_y = outlook * outlook, 0.0, 0.0, 0.0, 0.0
    first = max(math.floor((x - outlook - low_x) / side), 0)
    last = min(math.floor((x + outlook - low_x) / side), columns - 1)
    for row in range(
        max(math.floor((y - outlook - low_y) / side), 0),
        min(math.floor((y + outlook - low_y) / side), rows - 1) + 1,
    ):
        cell = first_cell + row * columns
        # Cells of a row lie side by side, and so do their walls.
        for item in range(cell_starts[cell + first], cell_starts[cell + last + 1]):
            edge = cell_edges[item]
            ax, ay = x - edges[edge, 0], y - edges[edge, 1]
            ex, ey = edges[edge, 2] - edges[edge, 0], edges[edge, 3] - edges[edge, 1]
            fraction = min(max((ax * ex + ay * ey) / (ex * ex + ey * ey), 0.0), 1.0)
            dx, dy = ax - fraction * ex, ay - fraction * ey
            squared = dx * dx + dy * dy
            if squared < best:
                best, best_x, best_y, normal_x, normal_y = squared, dx, dy, ey, -ex
    distance = math.sqrt(best)
    if distance >= outlook:
        return outlook, 0.0, 0.0
    if distance <= _TOUCH:
        # The centre is on the wall: either side is as good.
        best_x, best_y = normal_x, normal_y
    size = math.sqrt(best_x * best_x + best_y * best_y)
    return distance, best_x / size, best_y / size


@merged
def nearest_thing(
    robot: int,
    places: FloatArray,
    radius: float,
    outlook: float,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    low_x: float,
    low_y: float,
    side: float,
    columns: int,
    rows: int,
    first_cell: int,
) -> tuple[float, float, float, int]:
    """As :func:`nearest_wall`, for walls and other robots around one robot; and which robot it is, or -1."""
    x, y = places[robot, 0], places[robot, 1]
    distance, away_x, away_y = nearest_wall(
        x, y, outlook, edges, cell_starts, cell_edges, low_x, low_y, side, columns, rows, first_cell
    )
    which = -1
    for other in range(len(places)):
        dx, dy = x - places[other, 0], y - places[other, 1]
        between = math.hypot(dx, dy)
        if other != robot and between - radius < distance:
            distance, which = between - radius, other
            away_x, away_y = (dx / between, dy / between) if between > 0.0 else (1.0, 0.0)
    return distance, away_x, away_y, which


@compiled
def separate(
    places: FloatArray,
    before: FloatArray,
    radius: float,
    contact: BoolArray,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    low_x: float,
    low_y: float,
    side: float,
    columns: int,
    rows: int,
    first_cell: int,
) -> float:
    """Push robots at ``places`` (m, 2 or more) out of what they overlap, along the shortest way.

    As :class:`limslam_env.physics.Physics` does: a few times where walls meet; who is wedged all the same goes back
    to where it was ``before``. Sets ``contact`` (m,). Returns how far the robots can get before one may touch
    something, m.
    """
    gap = _OUTLOOK
    for robot in range(len(places)):
        distance, _, _, _ = nearest_thing(
            robot, places, radius, radius + _OUTLOOK,
            edges, cell_starts, cell_edges, low_x, low_y, side, columns, rows, first_cell,
        )  # fmt: skip
        gap = min(gap, distance - radius)
    if gap > _TOUCH:
        return gap - _TOUCH
    for _ in range(_MAX_PUSHES):
        is_pushed = False
        for robot in range(len(places)):
            distance, away_x, away_y, other = nearest_thing(
                robot, places, radius, radius + _TOUCH,
                edges, cell_starts, cell_edges, low_x, low_y, side, columns, rows, first_cell,
            )  # fmt: skip
            if distance >= radius + _TOUCH:
                continue
            contact[robot] = True
            depth = radius - distance
            if depth <= 0.0:
                continue
            share = depth if other < 0 else 0.5 * depth
            places[robot, 0] += away_x * share
            places[robot, 1] += away_y * share
            if other >= 0:
                places[other, 0] -= away_x * share
                places[other, 1] -= away_y * share
            is_pushed |= depth > _TOUCH
        if not is_pushed:
            return 0.0
    deep = np.zeros(len(places), dtype=np.bool_)
    for _ in range(len(places)):
        for robot in range(len(places)):
            distance, _, _, _ = nearest_thing(
                robot, places, radius, radius + _TOUCH,
                edges, cell_starts, cell_edges, low_x, low_y, side, columns, rows, first_cell,
            )  # fmt: skip
            deep[robot] = distance < radius - _DEEPEST
        for robot in range(len(places)):
            if deep[robot]:
                places[robot, 0], places[robot, 1] = before[robot, 0], before[robot, 1]
    return 0.0


@merged
def is_any_left(
    left: Words,
    env: int,
    tile_columns: int,
    tile_rows: int,
    low_x: float,
    low_y: float,
    high_x: float,
    high_y: float,
) -> bool:
    """Whether a cell that is left to see touches a rectangle, given in cells."""
    column0, column1 = max(math.floor(low_x), 0), min(math.floor(high_x), tile_columns * TILE - 1)
    row0, row1 = max(math.floor(low_y), 0), min(math.floor(high_y), tile_rows * TILE - 1)
    if column0 > column1 or row0 > row1:
        return False
    found = _NONE
    # Three by three tiles at a time and no branches: mostly that is all. What lies beyond the grid is masked.
    row = row0 & ~7
    while row <= row1:
        rows = _stretch(row0 - row, row1 - row)
        column = column0 & ~7
        while column <= column1:
            columns = _stretch(column0 - column, column1 - column)
            tile = (row >> 3) * tile_columns + (column >> 3)
            left_columns = (columns & _BYTE) * _EACH_ROW
            middle_columns = ((columns >> _EIGHT) & _BYTE) * _EACH_ROW
            right_columns = ((columns >> _SIXTEEN) & _BYTE) * _EACH_ROW
            for line in range(3):
                mask = _ROW_MASKS[(rows >> np.uint64(8 * line)) & _BYTE]
                words = (left[env, tile] & left_columns) | (left[env, tile + 1] & middle_columns)
                found |= mask & (words | (left[env, tile + 2] & right_columns))
                tile += tile_columns
            column += 3 * TILE
        row += 3 * TILE
    return bool(found != _NONE)


@inlined
def _stretch(low: int, high: int) -> np.uint64:
    """Bits ``low`` to ``high`` of the first 24."""
    return (_FULL >> np.uint64(23 - min(high, 23))) & (_FULL << np.uint64(max(low, 0)))


@inlined
def take(left: Words, env: int, tile_columns: int, column: int, row: int) -> int:
    """Take a cell out of those that are left to see: 1 if it was there."""
    tile = (row >> 3) * tile_columns + (column >> 3)
    bit = _ONE << np.uint64((row & 7) * 8 + (column & 7))
    word = left[env, tile]
    new = 1 if word & bit else 0
    left[env, tile] = word & ~bit
    return new


@merged
def take_ray(
    left: Words,
    env: int,
    tile_columns: int,
    tile_rows: int,
    x: float,
    y: float,
    dx: float,
    dy: float,
    end: float,
) -> int:
    """Take every cell that a ray crosses out of those that are left, as :func:`limslam_env.kernels.mark_ray` does.

    In cells, and for rays within the grid.
    """
    far_x, far_y = x + dx * end, y + dy * end
    low_x, low_y, high_x, high_y = min(x, far_x), min(y, far_y), max(x, far_x), max(y, far_y)
    if not is_any_left(left, env, tile_columns, tile_rows, low_x, low_y, high_x, high_y):
        return 0
    columns, rows = tile_columns * TILE, tile_rows * TILE
    column, column_step, next_column, per_column = crossings(x, dx, 1.0)
    row, row_step, next_row, per_row = crossings(y, dy, 1.0)
    travelled, new = 0.0, 0
    while travelled <= end:
        if 0 <= row < rows and 0 <= column < columns:
            new += take(left, env, tile_columns, column, row)
        # Which way is a toss-up: numbers are chosen, where a branch would be mispredicted.
        is_column = next_column < next_row
        travelled = next_column if is_column else next_row
        column += column_step if is_column else 0
        row += 0 if is_column else row_step
        next_column = next_column + per_column if is_column else next_column
        next_row = next_row if is_column else next_row + per_row
    return new


@merged
def take_disc(left: Words, env: int, tile_columns: int, tile_rows: int, x: float, y: float, radius: float) -> int:
    """Take every cell that a body touches out of those that are left, as :func:`limslam_env.kernels.mark_disc` does.

    In cells.
    """
    if not is_any_left(left, env, tile_columns, tile_rows, x - radius, y - radius, x + radius, y + radius):
        return 0
    columns, rows = tile_columns * TILE, tile_rows * TILE
    new = 0
    for row in range(max(math.floor(y - radius), 0), min(math.floor(y + radius), rows - 1) + 1):
        for column in range(max(math.floor(x - radius), 0), min(math.floor(x + radius), columns - 1) + 1):
            if is_touched(column, row, x, y, radius):
                new += take(left, env, tile_columns, column, row)
    return new


@inlined
def lanes_of(count: int) -> int:
    """Places for so many beams when four are worked on at once."""
    return (count + 3) // 4 * 4


@merged
def aim(beams: FloatArray, body_x: float, body_y: float, cos: float, sin: float, aims: FloatArray) -> None:
    """Set ``aims`` (4, lanes) to where the rays of a robot start, x and y (m), and to their directions."""
    # The rim may touch a wall, and a ray from there start behind it: rays start inside the body.
    for number in range(len(beams)):
        dx, dy = turned(beams[number, 7], beams[number, 8], cos, sin)
        rim_x, rim_y = turned(beams[number, 0], beams[number, 1], cos, sin)
        aims[0, number] = body_x + rim_x - beams[number, 3] * dx
        aims[1, number] = body_y + rim_y - beams[number, 3] * dy
        aims[2, number], aims[3, number] = dx, dy


@merged
def cast_fan(
    cell: int,
    beams: FloatArray,
    aims: FloatArray,
    edges: FloatArray,
    near_starts: IntArray,
    near_edges: IntArray,
    rays: FloatArray,
) -> None:
    """Set ``rays`` (2, lanes) to how far a robot's rays get, m, and to the wall that they hit, or -1."""
    for number in range(len(beams)):
        rays[0, number], rays[1, number] = beams[number, 5] + beams[number, 3], -1.0
    for item in range(near_starts[cell], near_starts[cell + 1]):
        edge = near_edges[item]
        ex, ey = edges[edge, 2] - edges[edge, 0], edges[edge, 3] - edges[edge, 1]
        from_x, from_y, which = edges[edge, 0], edges[edge, 1], float(edge)
        # No branches: the compiler takes several rays at once.
        for lane in range(rays.shape[1]):
            distance, is_met = meeting(
                from_x - aims[0, lane], from_y - aims[1, lane], ex, ey, aims[2, lane], aims[3, lane]
            )
            is_met &= distance < rays[0, lane]
            rays[0, lane] = distance if is_met else rays[0, lane]
            rays[1, lane] = which if is_met else rays[1, lane]


@compiled
def advance(  # noqa: PLR0915 (one loop: what is handed to a function costs as much as a ray)
    first: int,
    last: int,
    tasks: IntArray,
    actions: FloatArray,
    farthest: float,
    radius: float,
    beams: FloatArray,
    world_of: IntArray,
    layout: IntArray,
    grids: FloatArray,
    areas: FloatArray,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    near_starts: IntArray,
    near_edges: IntArray,
    coverable: Words,
    noise: FloatArray,
    keys: Words,
    steps: IntArray,
    rooms: FloatArray,
    poses: FloatArray,
    untold: FloatArray,
    left: Words,
    hits: IntArray,
    ranges: ReadingArray,
    wheels: ReadingArray,
    contact: BoolArray,
    new_cells: IntArray,
) -> None:
    """Drive, and take all measurements of, environments ``first`` to ``last`` - 1.

    Parameters
    ----------
    tasks
        (n,): ``SKIP``, ``STEP`` or ``BEGIN`` of each.
    actions
        (n, m, 2), left and right wheel speed of each robot, -1 to 1; the rest is clipped.
    farthest, radius
        Wheel travel at full speed, and of the bodies, m.
    beams
        As :func:`limslam_env.kernels.observe` takes them.
    world_of
        (n,), the world of each.
    layout
        (w, 7): a world's first edge and cell in the lists, the cells' columns and rows, its tiles' columns and
        rows, and its first cell in the lists of near walls, or -1.
    grids, areas
        (w, 3), lower left corner x, y and cell side of the cell lists and of the coverage grids, m.
    edges, cell_starts, cell_edges
        The walls of all worlds, one after the other.
    near_starts, near_edges
        The walls that are within the beams' reach of each cell, in worlds where these are few.
    coverable
        (w, t), the tiles of each world.
    noise
        (n, 14): that of :func:`limslam_env.kernels.observe`, rate and share of slips, and the axle, m.
    keys, steps, rooms, poses, untold, left, hits, ranges
        What is kept from step to step: (n,) key of the episode's random numbers, number of steps, room to drive in
        (m); (n, m, 3) poses; (n, m, 2) travel that encoders have not told (m); (n, t) tiles left to see; and
        (n, m, n_beams) walls hit and readings, m.
    wheels, contact, new_cells
        Set: (n, m, 2), what encoders say, m; (n, m), who touched something; and (n, m), cells seen first.
    """
    # Numbers are taken out of the arrays one by one: a slice costs as much as a ray.
    num_robots, num_beams = poses.shape[1], len(beams)
    aims, rays = np.zeros((4, lanes_of(num_beams))), np.zeros((2, lanes_of(num_beams)))
    travel, carried, before = np.zeros((num_robots, 2)), np.zeros((num_robots, 2)), np.zeros((num_robots, 2))
    for env in range(first, last):
        task = tasks[env]
        if task == SKIP:
            continue
        world = world_of[env]
        first_edge, first_cell = layout[world, 0], layout[world, 1]
        columns, rows, tile_columns, tile_rows = (
            layout[world, 2], layout[world, 3], layout[world, 4], layout[world, 5],
        )  # fmt: skip
        near_cell = layout[world, 6]
        low_x, low_y, side = grids[world, 0], grids[world, 1], grids[world, 2]
        area_x, area_y, cell = areas[world, 0], areas[world, 1], areas[world, 2]
        steps[env] = steps[env] + 1 if task == STEP else 0
        step = steps[env]
        state = keys[env] + (np.uint64(step) << np.uint64(24)) * _GOLDEN
        if task == BEGIN:
            rooms[env] = 0.0
            for tile in range(coverable.shape[1]):
                left[env, tile] = coverable[world, tile]
        way = 0.0
        for robot in range(num_robots):
            contact[env, robot] = False
            for wheel in range(2):
                if task == BEGIN:
                    travel[robot, wheel] = untold[env, robot, wheel] = 0.0
                    continue
                turn = min(max(actions[env, robot, wheel], -1.0), 1.0) * farthest
                travel[robot, wheel] = carried[robot, wheel] = turn
                if noise[env, 11] > 0.0:
                    uniform = unit(mixed(state + np.uint64((robot << 20) + 2 * wheel + 1) * _GOLDEN))
                    if uniform < -math.expm1(-noise[env, 11] * abs(turn)):
                        carried[robot, wheel] = turn * (1.0 - noise[env, 12])
            way = max(way, 0.5 * abs(carried[robot, 0] + carried[robot, 1]))
        if task == STEP:
            # A move of more than the radius could end beyond a wall; an arc in pieces is the same arc.
            parts = 1 if way <= _LONGEST_MOVE * radius else math.ceil(way / (_LONGEST_MOVE * radius))
            for _ in range(parts):
                for robot in range(num_robots):
                    before[robot, 0], before[robot, 1] = poses[env, robot, 0], poses[env, robot, 1]
                    poses[env, robot, 0], poses[env, robot, 1], poses[env, robot, 2] = arc_end(
                        before[robot, 0], before[robot, 1], poses[env, robot, 2],
                        carried[robot, 0] / parts, carried[robot, 1] / parts, noise[env, 13],
                    )  # fmt: skip
                # Others may come one's way.
                rooms[env] -= (1.0 if num_robots == 1 else 2.0) * way / parts
                if rooms[env] <= 0.0:
                    rooms[env] = separate(
                        poses[env], before, radius, contact[env],
                        edges, cell_starts, cell_edges, low_x, low_y, side, columns, rows, first_cell,
                    )  # fmt: skip
        for robot in range(num_robots):
            own = state + np.uint64(robot << 20) * _GOLDEN
            body_x, body_y, heading = poses[env, robot, 0], poses[env, robot, 1], poses[env, robot, 2]
            cos, sin = math.cos(heading), math.sin(heading)
            new = take_disc(
                left, env, tile_columns, tile_rows,
                (body_x - area_x) / cell, (body_y - area_y) / cell, (radius - BODY_MARGIN) / cell,
            )  # fmt: skip
            aim(beams, body_x, body_y, cos, sin, aims)
            if near_cell >= 0:
                column = min(max(math.floor((body_x - low_x) / side), 0), columns - 1)
                row = min(max(math.floor((body_y - low_y) / side), 0), rows - 1)
                cast_fan(near_cell + row * columns + column, beams, aims, edges, near_starts, near_edges, rays)
            for number in range(num_beams):
                if beams[number, 6] != 1.0 and step % int(beams[number, 6]) != 0:
                    continue
                offset, longest = beams[number, 3], beams[number, 5]
                x, y, dx, dy = aims[0, number], aims[1, number], aims[2, number], aims[3, number]
                distance, hit = rays[0, number], int(rays[1, number])
                if near_cell < 0:
                    distance, hit = first_wall(
                        x, y, dx, dy, longest + offset,
                        edges, cell_starts, cell_edges, low_x, low_y, side, columns, rows, first_cell,
                    )  # fmt: skip
                if num_robots > 1:
                    disc = cast_at_discs(x, y, dx, dy, distance, robot, poses[env], radius)
                    if disc < distance:
                        distance, hit = disc, ROBOT
                new += take_ray(
                    left, env, tile_columns, tile_rows,
                    (x - area_x) / cell, (y - area_y) / cell, dx, dy, distance / cell - RAY_MARGIN,
                )  # fmt: skip
                if noise[env, 5] > 0.0:
                    angle, reach = heading + beams[number, 2], longest + offset
                    rim_x, rim_y = x + offset * dx, y + offset * dy
                    for share in CONE:
                        dx, dy = math.cos(angle + share * noise[env, 5]), math.sin(angle + share * noise[env, 5])
                        x, y = rim_x - offset * dx, rim_y - offset * dy
                        aside, other = first_wall(
                            x, y, dx, dy, reach,
                            edges, cell_starts, cell_edges, low_x, low_y, side, columns, rows, first_cell,
                        )  # fmt: skip
                        if num_robots > 1:
                            disc = cast_at_discs(x, y, dx, dy, aside, robot, poses[env], radius)
                            if disc < aside:
                                aside, other = disc, ROBOT
                        if aside < distance:
                            distance, hit = aside, other
                place = np.uint64(2 * number + 4)
                random, uniform = 0.0, 1.0
                if noise[env, 0] > 0.0 or noise[env, 1] > 0.0:
                    random = normal(mixed(own + place * _GOLDEN))
                if noise[env, 2] > 0.0:
                    uniform = unit(mixed(own + (place + _ONE) * _GOLDEN))
                hits[env, robot, number] = hit - first_edge if hit >= 0 else hit
                ranges[env, robot, number] = noisy_reading(
                    distance - offset, hit, beams[number, 4], longest,
                    noise[env, 0], noise[env, 1], noise[env, 2], noise[env, 3], noise[env, 4], random, uniform,
                )  # fmt: skip
            new_cells[env, robot] = new
            for wheel in range(2):
                random = 0.0
                if travel[robot, wheel] != 0.0 and noise[env, 8] > 0.0:
                    random = normal(mixed(own + np.uint64(2 * wheel) * _GOLDEN))
                wheels[env, robot, wheel], untold[env, robot, wheel] = reported_travel(
                    travel[robot, wheel], untold[env, robot, wheel],
                    noise[env, 6 + wheel], noise[env, 8], noise[env, 9], noise[env, 10], random,
                )  # fmt: skip
