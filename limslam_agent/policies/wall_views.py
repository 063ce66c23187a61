"""Choice of the next stretch of border without a wall, and of the place from which beams can sweep
along it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from limslam_agent.belief import Belief
from limslam_agent.grid.occupancy import GridView
from limslam_agent.grid.planner import Routes, wall_distance
from limslam_agent.grid.unfinished import (
    Faces,
    border_faces,
    in_long_stretches,
    reachable_ground,
    unfinished_faces,
)
from limslam_agent.policies.targets import cells_near_robots, separation_cost, ways_from
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec

# A stretch is looked at in parts. This is the largest distance (m) of a face from the middle of its
# part.
_PART = 0.4
_SHORTEST = 0.15  # m of border without a wall that the robot looks at
# Faces this close (m), that look the same way, are one place of the border.
_SAME_FACE = 0.12
# Cosine of the least steep angle at which a beam may meet the middle of a part, and the other faces
# of the part.
_STEEP = 0.6
_GRAZING = 0.3
# Costs (m of path) of one metre besides the best distance, and of a beam that meets the wall at a
# slant.
_OFF_DISTANCE = 2.0
_SLANT = 1.0
# Distance (m) between the robot's rim and the nearest occupied cell at a place where it turns.
_ROOM = 0.03
# Farthest share of the beams' reach that is used.
_FAR_SHARE = 0.7
# Number of pairs of a place and a face that are tested for a free sight at once, and number of
# points of a sight.
_BATCH = 256
_SIGHT_POINTS = 16
# Number of views of one face that are computed before the face is left alone.
_MOST_VIEWS = 3


@dataclass(frozen=True, eq=False)
class View:
    """A part of a stretch to look at, and from where."""

    faces: Faces  # the faces of the part
    stand: FloatArray  # the place to look from (2,), m
    path: FloatArray  # path to that place (k, 2), m
    cell: float  # length of a face, m

    @property
    def middle(self) -> FloatArray:
        """Middle of the part (2,), m."""
        return np.asarray(self.faces.middles.mean(axis=0))

    @property
    def length(self) -> float:
        """Distance between the outer ends of the part's outermost faces, m."""
        return float(np.hypot(*np.ptp(self.faces.middles, axis=0))) + self.cell

    def bearings(self, place: FloatArray) -> tuple[float, float]:
        """Direction in which the part begins, seen from a place (2,), m, and the angle that it
        fills, rad.
        """
        offset = self.faces.middles - place
        middle = self.middle - place
        centre = math.atan2(middle[1], middle[0])
        turned = wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - centre)
        half = 0.5 * self.cell / max(float(np.hypot(*middle)), self.cell)
        return centre + float(turned.min()) - half, float(np.ptp(turned)) + 2.0 * half


def unfinished_border(belief: Belief) -> Faces:
    """The faces without a wall around the ground that the robot can reach, in stretches that are
    long enough.
    """
    grid = belief.grid
    faces = border_faces(grid, reachable_ground(grid, belief.pose[:2]))
    faces = faces.select(unfinished_faces(faces, belief.segments, grid.cell))
    return faces.select(in_long_stretches(faces, _SHORTEST, grid.cell))


def is_unfinished(belief: Belief, view: View) -> bool:
    """Whether any of a view's faces is still part of the unfinished border."""
    return bool(_same(view.faces, unfinished_border(belief)).any())


def open_border(belief: Belief, looked_at: Sequence[Faces]) -> Faces:
    """The unfinished border without the parts that were looked at, in stretches that are long
    enough.
    """
    border = unfinished_border(belief)
    for faces in looked_at:
        border = border.select(np.logical_not(_same(border, faces).any(axis=1)))
    return border.select(in_long_stretches(border, _SHORTEST, belief.grid.cell))


def next_view(belief: Belief, border: Faces, robot: RobotSpec) -> View | None:
    """The cheapest view of a part of a border that is long enough. None if no place shows one."""
    if not len(border):
        return None
    grid = belief.grid
    ways = _ways(belief, robot)
    cells = np.argwhere(np.isfinite(ways.cost) & (wall_distance(grid) >= robot.radius + _ROOM))
    stands = grid.centres(cells)
    separation = separation_cost(grid, belief.pose, belief.other_poses, belief.other_goals)
    pairs = _by_price(stands, (ways.cost + separation)[cells[:, 0], cells[:, 1]], border, robot)
    views_of = np.zeros(len(border), dtype=np.int64)
    for first in range(0, len(pairs), _BATCH):
        places, numbers = pairs[first : first + _BATCH].T
        chosen = Faces(border.middles[numbers], border.normals[numbers])
        for index in np.flatnonzero(_in_sight(grid, stands[places], chosen)).tolist():
            if views_of[numbers[index]] == _MOST_VIEWS:
                continue
            views_of[numbers[index]] += 1
            view = _view(grid, ways, cells[places[index]], border, int(numbers[index]))
            if view.length >= _SHORTEST:
                return view
    return None


