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
    ROBOT,
    cast_at_discs,
    cast_ray,
    compiled,
    crossings,
    inlined,
    noisy_reading,
    reported_travel,
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

_BODY_MARGIN = 1e-3
_CONE = (-1.0, -0.5, 0.5, 1.0)

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_S27, _S30, _S31, _S11 = np.uint64(27), np.uint64(30), np.uint64(31), np.uint64(11)
_ONE, _SEVEN, _EIGHT, _LAYER = np.uint64(1), np.uint64(7), np.uint64(8), np.uint64(127)
_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)
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
    return float(bits >> _S11) * _UNIT


@compiled
def normal(bits: np.uint64) -> float:
    """A number from N(0, 1) of random bits, exactly.

    The ziggurat of 128 layers, after Doornik, "An improved ziggurat method to generate normal random samples" (2005).
    Further bits, which one number in eighty needs, are mixed from the first.
    """
    while True:
        layer = bits & _LAYER
        share = 2.0 * (float(bits >> _S11) * _UNIT) - 1.0
        if abs(share) < _RATIOS[layer]:
            return share * _EDGES[layer]
        bits = mixed(bits + _GOLDEN)
        if layer == 0:
            while True:
                beyond = -math.log(1.0 - unit(bits)) / _TAIL
                bits = mixed(bits + _GOLDEN)
                height = -math.log(1.0 - unit(bits))
                bits = mixed(bits + _GOLDEN)
                if 2.0 * height > beyond * beyond:
                    return math.copysign(_TAIL + beyond, share)
        place = share * _EDGES[layer]
        outer = math.exp(-0.5 * (_EDGES[layer] * _EDGES[layer] - place * place))
        inner = math.exp(-0.5 * (_EDGES[layer + _ONE] * _EDGES[layer + _ONE] - place * place))
        if inner + unit(bits) * (outer - inner) < 1.0:
            return place
        bits = mixed(bits + _GOLDEN)


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


@compiled
def nearest_wall(
    x: float, y: float, outlook: float, edges: FloatArray, cell_starts: IntArray, cell_edges: IntArray, grid: FloatArray
) -> tuple[float, float, float]:
    """Distance (m) of the nearest wall, and the unit vector from it; ``outlook`` (m) and 0 if there is none as near."""
    side, columns, rows = grid[2], int(grid[3]), int(grid[4])
    best, best_x, best_y, normal_x, normal_y = outlook * outlook, 0.0, 0.0, 0.0, 0.0
    first = max(math.floor((x - outlook - grid[0]) / side), 0)
    last = min(math.floor((x + outlook - grid[0]) / side), columns - 1)
    for row in range(
        max(math.floor((y - outlook - grid[1]) / side), 0),
        min(math.floor((y + outlook - grid[1]) / side), rows - 1) + 1,
    ):
        for item in range(cell_starts[row * columns + first], cell_starts[row * columns + last + 1]):
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
    size = math.hypot(best_x, best_y)
    return distance, best_x / size, best_y / size


@compiled
def nearest_thing(
    robot: int,
    places: FloatArray,
    radius: float,
    outlook: float,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    grid: FloatArray,
) -> tuple[float, float, float, int]:
    """As :func:`nearest_wall`, for walls and other robots around one robot; and which robot it is, or -1."""
    x, y = places[robot, 0], places[robot, 1]
    distance, away_x, away_y = nearest_wall(x, y, outlook, edges, cell_starts, cell_edges, grid)
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
    grid: FloatArray,
) -> None:
    """Push robots at ``places`` (m, 2 or more) out of what they overlap, along the shortest way.

    As :class:`limslam_env.physics.Physics` does: a few times where walls meet; who is wedged all the same goes back
    to where it was ``before``. Sets ``contact`` (m,).
    """
    for _ in range(_MAX_PUSHES):
        is_pushed = False
        for robot in range(len(places)):
            distance, away_x, away_y, other = nearest_thing(
                robot, places, radius, radius + _TOUCH, edges, cell_starts, cell_edges, grid
            )
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
            return
    for _ in range(len(places)):
        deep = np.zeros(len(places), dtype=np.bool_)
        for robot in range(len(places)):
            distance, _, _, _ = nearest_thing(
                robot, places, radius, radius + _TOUCH, edges, cell_starts, cell_edges, grid
            )
            deep[robot] = distance < radius - _DEEPEST
        for robot in range(len(places)):
            if deep[robot]:
                places[robot, 0], places[robot, 1] = before[robot, 0], before[robot, 1]


