"""All measurements of one time step in one simulation."""

import math

from limslam_env.compilation import lean_entry
from limslam_env.geometry import BoolArray, FloatArray, IntArray, ReadingArray
from limslam_env.kernels.coverage import mark_disc, mark_ray
from limslam_env.kernels.rays import measure, turned
from limslam_env.kernels.readings import noisy_reading, reported_travel
from limslam_env.kernels.wall_cells import scene_walls

CONE = (-1.0, -0.5, 0.5, 1.0)
"""Directions of the further rays of a cone, besides its middle, in shares of half its opening angle."""


@lean_entry
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
    unreported: FloatArray,
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
    unreported
        (n, 2), kept from step to step: travel that the encoders have not reported so far, m.
    hits, ranges
        (n, n_beams), kept from step to step: the wall that each beam hit, and its reading, m.
    wheels
        (n, 2), set to what the encoders say, m.
    new_cells
        (n,), set to the number of cells that each robot covered as the first.
    """
    # Numbers are taken out of the arrays one by one: a slice costs as much as a ray.
    walls = scene_walls(edges, cell_starts, cell_edges, grid)
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
            distance, hit = measure(robot, poses, radius, x, y, dx, dy, reach, walls)
            new += mark_ray(seen, coverable, area, x, y, dx, dy, distance)
            if noise[5] > 0.0:
                angle = heading + beams[number, 2]
                for share in CONE:
                    dx, dy = math.cos(angle + share * noise[5]), math.sin(angle + share * noise[5])
                    x, y = rim_x - offset * dx, rim_y - offset * dy
                    aside, other = measure(robot, poses, radius, x, y, dx, dy, reach, walls)
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
            wheels[robot, side], unreported[robot, side] = reported_travel(
                travel[robot, side], unreported[robot, side],
                noise[6 + side], noise[8], noise[9], noise[10], draws[robot, len(beams) + side, 0],
            )  # fmt: skip
