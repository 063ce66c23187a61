"""One time step of one simulation: the motion of robots that are far from all obstacles, and all
measurements.
"""

import math
from typing import NamedTuple

import numpy as np

from limslam_env.compilation import inlined, lean_entry, merged
from limslam_env.geometry import BoolArray, FloatArray, IntArray, ReadingArray, se2
from limslam_env.kernels import readings as tables
from limslam_env.kernels.coverage import CellGrid, mark_disc, mark_ray
from limslam_env.kernels.rays import Cone, Discs, Ray, Walls, measure, nearest_in_cone, turned
from limslam_env.kernels.readings import is_due, noisy_reading, reported_travel, way_over_ground

AXLE, CLEARANCE, LONGEST = range(3)
"""What a motion depends on besides the wheels, m: the distance between them, the distance that the
robots can travel in total before one of them may touch something, and the longest move between two
checks for contact.
"""

arc_end = inlined(se2.arc_end)


@merged
def move_freely(poses: FloatArray, ground: FloatArray, motion: FloatArray) -> bool:
    """Move robots (n, 3) to the ends of their arcs if none of them can touch anything, and say
    whether they were.
    """
    farthest = 0.0
    for robot in range(len(poses)):
        farthest = max(farthest, 0.5 * abs(ground[robot, 0] + ground[robot, 1]))
    # Two robots may approach each other.
    clearance = motion[CLEARANCE] - (farthest if len(poses) == 1 else 2.0 * farthest)
    if farthest > motion[LONGEST] or clearance <= 0.0:
        return False
    motion[CLEARANCE] = clearance
    for robot in range(len(poses)):
        poses[robot, 0], poses[robot, 1], poses[robot, 2] = arc_end(
            poses[robot, 0],
            poses[robot, 1],
            poses[robot, 2],
            ground[robot, 0],
            ground[robot, 1],
            motion[AXLE],
        )
    return True


class Scene(NamedTuple):
    """The robots of one simulation, what they are among, and what they measure.

    Attributes
    ----------
    poses, motion
        Robots (n, 3), m and rad; and (3,), see ``AXLE``.
    travel, ground
        How far the wheels turn (n, 2), m, and the distance (n, 2), m, that they move over the
        ground.
    radius, beams, noise
        Of their bodies, m; (n_beams, 12) and (14,), see :mod:`limslam_env.kernels.readings`.
    walls
        The walls around them.
    seen, coverable, area
        The coverage: see :class:`limslam_env.kernels.coverage.CellGrid`.
    unreported, hits, ranges
        Kept from step to step: travel that the encoders have not reported so far (n, 2), m; and the
        wall that each beam hit, and its reading, m, (n, n_beams).
    wheels, new_cells
        What the encoders say (n, 2), m, and the number of cells (n,) that each robot covered as the
        first.
    """

    poses: FloatArray
    motion: FloatArray
    travel: FloatArray
    ground: FloatArray
    radius: float
    beams: FloatArray
    noise: FloatArray
    walls: Walls
    seen: BoolArray
    coverable: BoolArray
    area: FloatArray
    unreported: FloatArray
    hits: IntArray
    ranges: ReadingArray
    wheels: ReadingArray
    new_cells: IntArray


def new_scene(
    poses: FloatArray,
    motion: FloatArray,
    radius: float,
    beams: FloatArray,
    noise: FloatArray,
    walls: Walls,
    grid: CellGrid,
) -> Scene:
    """A scene in which no robot has moved or measured yet."""
    count = len(poses)
    shape = count, len(beams)
    return Scene(
        poses=poses,
        motion=motion,
        travel=np.zeros((count, 2)),
        ground=np.zeros((count, 2)),
        radius=radius,
        beams=beams,
        noise=noise,
        walls=walls,
        seen=grid.seen,
        coverable=grid.coverable,
        area=grid.area,
        unreported=np.zeros((count, 2)),
        hits=np.zeros(shape, dtype=np.int64),
        ranges=np.zeros(shape, dtype=np.float32),
        wheels=np.zeros((count, 2), dtype=np.float32),
        new_cells=np.zeros(count, dtype=np.int64),
    )


