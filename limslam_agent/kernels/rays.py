"""How well the readings of a drive fit a map from many poses: the evidence of each reading, and the
search for poses.

The rays of a drive are the beams with their readings, in the frame of the drive. A pose of this
frame in a map places all of them.
"""

import math

import numpy as np
from numpy.typing import NDArray

from limslam_agent.kernels.algebra import factorise, solve_factored, wrapped
from limslam_agent.kernels.beams import Line, Ray, end_of_ray, meeting, passes, read_share
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
_START_X, _START_Y, _TANGENT_X, _TANGENT_Y, _LENGTH = range(5)  # columns of a table of walls


@compiled
def fill_table(segments: FloatArray, table: FloatArray) -> None:
    """Set rows (k, 5) to walls (k, 4), m: start, m, unit vector along the wall, and length, m."""
    for wall in range(len(segments)):
        x = segments[wall, 2] - segments[wall, 0]
        y = segments[wall, 3] - segments[wall, 1]
        length = math.hypot(x, y)
        table[wall, _START_X] = segments[wall, 0]
        table[wall, _START_Y] = segments[wall, 1]
        table[wall, _LENGTH] = length
        table[wall, _TANGENT_X] = x / max(length, 1e-9)
        table[wall, _TANGENT_Y] = y / max(length, 1e-9)


@compiled
def crossing(ray: Ray, wall: FloatArray) -> tuple[float, float, float]:
    """Where a beam meets the line of a wall: how far along the beam, m, how far beyond the wall's
    ends, m, and cosine.

    The position is negative between the ends. The cosine, without sign, is that of the angle
    between the beam and the wall's normal.
    """
    line = Line(0.0, wall[_TANGENT_Y], -wall[_TANGENT_X], wall[_START_X], wall[_START_Y])
    distance, along, cosine = meeting(ray, line)
    return distance, max(-along, along - wall[_LENGTH]), abs(cosine)


@compiled
def wall_evidence(length: float, reach: float, wall: float, std: float) -> float:
    """The evidence of a reading for a wall at a distance (m), against a random place."""
    if length >= reach:
        beyond = 0.5 * math.erfc((reach - wall) / (std * math.sqrt(2.0)))
        return math.log(((1.0 - UNRELATED) * beyond + UNRELATED * NOTHING) / NOTHING)
    density = normal_density(length - wall, std)
    return math.log((1.0 - UNRELATED) * density * reach / (1.0 - NOTHING) + UNRELATED)


@compiled
def free_length(
    ray: Ray,
    longest: float,
    values: NDArray[np.int16],
    low: FloatArray,
    cell: float,
) -> tuple[float, int]:
    """How far along a ray all cells are free, up to a longest distance, m, and the value of the
    cell that ends it.

    The value is that of a free cell if none ends it. Cells outside of the grid are unknown.
    """
    for step in range(math.ceil(2.0 * longest / cell)):
        along = 0.5 * step * cell
        row = math.floor((ray.y + along * ray.to_y - low[1]) / cell)
        column = math.floor((ray.x + along * ray.to_x - low[0]) / cell)
        if not (0 <= row < values.shape[0] and 0 <= column < values.shape[1]):
            return along, 0
        if values[row, column] <= 0:
            return along, int(values[row, column])
    return longest, 1


@compiled
def is_inside(
    x: float, y: float, values: NDArray[np.int16], low: FloatArray, cell: float, around: int
) -> bool:
    """Whether a point (m) lies in a free cell, and all cells up to a number of cells around it are
    free.
    """
    row = math.floor((y - low[1]) / cell)
    column = math.floor((x - low[0]) / cell)
    if not (
        around <= row < values.shape[0] - around and around <= column < values.shape[1] - around
    ):
        return False
    for down in range(-around, around + 1):
        for right in range(-around, around + 1):
            if values[row + down, column + right] <= 0:
                return False
    return True


