"""Where the beams of a drive meet the lines of a map: the line that predicts each reading best, and
the beams that passed through lines.

Rays (n, 5) have the first columns of a table of rays, up to the length. A line is a row (m, 5) with
the fields of :class:`~limslam_agent.kernels.beams.Line`.
"""

import math

from limslam_agent.kernels.beams import Ray, line_in, measuring_ray, meeting, passes
from limslam_agent.kernels.compilation import compiled, lean_entry
from limslam_agent.kernels.tables import (
    BIN,
    GRAZING,
    RAY_LENGTH,
    RAY_TO_X,
    RAY_TO_Y,
    RAY_X,
    RAY_Y,
)
from limslam_env.geometry import FloatArray, IntArray


@compiled
def ray_in(rays: FloatArray, number: int) -> Ray:
    """A row of a table of rays."""
    return Ray(
        rays[number, RAY_X], rays[number, RAY_Y], rays[number, RAY_TO_X], rays[number, RAY_TO_Y]
    )


@lean_entry
def choose_lines(
    rays: FloatArray,
    lines: FloatArray,
    ends: FloatArray,
    cone: float,
    best: IntArray,
    misfits: FloatArray,
) -> None:
    """For each reading, find the line that predicts it best, among those that it meets between
    their ends.

    ``ends`` (m, 2, 2) are those of the parts that were read from the positive and from the negative
    side, m, and ``cone`` is half the opening angle of the beams, rad. Set are the line (n,), 0
    without one, and the misfits (n, 2) to the best and the second line, m, infinite without one.
    """
    for i in range(len(rays)):
        ray = ray_in(rays, i)
        best[i] = 0
        misfits[i, 0] = math.inf
        misfits[i, 1] = math.inf
        for number in range(len(lines)):
            line = line_in(lines, number)
            if abs(line.normal_x * ray.to_x + line.normal_y * ray.to_y) <= GRAZING:
                continue
            measuring = measuring_ray(ray, (line.normal_x, line.normal_y), cone)
            distance, along, cosine = meeting(measuring, line)
            side = 0 if cosine < 0.0 else 1
            if distance <= 0.0 or not ends[number, side, 0] <= along <= ends[number, side, 1]:
                continue
            misfit = abs(distance - rays[i, RAY_LENGTH])
            if misfit < misfits[i, 0]:
                misfits[i, 1] = misfits[i, 0]
                misfits[i, 0] = misfit
                best[i] = number
            else:
                misfits[i, 1] = min(misfits[i, 1], misfit)


@lean_entry
def count_passes(
    rays: FloatArray,
    lines: FloatArray,
    low: IntArray,
    margin: float,
    misses: IntArray,
    shares: FloatArray,
    against: FloatArray,
) -> None:
    """Count the beams that passed through each bin of lines by more than a margin, m along the
    normal.

    ``low`` (m,) are the first bins of the lines. Added to are the ``misses`` (m, b), and
    ``against`` (n,) is set to the largest of the ``shares`` (m, b) of the bins that a beam has
    passed.
    """
    for i in range(len(rays)):
        ray = ray_in(rays, i)
        against[i] = 0.0
        for number in range(len(lines)):
            distance, along, cosine = meeting(ray, line_in(lines, number))
            if passes(distance, cosine, rays[i, RAY_LENGTH], margin):
                place = math.floor(along / BIN) - low[number]
                if 0 <= place < misses.shape[1]:
                    misses[number, place] += 1
                    against[i] = max(against[i], shares[number, place])