@compiled
def carry(
    poses: FloatArray,
    turned: FloatArray,
    before: FloatArray,
    axle: float,
    radius: float,
    room: float,
    contact: BoolArray,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    grid: FloatArray,
) -> float:
    """Carry robots at ``poses`` (m, 3), m and rad, along the arcs of wheel travel ``turned`` (m, 2), m.

    ``room`` (m) is how far they can get before one of them may touch something; what is left of it is returned.
    ``before`` (m, 3) is scratch; sets ``contact`` (m,).
    """
    farthest = 0.0
    for robot in range(len(poses)):
        contact[robot] = False
        farthest = max(farthest, 0.5 * abs(turned[robot, 0] + turned[robot, 1]))
    # A move of more than the radius could end beyond a wall; an arc in pieces is the same arc.
    parts = max(math.ceil(farthest / (_LONGEST_MOVE * radius)), 1)
    for _ in range(parts):
        for robot in range(len(poses)):
            x, y, heading = poses[robot, 0], poses[robot, 1], poses[robot, 2]
            before[robot, 0], before[robot, 1] = x, y
            poses[robot, 0], poses[robot, 1], poses[robot, 2] = arc_end(
                x, y, heading, turned[robot, 0] / parts, turned[robot, 1] / parts, axle
            )
        # Others may come one's way.
        room -= (1.0 if len(poses) == 1 else 2.0) * farthest / parts
        if room <= 0.0:
            gap = _OUTLOOK
            for robot in range(len(poses)):
                distance, _, _, _ = nearest_thing(
                    robot, poses, radius, radius + _OUTLOOK, edges, cell_starts, cell_edges, grid
                )
                gap = min(gap, distance - radius)
            room = gap - _TOUCH
            if room <= 0.0:
                room = 0.0
                separate(poses, before, radius, contact, edges, cell_starts, cell_edges, grid)
    return room


@inlined
def is_any_left(
    left: Words, tile_columns: int, tile_rows: int, low_x: float, low_y: float, high_x: float, high_y: float
) -> bool:
    """Whether a cell that is left to see touches a rectangle, given in cells."""
    column0, column1 = max(math.floor(low_x), 0), min(math.floor(high_x), tile_columns * TILE - 1)
    row0, row1 = max(math.floor(low_y), 0), min(math.floor(high_y), tile_rows * TILE - 1)
    found = False
    for tile_row in range(row0 >> 3, (row1 >> 3) + 1):
        low, high = max(row0 - tile_row * TILE, 0), min(row1 - tile_row * TILE, 7)
        rows = (_ALL << np.uint64(low * 8)) & (_ALL >> np.uint64((7 - high) * 8))
        for tile in range(tile_row * tile_columns + (column0 >> 3), tile_row * tile_columns + (column1 >> 3) + 1):
            found |= (left[tile] & rows) != 0
    return found


@inlined
def take(left: Words, tile_columns: int, column: int, row: int) -> int:
    """Take a cell out of those that are left to see: 1 if it was there."""
    tile = (row >> 3) * tile_columns + (column >> 3)
    bit = _ONE << np.uint64((row & 7) * 8 + (column & 7))
    word = left[tile]
    if word & bit:
        left[tile] = word ^ bit
        return 1
    return 0


