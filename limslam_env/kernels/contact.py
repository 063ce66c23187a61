"""Contact of round robots with walls and with each other: the compiled counterpart of
``simulation.physics``.
"""

import math

from limslam_env.compilation import compiled, floored, merged
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.kernels.rays import Walls

TOUCH = 1e-5
"""Largest gap that counts as contact, m."""

MAX_PUSHES = 24
"""Number of pushes in a step before robots that still overlap something return to their last
position.
"""

DEEPEST = 5e-4
"""Overlap that is tolerated, m."""

LONGEST_MOVE = 0.5
"""Longest move between two checks for contact, in radii."""

# Distance up to which obstacles are searched for, m.
_OUTLOOK = 0.3


@merged
def nearest_wall(x: float, y: float, outlook: float, walls: Walls) -> tuple[float, float, float]:
    """Distance (m) of the nearest wall and the unit vector from it; ``outlook`` (m) and 0 if no
    wall is that near.
    """
    edges = walls.edges
    cell_starts = walls.cell_starts
    cell_edges = walls.cell_edges
    side = walls.side
    best = outlook * outlook
    best_x = 0.0
    best_y = 0.0
    normal_x = 0.0
    normal_y = 0.0
    first = max(floored((x - outlook - walls.low_x) / side), 0)
    last = min(floored((x + outlook - walls.low_x) / side), walls.columns - 1)
    for row in range(
        max(floored((y - outlook - walls.low_y) / side), 0),
        min(floored((y + outlook - walls.low_y) / side), walls.rows - 1) + 1,
    ):
        cell = walls.first_cell + row * walls.columns
        # Cells of a row lie side by side, and so do their walls.
        for item in range(cell_starts[cell + first], cell_starts[cell + last + 1]):
            edge = cell_edges[item]
            ax = x - edges[edge, 0]
            ay = y - edges[edge, 1]
            ex = edges[edge, 2] - edges[edge, 0]
            ey = edges[edge, 3] - edges[edge, 1]
            fraction = min(max((ax * ex + ay * ey) / (ex * ex + ey * ey), 0.0), 1.0)
            dx = ax - fraction * ex
            dy = ay - fraction * ey
            squared = dx * dx + dy * dy
            if squared < best:
                best = squared
                best_x = dx
                best_y = dy
                normal_x = ey
                normal_y = -ex
    distance = math.sqrt(best)
    if distance >= outlook:
        return outlook, 0.0, 0.0
    if distance <= TOUCH:
        # The centre lies on the wall: both normals are equally good.
        best_x = normal_x
        best_y = normal_y
    size = math.sqrt(best_x * best_x + best_y * best_y)
    return distance, best_x / size, best_y / size


@merged
def nearest_thing(
    robot: int, places: FloatArray, radius: float, outlook: float, walls: Walls
) -> tuple[float, float, float, int]:
    """As :func:`nearest_wall`, for walls and other robots around one robot; and which robot it is,
    or -1.
    """
    x = places[robot, 0]
    y = places[robot, 1]
    distance, away_x, away_y = nearest_wall(x, y, outlook, walls)
    which = -1
    for other in range(len(places)):
        dx = x - places[other, 0]
        dy = y - places[other, 1]
        between = math.hypot(dx, dy)
        if other != robot and between - radius < distance:
            distance = between - radius
            which = other
            away_x, away_y = (dx / between, dy / between) if between > 0.0 else (1.0, 0.0)
    return distance, away_x, away_y, which


@compiled
def separate(  # noqa: C901 (walls, robots, and pushes that do not converge)
    places: FloatArray,
    before: FloatArray,
    deep: BoolArray,
    radius: float,
    contact: BoolArray,
    walls: Walls,
) -> float:
    """Push robots at ``places`` (m, 2 or more) out of what they overlap, along the shortest way.

    The pushes are repeated where walls meet, as in ``simulation.physics.Physics``; robots that
    still overlap something return to their positions ``before``. Sets ``contact`` (m,). Returns the
    distance that the robots can travel before one of them may touch something, m. ``deep`` (m,) is
    scratch memory.
    """
    gap = _OUTLOOK
    for robot in range(len(places)):
        distance, _, _, _ = nearest_thing(robot, places, radius, radius + _OUTLOOK, walls)
        gap = min(gap, distance - radius)
    if gap > TOUCH:
        return gap - TOUCH
    for _ in range(MAX_PUSHES):
        is_pushed = False
        for robot in range(len(places)):
            distance, away_x, away_y, other = nearest_thing(
                robot, places, radius, radius + TOUCH, walls
            )
            if distance >= radius + TOUCH:
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
            is_pushed |= depth > TOUCH
        if not is_pushed:
            return 0.0
    for _ in range(len(places)):
        for robot in range(len(places)):
            distance, _, _, _ = nearest_thing(robot, places, radius, radius + TOUCH, walls)
            deep[robot] = distance < radius - DEEPEST
        for robot in range(len(places)):
            if deep[robot]:
                places[robot, 0] = before[robot, 0]
                places[robot, 1] = before[robot, 1]
    return 0.0