@compiled
def explain(
    length: float,
    reach: float,
    wall: float,
    cosine: float,
    free: float,
    ends_at: int,
    spread: tuple[float, float],
) -> tuple[float, float, bool]:
    """The evidence of a reading for a map against a random place, where it contradicts the map, and
    whether it might.

    The second number is the distance at which it contradicts the map, m: at a wall that it has
    passed, or where it ended in free ground. It is 0 if it contradicts nothing. The first wall is
    at the distance ``wall``, m, with this cosine between the ray and its normal; cells are ``free``
    so far, m, and then have the value ``ends_at``. ``spread`` is the variance of the distance to a
    wall, m^2, and how it grows with the squared distance, rad^2.
    """
    if wall < reach and wall <= free + _UNSEEN:
        steep = max(cosine, _STEEPEST)
        across = math.sqrt(spread[0] + spread[1] * wall**2)
        std = across / steep
        is_short = length < min(wall, free) - _BESIDE - THROUGH_SIGMAS * std
        is_through = passes(wall, steep, length - _BESIDE, THROUGH_SIGMAS * across)
        against = length if is_short else wall if is_through else 0.0
        return wall_evidence(length, reach, wall, std), against, True
    if free >= reach - 0.05:
        is_empty = length > reach - 0.1
        likelihood = (1.0 - UNRELATED) / NOTHING if is_empty else UNRELATED
        return math.log(likelihood), 0.0 if is_empty else length, True
    if free <= 0.0:
        return 0.0, 0.0, False
    if length < free - _BESIDE - THROUGH_SIGMAS * math.sqrt(spread[0] + spread[1] * free**2):
        return math.log(UNRELATED), length, True
    # Beyond known ground, a reading is no surprise at a random place either: it mostly goes on
    # along what the beam saw before, and not each of many such readings is news.
    if ends_at < 0:
        # Beams ended in this cell, but no wall was drawn.
        either = 0.5 * math.exp(wall_evidence(length, reach, free, _ROUGH)) + 0.5
        return math.log(either), 0.0, False
    return 0.0, 0.0, False


@compiled
def weigh_ray(
    ray: Ray,
    length: float,
    reach: float,
    walls: FloatArray,
    values: NDArray[np.int16],
    low: FloatArray,
    cell: float,
    spread: tuple[float, float],
    cone: float,
) -> tuple[float, float, bool]:
    """The evidence of a reading for a map, at what distance it contradicts the map, m, and whether
    it might do so.

    The distance is 0 if it does not. ``spread`` is that of :func:`explain`.
    """
    longer = math.inf
    shorter = math.inf
    cosine_longer = 1.0
    cosine_shorter = 1.0
    for wall in range(len(walls)):
        distance, beyond, cosine = crossing(ray, walls[wall])
        if distance < 0.0 or beyond >= _OVER or cosine <= GRAZING:
            continue
        distance *= read_share(cosine, cone)
        if distance < longer:
            longer = distance
            cosine_longer = cosine
        if distance < shorter and beyond < -_INSET:
            shorter = distance
            cosine_shorter = cosine
    free, ends_at = free_length(ray, reach, values, low, cell)
    evidence, against, is_tested = explain(
        length, reach, longer, cosine_longer, free, ends_at, spread
    )
    if shorter != longer:
        other, against_other, _ = explain(
            length, reach, shorter, cosine_shorter, free, ends_at, spread
        )
        evidence = max(evidence, other)
        against = against if against_other > 0.0 else 0.0
    if against > 0.0 and length < min(reach, shorter - _BESIDE):
        # It ended before the wall, if there is one. A wall that was not drawn yet may be near, or
        # beside a wide beam.
        around = 1 + int(length * math.sin(cone) / cell)
        if not is_inside(
            ray.x + length * ray.to_x, ray.y + length * ray.to_y, values, low, cell, around
        ):
            evidence = max(evidence, 0.0)
            against = 0.0
    return evidence, against, is_tested


@compiled
def placed_ray(x0: float, y0: float, cos: float, sin: float, rays: FloatArray, number: int) -> Ray:
    """A ray, moved by a pose at (x0, y0), m, with this cosine and sine
    of its heading.
    """
    x = rays[number, RAY_X]
    y = rays[number, RAY_Y]
    ux = rays[number, RAY_TO_X]
    uy = rays[number, RAY_TO_Y]
    return Ray(
        x0 + cos * x - sin * y, y0 + sin * x + cos * y, cos * ux - sin * uy, sin * ux + cos * uy
    )