@compiled
def take_ray(
    left: Words,
    tile_columns: int,
    tile_rows: int,
    area: FloatArray,
    x: float,
    y: float,
    dx: float,
    dy: float,
    reach: float,
) -> int:
    """Take every cell that a ray crosses out of those that are left: :func:`limslam_env.kernels.mark_ray`, on tiles."""
    cell = area[2]
    x, y = (x - area[0]) / cell, (y - area[1]) / cell
    end = reach / cell - 1e-6
    far_x, far_y = x + dx * end, y + dy * end
    if not is_any_left(left, tile_columns, tile_rows, min(x, far_x), min(y, far_y), max(x, far_x), max(y, far_y)):
        return 0
    columns, rows = tile_columns * TILE, tile_rows * TILE
    column, column_step, next_column, per_column = crossings(x, dx, 1.0)
    row, row_step, next_row, per_row = crossings(y, dy, 1.0)
    travelled, new = 0.0, 0
    while travelled <= end:
        if 0 <= row < rows and 0 <= column < columns:
            new += take(left, tile_columns, column, row)
        if next_column < next_row:
            travelled = next_column
            next_column += per_column
            column += column_step
        else:
            travelled = next_row
            next_row += per_row
            row += row_step
    return new


@compiled
def take_disc(
    left: Words, tile_columns: int, tile_rows: int, area: FloatArray, x: float, y: float, radius: float
) -> int:
    """Take every cell that a body touches out of those that are left: :func:`limslam_env.kernels.mark_disc`."""
    cell = area[2]
    x, y, radius = (x - area[0]) / cell, (y - area[1]) / cell, (radius - _BODY_MARGIN) / cell
    if not is_any_left(left, tile_columns, tile_rows, x - radius, y - radius, x + radius, y + radius):
        return 0
    columns, rows = tile_columns * TILE, tile_rows * TILE
    new = 0
    for row in range(max(math.floor(y - radius), 0), min(math.floor(y + radius), rows - 1) + 1):
        for column in range(max(math.floor(x - radius), 0), min(math.floor(x + radius), columns - 1) + 1):
            aside = x - min(max(x, column), column + 1.0)
            above = y - min(max(y, row), row + 1.0)
            if aside * aside + above * above < radius * radius:
                new += take(left, tile_columns, column, row)
    return new


@compiled
def look(
    robot: int,
    poses: FloatArray,
    radius: float,
    step: int,
    state: np.uint64,
    beams: FloatArray,
    noise: FloatArray,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    grid: FloatArray,
    left: Words,
    tile_columns: int,
    tile_rows: int,
    area: FloatArray,
    hits: IntArray,
    ranges: ReadingArray,
) -> int:
    """Take one robot's ranges; how many cells it is the first to see.

    ``beams`` (n_beams, 9) are those of :func:`limslam_env.kernels.observe` and their directions' x and y.
    """
    body_x, body_y, heading = poses[robot, 0], poses[robot, 1], poses[robot, 2]
    cos, sin = math.cos(heading), math.sin(heading)
    new = take_disc(left, tile_columns, tile_rows, area, body_x, body_y, radius)
    is_noisy = noise[0] > 0.0 or noise[1] > 0.0
    for number in range(len(beams)):
        if beams[number, 6] != 1.0 and step % int(beams[number, 6]) != 0:
            continue
        offset, longest = beams[number, 3], beams[number, 5]
        rim_x = body_x + cos * beams[number, 0] - sin * beams[number, 1]
        rim_y = body_y + sin * beams[number, 0] + cos * beams[number, 1]
        dx = cos * beams[number, 7] - sin * beams[number, 8]
        dy = sin * beams[number, 7] + cos * beams[number, 8]
        x, y, reach = rim_x - offset * dx, rim_y - offset * dy, longest + offset
        distance, hit = cast_ray(x, y, dx, dy, reach, edges, cell_starts, cell_edges, grid)
        if len(poses) > 1:
            disc = cast_at_discs(x, y, dx, dy, distance, robot, poses, radius)
            if disc < distance:
                distance, hit = disc, ROBOT
        new += take_ray(left, tile_columns, tile_rows, area, x, y, dx, dy, distance)
        if noise[5] > 0.0:
            angle = heading + beams[number, 2]
            for share in _CONE:
                dx, dy = math.cos(angle + share * noise[5]), math.sin(angle + share * noise[5])
                x, y = rim_x - offset * dx, rim_y - offset * dy
                aside, other = cast_ray(x, y, dx, dy, reach, edges, cell_starts, cell_edges, grid)
                if len(poses) > 1:
                    disc = cast_at_discs(x, y, dx, dy, aside, robot, poses, radius)
                    if disc < aside:
                        aside, other = disc, ROBOT
                if aside < distance:
                    distance, hit = aside, other
        first = np.uint64(2 * number + 4)
        random = normal(mixed(state + first * _GOLDEN)) if is_noisy else 0.0
        uniform = unit(mixed(state + (first + _ONE) * _GOLDEN)) if noise[2] > 0.0 else 1.0
        hits[robot, number] = hit
        ranges[robot, number] = noisy_reading(distance - offset, hit, beams[number, 4], longest, noise, random, uniform)
    return new


