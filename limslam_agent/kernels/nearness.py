"""Ends of beams beside the body and on other robots."""

import math

from limslam_agent.kernels.compilation import compiled, lean_entry
from limslam_agent.kernels.tables import (
    ANGLE,
    FARTHEST,
    FROM_X,
    FROM_Y,
    TOO_FAR,
    TOO_NEAR,
    TOWARDS_X,
    TOWARDS_Y,
)
from limslam_env.geometry import BoolArray, FloatArray


@compiled
def beam_end(
    pose: FloatArray, cos: float, sin: float, beams: FloatArray, beam: int, reach: float
) -> tuple[float, float]:
    """The point of the world, m, that a beam reaches after ``reach`` (m), from a pose with this
    cosine and sine.
    """
    x = beams[beam, FROM_X] + reach * beams[beam, TOWARDS_X]
    y = beams[beam, FROM_Y] + reach * beams[beam, TOWARDS_Y]
    return x * cos - y * sin + pose[0], x * sin + y * cos + pose[1]


@lean_entry
def place_readings(
    pose: FloatArray,
    ranges: FloatArray,
    beams: FloatArray,
    touching: float,
    seen: FloatArray,
    touched: FloatArray,
) -> None:
    """Set where a step's readings ended, and where something touched a sensor (b, 2), m; NaN for
    nowhere.

    A beam at its minimum range has hit something at the share ``touching`` of it. ``beams`` is
    ``RobotSpec.beam_table``.
    """
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    for beam in range(len(ranges)):
        near = beams[beam, TOO_NEAR]
        reading = ranges[beam]
        if not math.isfinite(reading):
            reading = beams[beam, FARTHEST]
        for axis in range(2):
            seen[beam, axis] = touched[beam, axis] = math.nan
        if near < reading < beams[beam, TOO_FAR]:
            seen[beam, 0], seen[beam, 1] = beam_end(pose, cos, sin, beams, beam, reading)
        if reading <= near:
            touched[beam, 0], touched[beam, 1] = beam_end(
                pose, cos, sin, beams, beam, touching * near
            )


@compiled
def is_clear(
    pose: FloatArray,
    way_x: float,
    way_y: float,
    points: FloatArray,
    deepest: float,
    farthest: float,
) -> bool:
    """Whether a body that moves by a way keeps its distance of points (n, k, 2), m, of which some
    may be NaN.
    """
    # Points outside of this square, a little wider than it need be, are too far away in any case.
    # Most points are.
    reach = 1.001 * (farthest + abs(way_x) + abs(way_y))
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            x = points[i, j, 0] - pose[0]
            y = points[i, j, 1] - pose[1]
            if abs(x) > reach or abs(y) > reach:
                continue
            before = math.hypot(x, y)
            # NaN is not more than any number.
            if before > deepest and math.hypot(x - way_x, y - way_y) < min(before, farthest):
                return False
    return True


@lean_entry
def safe_share(
    pose: FloatArray,
    way: FloatArray,
    seen: FloatArray,
    touched: FloatArray,
    deepest: float,
    farthest: float,
    shares: FloatArray,
) -> float:
    """The first of some shares of a way that a body can move without coming too close to a point; 0
    if there is none.

    The body is at a ``pose`` (3,), and the ``way`` is (2,), m. Of the points (n, b, 2), m, that
    were ``seen`` and ``touched``, some may be NaN, and those nearer to the body's middle than
    ``deepest``, m, do not count. The middle must come no nearer to a point than ``farthest``, m, or
    than it is.
    """
    for number in range(len(shares)):
        share = float(shares[number])
        x = share * way[0]
        y = share * way[1]
        if is_clear(pose, x, y, seen, deepest, farthest) and is_clear(
            pose, x, y, touched, deepest, farthest
        ):
            return share
    return 0.0


@lean_entry
def room_ahead(
    ranges: FloatArray, beams: FloatArray, front: float, radius: float, margin: float
) -> float:
    """Distance (m) that a body can drive straight ahead before it meets the nearest point seen by a
    front beam.

    ``front`` is the largest angle of a front beam from straight ahead, rad, and ``margin`` is kept
    at the body's sides, m. ``beams`` is ``RobotSpec.beam_table``.
    """
    has_front = False
    has_reading = False
    room = math.inf
    for beam in range(len(ranges)):
        angle = math.pi - (math.pi - beams[beam, ANGLE]) % (2.0 * math.pi)
        if abs(angle) > front:
            continue
        has_front = True
        if not math.isfinite(ranges[beam]):
            continue
        has_reading = True
        x = beams[beam, FROM_X] + ranges[beam] * beams[beam, TOWARDS_X]
        y = abs(beams[beam, FROM_Y] + ranges[beam] * beams[beam, TOWARDS_Y])
        if ranges[beam] < beams[beam, TOO_FAR] and y < radius + margin and x > 0.0:
            lateral = min(y, radius)
            room = min(room, x - math.sqrt(radius * radius - lateral * lateral))
    # Without a reading nothing is known of what is ahead.
    return 0.0 if has_front and not has_reading else room


@lean_entry
def beams_on_robots(
    poses: FloatArray,
    covariance: FloatArray,
    number: int,
    ranges: FloatArray,
    beams: FloatArray,
    sizes: tuple[float, float, float, float, float, float],
    found: BoolArray,
) -> None:
    """Mark the beams (b,) of a robot that may end on the body of another one.

    The poses (n, 3) have a joint ``covariance`` (3 n, 3 n), and ``beams`` is
    ``RobotSpec.beam_table``. The sizes are ``RangeSensor.numbers``, the radius of the body, m, a
    number of standard deviations, and a slack, m.
    """
    std, growth, cone, radius, sigmas, slack = sizes
    pose = poses[number]
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    for other in range(len(poses)):
        if other == number:
            continue
        for beam in range(len(ranges)):
            reached = ranges[beam]
            x, y = beam_end(pose, cos, sin, beams, beam, reached)
            off_x = x - poses[other, 0]
            off_y = y - poses[other, 1]
            distance = math.sqrt(off_x**2 + off_y**2)
            toward_x = off_x / max(distance, 1e-9)
            toward_y = off_y / max(distance, 1e-9)
            # Derivative of the distance by the measuring robot's x, y and theta, and by the other's
            # x and y.
            turning = (x - pose[0]) * toward_y - (y - pose[1]) * toward_x
            by = (toward_x, toward_y, turning, -toward_x, -toward_y)
            variance = 0.0
            for i in range(5):
                for j in range(5):
                    row = 3 * number + i if i < 3 else 3 * other + i - 3
                    column = 3 * number + j if j < 3 else 3 * other + j - 3
                    variance += by[i] * covariance[row, column] * by[j]
            noise = std**2 + (growth * reached**2) ** 2
            margin = sigmas * math.sqrt(max(variance, 0.0) + noise) + slack
            # The nearest point inside a wide beam may be anywhere between its borders.
            if distance <= radius + margin + cone * reached:
                found[beam] = True
