"""How well the readings of a drive fit a map from many poses: the evidence of each reading, and the
search for poses.

The rays of a drive are the beams with their readings, in the frame of the drive. A pose of this
frame in a map places all of them.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from limslam_agent.kernels.algebra import factorise, solve_factored, wrapped
from limslam_agent.kernels.beams import Ray, end_of_ray, line_in, meeting, passes, read_share
from limslam_agent.kernels.compilation import compiled, lean_entry
from limslam_agent.kernels.readings import normal_density
from limslam_agent.kernels.tables import (
    GRAZING,
    NOTHING,
    RAY_LENGTH,
    RAY_REACH,
    RAY_TO_X,
    RAY_TO_Y,
    RAY_X,
    RAY_Y,
    THROUGH_SIGMAS,
    UNRELATED,
)
from limslam_env.geometry import BoolArray, FloatArray, IntArray

# m: walls may be so much longer, or shorter, than they were drawn
_OVER = 0.05
_INSET = 0.08
_STEEPEST = 0.25  # least cosine by which the spread of a distance to a wall is divided
# m: a reading that differs by less than this and three standard deviations contradicts nothing
_BESIDE = 0.15
_ROUGH = 0.08  # m: standard deviation of the place of a wall that is known by occupied cells only
_UNSEEN = 0.2  # m: a wall may lie so far beyond the first cell that is not free
# of refinements: distances from walls, m, first and last
_ROUNDS = 8
_FAR = 0.30
_NEAR = 0.12
_DAMPING = 1.0  # of a round of a refinement, in rays
_LENGTH = 5  # column of a table of walls, after the fields of a ``Line``


class Known(NamedTuple):
    """What readings are compared with.

    Attributes
    ----------
    walls
        Rows (k, 6) of the lines of walls about their first ends, and their lengths, m.
    values, low, cell
        Values (rows, columns) of cells, positive if free, the lower left corner (2,) of the first
        one, and the length of a side, m.
    variance, turning
        Variance of the distance to a wall, m^2, and how it grows with the squared distance, rad^2.
    cone
        Half the opening angle of the beams, rad.
    """

    walls: FloatArray
    values: NDArray[np.int16]
    low: FloatArray
    cell: float
    variance: float
    turning: float
    cone: float


@compiled
def spread(known: Known, distance: float) -> float:
    """Standard deviation of a wall at a distance, both m."""
    return math.sqrt(known.variance + known.turning * distance**2)


@compiled
def wall_evidence(length: float, reach: float, wall: float, std: float) -> float:
    """The evidence of a reading for a wall at a distance (m), against a random place."""
    if length >= reach:
        beyond = 0.5 * math.erfc((reach - wall) / (std * math.sqrt(2.0)))
        return math.log(((1.0 - UNRELATED) * beyond + UNRELATED * NOTHING) / NOTHING)
    density = normal_density(length - wall, std)
    return math.log((1.0 - UNRELATED) * density * reach / (1.0 - NOTHING) + UNRELATED)


@compiled
def cell_value(known: Known, x: float, y: float) -> int:
    """The value of the cell of a point, m; 0 outside of the grid, as of an unknown one."""
    row = math.floor((y - known.low[1]) / known.cell)
    column = math.floor((x - known.low[0]) / known.cell)
    if 0 <= row < known.values.shape[0] and 0 <= column < known.values.shape[1]:
        return int(known.values[row, column])
    return 0


@compiled
def free_length(ray: Ray, longest: float, known: Known) -> tuple[float, int]:
    """How far along a ray all cells are free, up to a longest distance, m, and the value of the
    cell that ends it.

    The value is that of a free cell if none ends it.
    """
    for step in range(math.ceil(2.0 * longest / known.cell)):
        along = 0.5 * step * known.cell
        value = cell_value(known, ray.x + along * ray.to_x, ray.y + along * ray.to_y)
        if value <= 0:
            return along, value
    return longest, 1


@compiled
def is_inside(x: float, y: float, known: Known, around: int) -> bool:
    """Whether a point (m) lies in a free cell, and all cells up to a number of cells around it are
    free.
    """
    for down in range(-around, around + 1):
        for right in range(-around, around + 1):
            if cell_value(known, x + right * known.cell, y + down * known.cell) <= 0:
                return False
    return True


@compiled
def explain(
    length: float,
    reach: float,
    wall: tuple[float, float, float],
    free: float,
    ends_at: int,
    known: Known,
) -> tuple[float, float, bool]:
    """The evidence of a reading for a map against a random place, where it contradicts the map, and
    whether it might.

    The second number is the distance at which it contradicts the map, m: at a wall that it has
    passed, or where it ended in free ground. It is 0 if it contradicts nothing. The first wall is
    that of :func:`first_wall`; cells are ``free`` so far, m, and then have the value ``ends_at``.
    """
    distance, cosine, _ = wall
    if distance < reach and distance <= free + _UNSEEN:
        steep = max(cosine, _STEEPEST)
        across = spread(known, distance)
        std = across / steep
        is_short = length < min(distance, free) - _BESIDE - THROUGH_SIGMAS * std
        is_through = passes(distance, steep, length - _BESIDE, THROUGH_SIGMAS * across)
        against = length if is_short else distance if is_through else 0.0
        return wall_evidence(length, reach, distance, std), against, True
    if free >= reach - 0.05:
        is_empty = length > reach - 0.1
        likelihood = (1.0 - UNRELATED) / NOTHING if is_empty else UNRELATED
        return math.log(likelihood), 0.0 if is_empty else length, True
    if free <= 0.0:
        return 0.0, 0.0, False
    if length < free - _BESIDE - THROUGH_SIGMAS * spread(known, free):
        return math.log(UNRELATED), length, True
    # Beyond known ground, a reading is no surprise at a random place either: it mostly goes on
    # along what the beam saw before, and not each of many such readings is news.
    if ends_at < 0:
        # Beams ended in this cell, but no wall was drawn.
        either = 0.5 * math.exp(wall_evidence(length, reach, free, _ROUGH)) + 0.5
        return math.log(either), 0.0, False
    return 0.0, 0.0, False


@compiled
def first_wall(ray: Ray, known: Known, beyond: float) -> tuple[float, float, float]:
    """The distance at which a beam first reads a wall that it meets at most so far beyond its ends,
    both m, the cosine between the beam and the wall's normal, and how far beyond the ends that is.

    The distance is infinite without a wall.
    """
    nearest = math.inf
    steepness = 1.0
    farthest = -math.inf
    for number in range(len(known.walls)):
        distance, along, cosine = meeting(ray, line_in(known.walls, number))
        outside = max(-along, along - known.walls[number, _LENGTH])
        if distance < 0.0 or outside >= beyond or abs(cosine) <= GRAZING:
            continue
        distance *= read_share(cosine, known.cone)
        if distance < nearest:
            nearest = distance
            steepness = abs(cosine)
            farthest = outside
    return nearest, steepness, farthest


@compiled
def weigh_ray(ray: Ray, length: float, reach: float, known: Known) -> tuple[float, float, bool]:
    """The evidence of a reading for a map, at what distance it contradicts the map, m, and whether
    it might do so.

    The distance is 0 if it does not.
    """
    longer = first_wall(ray, known, _OVER)
    shorter = longer if longer[2] < -_INSET else first_wall(ray, known, -_INSET)
    free, ends_at = free_length(ray, reach, known)
    evidence, against, is_tested = explain(length, reach, longer, free, ends_at, known)
    if shorter[0] != longer[0]:
        other, against_other, _ = explain(length, reach, shorter, free, ends_at, known)
        evidence = max(evidence, other)
        against = against if against_other > 0.0 else 0.0
    if against > 0.0 and length < min(reach, shorter[0] - _BESIDE):
        # It ended before the wall, if there is one. A wall that was not drawn yet may be near, or
        # beside a wide beam.
        around = 1 + int(length * math.sin(known.cone) / known.cell)
        x, y = end_of_ray(ray, length)
        if not is_inside(x, y, known, around):
            evidence = max(evidence, 0.0)
            against = 0.0
    return evidence, against, is_tested


@compiled
def placed_ray(pose: FloatArray, turn: tuple[float, float], rays: FloatArray, number: int) -> Ray:
    """A ray of a table, moved by a pose (3,) with this cosine and sine of its heading."""
    cos, sin = turn
    x = rays[number, RAY_X]
    y = rays[number, RAY_Y]
    ux = rays[number, RAY_TO_X]
    uy = rays[number, RAY_TO_Y]
    return Ray(
        pose[0] + cos * x - sin * y,
        pose[1] + sin * x + cos * y,
        cos * ux - sin * uy,
        sin * ux + cos * uy,
    )


@lean_entry
def weigh_rays(poses: FloatArray, rays: FloatArray, known: Known, weights: FloatArray) -> None:
    """Set ``weights`` (m, n, 3) to what :func:`weigh_ray` says of rays (n, 7) for each of the poses
    (m, 3) of their frame in a map.
    """
    for number in range(len(poses)):
        turn = (math.cos(poses[number, 2]), math.sin(poses[number, 2]))
        for i in range(len(rays)):
            ray = placed_ray(poses[number], turn, rays, i)
            row = weights[number, i]
            row[0], row[1], row[2] = weigh_ray(ray, rays[i, RAY_LENGTH], rays[i, RAY_REACH], known)


@compiled
def nearest_wall(x: float, y: float, walls: FloatArray, most: float) -> tuple[float, float, float]:
    """Normal of the nearest wall within a distance (m) of a point, and the way along it to the
    wall, m.

    The normal is zero if there is no such wall.
    """
    normal_x = 0.0
    normal_y = 0.0
    offset = 0.0
    least = most**2
    for number in range(len(walls)):
        wall = line_in(walls, number)
        away_x = x - wall.anchor_x
        away_y = y - wall.anchor_y
        along = away_y * wall.normal_x - away_x * wall.normal_y
        along = min(max(along, 0.0), walls[number, _LENGTH])
        squared = (away_x + along * wall.normal_y) ** 2 + (away_y - along * wall.normal_x) ** 2
        if squared < least:
            least = squared
            normal_x = wall.normal_x
            normal_y = wall.normal_y
            offset = -(normal_x * away_x + normal_y * away_y)
    return normal_x, normal_y, offset


@compiled
def add_residuals(
    pose: FloatArray,
    rays: FloatArray,
    walls: FloatArray,
    most: float,
    cone: float,
    matrix: FloatArray,
    vector: FloatArray,
) -> None:
    """Add the distances of the ends of rays from walls within ``most`` (m) to the normal equations
    of a pose (3,).

    The lower triangle of the matrix counts.
    """
    turn = (math.cos(pose[2]), math.sin(pose[2]))
    for number in range(len(rays)):
        ray = placed_ray(pose, turn, rays, number)
        length = rays[number, RAY_LENGTH]
        end_x, end_y = end_of_ray(ray, length)
        normal_x, normal_y, offset = nearest_wall(end_x, end_y, walls, most)
        if cone > 0.0 and (normal_x != 0.0 or normal_y != 0.0):
            # The middle of a wide beam meets the wall farther away than the beam reads.
            length /= read_share(normal_x * ray.to_x + normal_y * ray.to_y, cone)
            end_x, end_y = end_of_ray(ray, length)
            normal_x, normal_y, offset = nearest_wall(end_x, end_y, walls, most)
        row = normal_x, normal_y, normal_y * (end_x - pose[0]) - normal_x * (end_y - pose[1])
        for i in range(3):
            vector[i] += row[i] * offset
            for j in range(i + 1):
                matrix[i, j] += row[i] * row[j]


@lean_entry
def refine_poses(
    poses: FloatArray,
    rays: FloatArray,
    walls: FloatArray,
    cone: float,
    matrix: FloatArray,
    vector: FloatArray,
) -> None:
    """Move poses (m, 3), so that the ends of rays (n, 7) lie on walls (k, 6): least squares of
    their distances, m.

    The steps are damped. Walls that are not quite parallel, as those of a corridor in a map, would
    otherwise let a pose slide along them. ``cone`` (rad) is half the opening angle of the beams.
    The last two arguments, (3, 3), (3,), are scratch.
    """
    for number in range(len(poses)):
        for turn in range(_ROUNDS):
            for i in range(3):
                vector[i] = 0.0
                for j in range(3):
                    matrix[i, j] = _DAMPING if i == j else 0.0
            most = _FAR + (_NEAR - _FAR) * turn / (_ROUNDS - 1)
            add_residuals(poses[number], rays, walls, most, cone, matrix, vector)
            factorise(matrix, 3)
            solve_factored(matrix, vector, 3)
            for i in range(3):
                poses[number, i] += vector[i]
        poses[number, 2] = wrapped(poses[number, 2])


@compiled
def fill_offsets(
    turn: float, rays: FloatArray, middle: FloatArray, cell: float, offsets: IntArray
) -> None:
    """Set offsets (n, 6) to the rows and columns of the end of each ray, turned about a point, and
    of its way there.
    """
    cos = math.cos(turn)
    sin = math.sin(turn)
    for i in range(len(rays)):
        length = rays[i, RAY_LENGTH]
        inner = length if length >= rays[i, RAY_REACH] else max(length - _UNSEEN, 0.0)
        for point, along in ((0, length), (2, inner), (4, 0.5 * inner)):
            x = rays[i, RAY_X] - middle[0] + along * rays[i, RAY_TO_X]
            y = rays[i, RAY_Y] - middle[1] + along * rays[i, RAY_TO_Y]
            offsets[i, point] = math.floor((sin * x + cos * y) / cell + 0.5)
            offsets[i, point + 1] = math.floor((cos * x - sin * y) / cell + 0.5)


@compiled
def add_row(row: NDArray[np.float32], field: NDArray[np.float32], shift: int) -> None:
    """Add a row of a field, which begins ``shift`` cells before it, to a row; nothing where the
    field has ended.
    """
    low = max(0, -shift)
    high = min(len(row), len(field) - shift)
    # With slices, the compiler knows that no index is negative, and adds many cells at once.
    if low < high:
        into = row[low:high]
        added = field[low + shift : high + shift]
        for column in range(high - low):
            into[column] += added[column]


@lean_entry
def scan_poses(
    turns: FloatArray,
    rays: FloatArray,
    middle: FloatArray,
    fields: NDArray[np.float32],
    cell: float,
    offsets: IntArray,
    scores: NDArray[np.float32],
) -> None:
    """Roughly weigh poses on a grid: a ray counts by the cell of its end, and by two cells on its
    way.

    All places of a row are weighed at once, so that memory is read in order. Set are the ``scores``
    (t, rows, columns) of the ``turns`` (t,), rad, of rays (n, 7) about the ``middle`` (2,), m,
    which is placed in the middle of every second cell of every second row. ``fields`` (2, 2, 2,
    rows, columns) are the evidence of an end of a ray in each cell, and of a ray on its way there;
    the second and the third index say whether the cells have odd rows and odd columns. ``offsets``
    (n, 6) is scratch.
    """
    rows = fields.shape[3]
    for turn in range(len(turns)):
        fill_offsets(turns[turn], rays, middle, cell, offsets)
        for place in range(rows):
            row = scores[turn, place]
            row[:] = 0.0
            for i in range(len(rays)):
                for point in range(0, 6, 2):
                    down = offsets[i, point]
                    right = offsets[i, point + 1]
                    at = place + (down >> 1)
                    kind = 1 if point > 0 else 0
                    if 0 <= at < rows and (kind == 1 or rays[i, RAY_LENGTH] < rays[i, RAY_REACH]):
                        add_row(row, fields[kind, down & 1, right & 1, at], right >> 1)


@lean_entry
def choose_apart(
    poses: FloatArray, shift: float, turn: float, chosen: BoolArray, most: int
) -> None:
    """Mark poses (m, 3), the best ones first, of which no two differ by less than a shift (m) and a
    turn (rad).
    """
    count = 0
    for i in range(len(poses)):
        chosen[i] = count < most
        for j in range(i):
            if not chosen[i]:
                break
            if (
                chosen[j]
                and math.hypot(poses[i, 0] - poses[j, 0], poses[i, 1] - poses[j, 1]) < shift
            ):
                chosen[i] = abs(wrapped(poses[i, 2] - poses[j, 2])) >= turn
        count += chosen[i]