@lean_entry
def weigh_poses(
    poses: FloatArray,
    rays: FloatArray,
    segments: FloatArray,
    walls: FloatArray,
    values: NDArray[np.int16],
    low: FloatArray,
    cell: float,
    spread: tuple[float, float],
    cone: float,
    evidence: FloatArray,
    counts: IntArray,
) -> None:
    """Find the evidence of rays for poses of their frame in a map.

    Set are the logarithm of the likelihood ratio ``evidence`` (m,) of each of the poses (m, 3) and
    of a random place, and the numbers of rays ``counts`` (m, 2), of (n, 7), that contradict the
    map, and that could have done so. The map is walls (k, 4), m, and cells (rows, columns),
    positive if free, with the lower left corner ``low`` (2,), m. ``spread`` is that of
    :func:`explain`, ``cone`` is half the opening angle of the beams, rad, and ``walls`` (k, 5) is
    scratch.
    """
    fill_table(segments, walls)
    for number in range(len(poses)):
        total = 0.0
        against = 0
        tested = 0
        x = poses[number, 0]
        y = poses[number, 1]
        cos = math.cos(poses[number, 2])
        sin = math.sin(poses[number, 2])
        for i in range(len(rays)):
            found, distance, is_tested = weigh_ray(
                placed_ray(x, y, cos, sin, rays, i),
                rays[i, RAY_LENGTH],
                rays[i, RAY_REACH],
                walls,
                values,
                low,
                cell,
                spread,
                cone,
            )
            total += found
            against += distance > 0.0
            tested += is_tested
        evidence[number] = total
        counts[number, 0] = against
        counts[number, 1] = tested


@lean_entry
def weigh_rays(
    rays: FloatArray,
    segments: FloatArray,
    walls: FloatArray,
    values: NDArray[np.int16],
    low: FloatArray,
    cell: float,
    spread: tuple[float, float],
    cone: float,
    found: FloatArray,
) -> None:
    """Set rows (n, 3) to what :func:`weigh_ray` finds for rays (n, 7) in the frame of the map.

    The other arguments are those of :func:`weigh_poses`.
    """
    fill_table(segments, walls)
    for i in range(len(rays)):
        ray = Ray(rays[i, RAY_X], rays[i, RAY_Y], rays[i, RAY_TO_X], rays[i, RAY_TO_Y])
        found[i, 0], found[i, 1], found[i, 2] = weigh_ray(
            ray, rays[i, RAY_LENGTH], rays[i, RAY_REACH], walls, values, low, cell, spread, cone
        )


@compiled
def nearest_offset(
    x: float, y: float, walls: FloatArray, most: float
) -> tuple[float, float, float]:
    """Normal of the nearest wall within a distance (m) of a point, and the way along it to the
    wall, m.

    The normal is zero if there is no such wall.
    """
    normal_x = 0.0
    normal_y = 0.0
    offset = 0.0
    least = most**2
    for wall in range(len(walls)):
        away_x = x - walls[wall, 0]
        away_y = y - walls[wall, 1]
        tangent_x = walls[wall, 2]
        tangent_y = walls[wall, 3]
        length = walls[wall, 4]
        along = min(max(away_x * tangent_x + away_y * tangent_y, 0.0), length)
        squared = (away_x - along * tangent_x) ** 2 + (away_y - along * tangent_y) ** 2
        if squared < least:
            least = squared
            normal_x = -tangent_y
            normal_y = tangent_x
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
    x0 = pose[0]
    y0 = pose[1]
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    for number in range(len(rays)):
        ray = placed_ray(x0, y0, cos, sin, rays, number)
        length = rays[number, RAY_LENGTH]
        end_x, end_y = end_of_ray(ray, length)
        normal_x, normal_y, offset = nearest_offset(end_x, end_y, walls, most)
        if cone > 0.0 and (normal_x != 0.0 or normal_y != 0.0):
            # The middle of a wide beam meets the wall farther away than the beam reads.
            length /= read_share(normal_x * ray.to_x + normal_y * ray.to_y, cone)
            end_x, end_y = end_of_ray(ray, length)
            normal_x, normal_y, offset = nearest_offset(end_x, end_y, walls, most)
        x = end_x - x0
        y = end_y - y0
        row = normal_x, normal_y, normal_y * x - normal_x * y
        for i in range(3):
            vector[i] += row[i] * offset
            for j in range(i + 1):
                matrix[i, j] += row[i] * row[j]


@lean_entry
def refine_poses(
    poses: FloatArray,
    rays: FloatArray,
    segments: FloatArray,
    cone: float,
    walls: FloatArray,
    matrix: FloatArray,
    vector: FloatArray,
) -> None:
    """Move poses (m, 3), so that the ends of rays (n, 7) lie on walls (k, 4), m: least squares of
    their distances.

    The steps are damped. Walls that are not quite parallel, as those of a corridor in a map, would
    otherwise let a pose slide along them. ``cone`` (rad) is half the opening angle of the beams.
    The last three arguments, (k, 5), (3, 3), (3,), are scratch.
    """
    fill_table(segments, walls)
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