def path_to(belief: Belief, stand: FloatArray, robot: RobotSpec) -> FloatArray | None:
    """Path (k, 2), m, to a place (2,), m. None if there is none."""
    cell = belief.grid.cells(stand[None])
    wanted = np.zeros(belief.grid.values.shape, dtype=bool)
    if not ((cell >= 0) & (cell < wanted.shape)).all():
        return None
    row, column = (int(index) for index in cell[0])
    wanted[row, column] = True
    ways = _ways(belief, robot, wanted)
    return (
        belief.grid.centres(ways.path_to((row, column)))
        if np.isfinite(ways.cost[row, column])
        else None
    )


def _ways(belief: Belief, robot: RobotSpec, wanted: BoolArray | None = None) -> Routes:
    taken = (
        cells_near_robots(belief.grid, belief.other_poses, 2.0 * robot.radius)
        if len(belief.other_poses)
        else None
    )
    return ways_from(belief.pose[:2], belief.grid, robot, targets=wanted, closed=taken)


def _by_price(stands: FloatArray, cost: FloatArray, faces: Faces, robot: RobotSpec) -> IntArray:
    """Pairs (k, 2) of a place and a face that may be looked at from there, cheapest first.

    Parameters
    ----------
    stands, cost
        Places (n, 2), m, and what the paths to them cost (n,), m.
    faces
        What may be looked at.
    robot
        Body and beams.
    """
    farthest = robot.radius + _FAR_SHARE * robot.reach
    # In a large map there are millions of pairs, and few of them are near.
    pairs = cKDTree(stands).sparse_distance_matrix(
        cKDTree(faces.middles), farthest, output_type="ndarray"
    )
    place = pairs["i"]
    face = pairs["j"]
    away = pairs["v"]
    offset = stands[place] - faces.middles[face]
    steepness = np.sum(offset * faces.normals[face], axis=1) / np.maximum(away, 1e-9)
    price = (
        cost[place]
        + _OFF_DISTANCE * np.abs(away - best_distance(robot))
        + _SLANT * (1.0 - steepness)
    )
    is_seen = steepness >= _STEEP
    order = np.lexsort((face[is_seen], place[is_seen], price[is_seen]))
    return np.asarray(np.column_stack((place, face))[is_seen][order])


def best_distance(robot: RobotSpec) -> float:
    """Distance (m) from the middle of the robot at which a wall is best looked at: near, but with
    space to turn.
    """
    return robot.radius + min(0.35, 0.4 * robot.reach)


def _view(grid: GridView, ways: Routes, cell: IntArray, faces: Faces, face: int) -> View:
    """The view from a cell (2,) of a face and of those around it that are visible from there."""
    path = grid.centres(ways.path_to((int(cell[0]), int(cell[1]))))
    stand = path[-1]
    offset = stand - faces.middles
    steep = np.sum(offset * faces.normals, axis=1) >= _GRAZING * np.hypot(*offset.T)
    near = np.hypot(*(faces.middles - faces.middles[face]).T) <= _PART
    part = steep & near & _in_sight(grid, np.broadcast_to(stand, faces.middles.shape), faces)
    part[face] = True
    return View(faces.select(part), stand, path, grid.cell)


def _in_sight(grid: GridView, stands: FloatArray, faces: Faces) -> BoolArray:
    """Whether each face (n,) is visible from its place (n, 2), m, over free cells."""
    shares = np.linspace(0.0, 1.0, _SIGHT_POINTS)[:, None, None]
    ends = faces.middles + 0.5 * grid.cell * faces.normals
    cells = grid.cells((stands + shares * (ends - stands)).reshape(-1, 2))
    cells = np.clip(cells, 0, np.array(grid.values.shape) - 1)
    is_free = (grid.values[cells[:, 0], cells[:, 1]] > 0).reshape(_SIGHT_POINTS, -1)
    # The smoothed normal of a face at a corner may point into the wall.
    return np.asarray(is_free[:-2].all(axis=0))


def _same(faces: Faces, others: Faces) -> BoolArray:
    """Whether each of n faces is at the place of each of m others (n, m)."""
    offset = faces.middles[:, None] - others.middles
    near = np.hypot(offset[..., 0], offset[..., 1]) < _SAME_FACE
    return np.asarray(near & (faces.normals @ others.normals.T > 0.0))
