"""Range sensors: what the beams would measure, and what noise makes of it."""

from dataclasses import dataclass

import numpy as np

from limslam_env.config import DrawnNoise
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.segment import distances as segment_distances
from limslam_env.interface import RobotSpec
from limslam_env.kernels import cast_rays

CELL = 0.5


@dataclass(frozen=True, eq=False)
class WallIndex:
    """Walls sorted by where they can be seen from, so that a ray looks at few of them.

    Attributes
    ----------
    edges
        (k, 4), m.
    cell_starts, cell_edges
        The walls in reach of each cell, as ``kernels.cast_rays`` reads them.
    grid
        (4,): lower left corner x, y, cell side (m), and the number of rows.
    columns
        Number of columns.
    """

    edges: FloatArray
    cell_starts: IntArray
    cell_edges: IntArray
    grid: FloatArray
    columns: int

    def cast(
        self,
        origins: FloatArray,
        directions: FloatArray,
        lengths: FloatArray,
        owners: IntArray,
        discs: FloatArray,
        disc_radius: float,
    ) -> tuple[FloatArray, IntArray]:
        """Distances (n,), m, and hits (n,) of rays; see :func:`limslam_env.kernels.cast_rays`."""
        distances, hits = np.empty(len(origins)), np.empty(len(origins), dtype=np.int64)
        cast_rays(
            origins, directions, lengths, owners, self.edges, self.cell_starts, self.cell_edges,
            self.grid, self.columns, discs, disc_radius, distances, hits,
        )  # fmt: skip
        return distances, hits


def build_wall_index(edges: FloatArray, reach: float) -> WallIndex:
    """Sort walls (k, 4) for rays of up to ``reach`` (m)."""
    low = np.minimum(edges[:, :2], edges[:, 2:]).min(axis=0) - CELL
    high = np.maximum(edges[:, :2], edges[:, 2:]).max(axis=0) + CELL
    columns, rows = np.ceil((high - low) / CELL).astype(int)
    radius = reach + CELL * np.sqrt(0.5) + 1e-6
    pairs = []
    for number, edge in enumerate(edges):
        first = np.maximum(np.floor((np.minimum(edge[:2], edge[2:]) - radius - low) / CELL).astype(int), 0)
        last = np.minimum(np.ceil((np.maximum(edge[:2], edge[2:]) + radius - low) / CELL).astype(int), (columns, rows))
        row, column = (part.ravel() for part in np.mgrid[first[1] : last[1], first[0] : last[0]])
        centres = low + (np.column_stack((column, row)) + 0.5) * CELL
        near = segment_distances(centres, edge[None])[:, 0] <= radius
        pairs.append(np.column_stack((row[near] * columns + column[near], np.full(near.sum(), number))))
    cells, owners = np.vstack(pairs).T
    order = np.lexsort((owners, cells))
    counts = np.bincount(cells, minlength=rows * columns)
    starts = np.concatenate(([0], np.cumsum(counts)))
    grid = np.array([low[0], low[1], CELL, rows])
    return WallIndex(np.ascontiguousarray(edges), starts, owners[order], grid, int(columns))


@dataclass(frozen=True, eq=False)
class Rays:
    """The beams of all robots as rays that start inside the bodies.

    A beam's origin lies on the rim, which touches a wall when the robot does; a ray from there
    could start behind the wall. So each starts at the point of its own line next to the
    robot's centre, ``offsets`` metres before the origin.

    Attributes
    ----------
    origins, directions
        (n, 2), m and unit vectors, robot after robot.
    offsets
        (n,), m, to be taken off a measured distance.
    owners
        (n,), the robot that each belongs to.
    """

    origins: FloatArray
    directions: FloatArray
    offsets: FloatArray
    owners: IntArray


def beam_rays(poses: FloatArray, robot: RobotSpec) -> Rays:
    """The rays of robots at poses (m, 3)."""
    mounts, ahead = robot.beam_origins, robot.beam_directions
    offsets = np.maximum(np.einsum("bd,bd->b", mounts, ahead), 0.0)
    inner = mounts - offsets[:, None] * ahead
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    rotations = np.stack((np.stack((cos, -sin), -1), np.stack((sin, cos), -1)), -2)
    origins = poses[:, None, :2] + np.einsum("mij,bj->mbi", rotations, inner)
    directions = np.einsum("mij,bj->mbi", rotations, ahead)
    owners = np.repeat(np.arange(len(poses)), len(ahead))
    return Rays(origins.reshape(-1, 2), directions.reshape(-1, 2), np.tile(offsets, len(poses)), owners)


def noisy_ranges(
    ideal: FloatArray, hits: IntArray, robot: RobotSpec, noise: DrawnNoise, generator: np.random.Generator
) -> FloatArray:
    """Readings (n_beams,), m, of one robot from ideal distances.

    The same number of draws is made at every noise level, so that runs of one seed are pairs.
    A beam that hits nothing reads its maximum exactly.
    """
    drawn = generator.standard_normal(len(ideal))
    reading = np.where(hits == -1, robot.max_ranges, ideal + noise.sensor_noise * drawn)
    reading = np.where(generator.random(len(ideal)) < noise.dropout, robot.max_ranges, reading)
    return np.clip(reading, robot.min_ranges, robot.max_ranges)