@lean_entry
def drive_and_observe(
    is_moved: bool,
    step: int,
    draws: FloatArray,
    poses: FloatArray,
    motion: FloatArray,
    travel: FloatArray,
    ground: FloatArray,
    radius: float,
    beams: FloatArray,
    noise: FloatArray,
    walls: Walls,
    seen: BoolArray,
    coverable: BoolArray,
    area: FloatArray,
    unreported: FloatArray,
    hits: IntArray,
    ranges: ReadingArray,
    wheels: ReadingArray,
    new_cells: IntArray,
) -> bool:
    """Move all robots if none can touch anything, take their measurements, and mark what beams and
    bodies cover.

    If a robot may touch something, False is returned, and all stay where they are: they have to be
    moved with a check for contact.

    Parameters
    ----------
    is_moved
        Whether the robots are where they are to be; then they are not moved.
    step
        Number of this step; beams whose turn it is not keep ``hits`` and ``ranges``.
    draws
        (n, n_beams + 2, 2) numbers from N(0, 1) and U(0, 1): for each beam, then for each wheel.

    The rest are the fields of a :class:`Scene`, since a tuple of tuples takes longer to hand over
    than their arrays. ``poses``, the clearance of ``motion``, ``ground``, ``seen`` and what follows
    ``area`` are changed in place.
    """
    grid = CellGrid(seen, coverable, area)
    if not is_moved:
        for robot in range(len(poses)):
            for side in range(2):
                ground[robot, side] = way_over_ground(
                    travel[robot, side],
                    noise[tables.SLIP_RATE],
                    noise[tables.SLIP_SHARE],
                    draws[robot, len(beams) + side, 1],
                )
        if not move_freely(poses, ground, motion):
            return False
    # Numbers are taken out of the arrays one by one: a slice costs as much as a ray.
    for robot in range(len(poses)):
        body_x = poses[robot, 0]
        body_y = poses[robot, 1]
        heading = poses[robot, 2]
        cos = math.cos(heading)
        sin = math.sin(heading)
        new = mark_disc(grid, body_x, body_y, radius)
        discs = Discs(robot, poses, radius)
        for number in range(len(beams)):
            if not is_due(beams, number, step):
                continue
            offset = beams[number, tables.OFFSET]
            reach = beams[number, tables.LONGEST_RANGE] + offset
            # The rim may touch a wall, and a ray from there start behind it: rays start inside the
            # body.
            rim_x, rim_y = turned(
                beams[number, tables.FROM_X], beams[number, tables.FROM_Y], cos, sin
            )
            rim_x = body_x + rim_x
            rim_y = body_y + rim_y
            dx, dy = turned(
                beams[number, tables.TOWARDS_X], beams[number, tables.TOWARDS_Y], cos, sin
            )
            x = rim_x - offset * dx
            y = rim_y - offset * dy
            distance, hit = measure(Ray(x, y, dx, dy, reach), discs, walls)
            new += mark_ray(grid, Ray(x, y, dx, dy, distance))
            if noise[tables.CONE] > 0.0:
                angle = heading + beams[number, tables.ANGLE]
                cone = Cone(rim_x, rim_y, angle, noise[tables.CONE], offset, reach)
                distance, hit = nearest_in_cone(cone, distance, hit, discs, walls)
            hits[robot, number] = hit
            ranges[robot, number] = noisy_reading(
                distance - offset,
                hit,
                beams,
                number,
                noise,
                draws[robot, number, 0],
                draws[robot, number, 1],
            )
        new_cells[robot] = new
        for side in range(2):
            wheels[robot, side], unreported[robot, side] = reported_travel(
                travel[robot, side],
                unreported[robot, side],
                noise[tables.LEFT_WHEEL + side],
                noise[tables.WHEEL_VARIANCE],
                noise[tables.ENCODER_RESOLUTION],
                noise[tables.LARGEST_TRAVEL],
                draws[robot, len(beams) + side, 0],
            )
    return True