@compiled
def advance(
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
        As :func:`look` takes them.
    world_of
        (n,), the world of each.
    layout
        (w, 5), a world's first edge, cell and item in the lists and its tiles' columns and rows.
    grids, areas
        (w, 5) and (w, 3), of the cell lists and of the coverage grids.
    edges, cell_starts, cell_edges
        The walls of all worlds, each with its own numbers.
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
    num_robots = poses.shape[1]
    turned, before = np.empty((num_robots, 2)), np.empty((num_robots, 3))
    travel = np.empty((num_robots, 2))
    for env in range(first, last):
        task = tasks[env]
        if task == SKIP:
            continue
        world = world_of[env]
        its_edges, its_cells = edges[layout[world, 0] :], cell_starts[layout[world, 1] :]
        its_items, grid, area = cell_edges[layout[world, 2] :], grids[world], areas[world]
        tile_columns, tile_rows = layout[world, 3], layout[world, 4]
        its_poses, its_noise, its_left = poses[env], noise[env], left[env]
        if task == BEGIN:
            steps[env], rooms[env] = 0, 0.0
            its_left[:] = coverable[world]
            untold[env] = 0.0
            travel[:] = 0.0
            contact[env] = False
        else:
            steps[env] += 1
        step = steps[env]
        state = keys[env] + (np.uint64(step) << np.uint64(24)) * _GOLDEN
        if task == STEP:
            for robot in range(num_robots):
                for side in range(2):
                    way = min(max(actions[env, robot, side], -1.0), 1.0) * farthest
                    travel[robot, side] = way
                    if its_noise[11] > 0.0:
                        number = np.uint64((robot << 20) + 2 * side + 1)
                        if unit(mixed(state + number * _GOLDEN)) < -math.expm1(-its_noise[11] * abs(way)):
                            way *= 1.0 - its_noise[12]
                    turned[robot, side] = way
            rooms[env] = carry(
                its_poses, turned, before, its_noise[13], radius, rooms[env], contact[env],
                its_edges, its_cells, its_items, grid,
            )  # fmt: skip
        for robot in range(num_robots):
            own = state + np.uint64(robot << 20) * _GOLDEN
            new_cells[env, robot] = look(
                robot, its_poses, radius, step, own, beams, its_noise, its_edges, its_cells, its_items, grid,
                its_left, tile_columns, tile_rows, area, hits[env], ranges[env],
            )  # fmt: skip
            for side in range(2):
                random = normal(mixed(own + np.uint64(2 * side) * _GOLDEN)) if travel[robot, side] != 0.0 else 0.0
                wheels[env, robot, side], untold[env, robot, side] = reported_travel(
                    travel[robot, side], untold[env, robot, side],
                    its_noise[6 + side], its_noise[8], its_noise[9], its_noise[10], random,
                )  # fmt: skip
