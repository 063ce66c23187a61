"""The index of walls for ray casting, the tables of beams and noise for the kernels, and random
numbers for steps.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from limslam_env.geometry import FloatArray, IntArray
from limslam_env.interface import RobotSpec
from limslam_env.kernels.rays import Walls, cast_rays, list_walls

CELL = 0.5

# Walls are listed in a cell if they come as near as this to it, m.
_BORDER = 1e-6

_BLOCK = 64
_NUM_WHEELS = 2


def build_wall_index(edges: FloatArray) -> Walls:
    """Sort walls (k, 4), m, for rays that start among them."""
    low_x, low_y = (np.minimum(edges[:, :2], edges[:, 2:]).min(axis=0) - CELL).tolist()
    high = np.maximum(edges[:, :2], edges[:, 2:]).max(axis=0) + CELL
    columns, rows = np.ceil((high - (low_x, low_y)) / CELL).astype(int).tolist()
    nothing = np.zeros(0, dtype=np.int64)
    walls = Walls(np.array(edges), nothing, nothing, low_x, low_y, CELL, columns, rows, 0)
    starts, numbers = walls_around(walls, _BORDER)
    return walls._replace(cell_starts=starts, cell_edges=numbers)


def walls_around(walls: Walls, reach: float) -> tuple[IntArray, IntArray]:
    """The walls within ``reach`` (m) of each cell, as ``cell_starts`` and ``cell_edges`` of
    :class:`Walls` are.
    """
    count = walls.columns * walls.rows
    starts = np.zeros(count + 1, dtype=np.int64)
    empty = np.zeros(0, dtype=np.int64)
    list_walls(walls, reach, np.zeros(count, dtype=np.int64), starts, empty)
    numbers = np.empty(starts[-1], dtype=np.int64)
    list_walls(walls, reach, np.zeros(count, dtype=np.int64), starts, numbers)
    return starts, numbers


def cast(
    walls: Walls, origins: FloatArray, directions: FloatArray, lengths: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Distances (n,), m, and walls hit (n,) of rays from (n, 2) along unit vectors (n, 2), (n,) m
    long.

    A ray that hits nothing has its own length, and -1.
    """
    distances = np.empty(len(origins))
    hits = np.empty(len(origins), dtype=np.int64)
    cast_rays(origins, directions, lengths, walls, distances, hits)
    return distances, hits


def beam_table(robot: RobotSpec) -> FloatArray:
    """The beams (n_beams, 12) with the columns of :mod:`limslam_env.kernels.readings`."""
    offsets = np.maximum(np.einsum("bd,bd->b", robot.beam_origins, robot.beam_directions), 0.0)
    return np.column_stack((robot.beam_table, offsets, robot.min_ranges, *robot.schedule))


def noise_table(values: Mapping[str, Any], robot: RobotSpec) -> FloatArray:
    """The noise (14,) with the columns of :mod:`limslam_env.kernels.readings`, of the values of a
    ``NoiseConfig``.
    """
    names = "sensor_noise", "range_noise_growth", "dropout", "range_resolution", "fold_back", "cone"
    mismatch = values["wheel_mismatch"]
    encoders = (
        1.0 + mismatch,
        1.0 - mismatch,
        values["wheel_variance"],
        values["encoder_resolution"],
        robot.max_wheel_travel,
    )
    axle = robot.axle * (1.0 + values["axle_mismatch"])
    return np.array(
        [
            *(values[name] for name in names),
            *encoders,
            values["slip_rate"],
            values["slip_share"],
            axle,
        ]
    )


class StepDraws:
    """Numbers from N(0, 1) and U(0, 1) for each beam and each wheel of all robots, generated for
    many steps at once.

    A step takes the same numbers whatever the noise is, so that runs with equal seeds can be
    compared in pairs. Beams and wheels have separate generators, so that the number of beams does
    not change the wheels' noise.
    """

    def __init__(
        self,
        ranges: np.random.Generator,
        wheels: np.random.Generator,
        num_robots: int,
        num_beams: int,
    ) -> None:
        self._ranges = ranges
        self._wheels = wheels
        self._num_beams = num_beams
        self._shape = (_BLOCK, num_robots, num_beams + _NUM_WHEELS, 2)
        self._rows: list[FloatArray] = []

    def next(self) -> FloatArray:
        """The numbers of a step, (num_robots, num_beams + 2, 2)."""
        if not self._rows:
            block = np.empty(self._shape)
            beams = block[:, :, : self._num_beams]
            wheels = block[:, :, self._num_beams :]
            for generator, part in ((self._ranges, beams), (self._wheels, wheels)):
                part[..., 0] = generator.standard_normal(part.shape[:-1])
                part[..., 1] = generator.random(part.shape[:-1])
            self._rows = list(block)
        return self._rows.pop()
