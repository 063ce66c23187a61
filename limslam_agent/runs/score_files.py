"""Scores the trajectory and the map of any SLAM system, from files, by the metrics of
``docs/metrics.md``.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from limslam_agent.output.export import plain
from limslam_agent.output.tum import TrajectoryError, read_rows, read_tum
from limslam_agent.safe_files import load_arrays
from limslam_env import metrics
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.se2 import compose, inverse, transform_points, turned
from limslam_env.interface import RobotSpec
from limslam_env.worlds.world import World

# Covariances in single precision have eigenvalues that are negative by this share.
_ROUNDING = 1e-5
# The estimate of a path is neither larger nor smaller than the path by this factor.
_SIZE = 2.0
_UPPER = (0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)


@dataclass(frozen=True, eq=False)
class Pairs:
    """True and estimated poses (n, 3) at the same times, m and rad, and covariances (n, 3, 3) of
    the estimated ones.

    ``unmatched`` counts the estimated poses without a true pose at their time.
    """

    true: FloatArray
    estimated: FloatArray
    covariances: FloatArray | None
    unmatched: int

    def doubts(self) -> list[str]:
        """What the files may be that makes the scores say little: a sentence each."""
        poses = len(self.true)
        found = []
        if self.unmatched > poses:
            found.append(
                f"only {poses} of {poses + self.unmatched} estimated poses have a true one at "
                "their time: are all times in s, and of one clock?"
            )
        true, estimated = (
            float(np.linalg.norm(part[:, :2].std(axis=0))) for part in (self.true, self.estimated)
        )
        if poses > 2 and not true / _SIZE <= estimated <= true * _SIZE:
            found.append(
                f"the estimated poses scatter by {estimated:.3g} m, and the true ones by "
                f"{true:.3g} m: are both in m?"
            )
        return found

    def alignment(self, how: str) -> FloatArray:
        """The rigid motion (3,) that brings the frame of the estimate onto the frame of the truth,
        m and rad.

        ``none`` is no motion: both have one frame. ``start`` lets both paths begin in the same
        pose. ``path`` brings the whole path onto the true path
        (:func:`limslam_env.metrics.rigid_alignment`).
        """
        if how == "start":
            return compose(self.true[0], inverse(self.estimated[0]))
        if how == "path":
            return metrics.rigid_alignment(self.true[:, :2], self.estimated[:, :2])
        return np.zeros(3)

    def moved(self, motion: FloatArray) -> "Pairs":
        """The same with the frame of the estimate moved by a rigid motion (3,)."""
        covariances = None if self.covariances is None else turned(self.covariances, motion[2])
        return replace(self, estimated=compose(motion, self.estimated), covariances=covariances)


def read_pairs(
    true: Path, estimated: Path, covariances: Path | None, max_difference: float = 0.01
) -> Pairs:
    """Read two trajectories and, if it is given, a file with the covariances of the estimated one.

    As in evo, each pose of the trajectory with fewer poses belongs to the pose of the longer one
    that is nearest in time, if that is at most ``max_difference`` away, s.

    Raises
    ------
    TrajectoryError
        If a file cannot be used, or no times agree.
    """
    true_time, true_poses = read_tum(true)
    time, poses = read_tum(estimated)
    of_true, of_estimated = matched(true_time, time, max_difference)
    if len(of_true) == 0:
        raise TrajectoryError(
            f"{estimated}: no pose has the time of a pose of {true} (within {max_difference:g} s)"
        )
    stated = None if covariances is None else read_covariances(covariances, estimated, time)
    return Pairs(
        true_poses[of_true],
        poses[of_estimated],
        None if stated is None else stated[of_estimated],
        len(time) - len(np.unique(of_estimated)),
    )


def matched(
    first: FloatArray, second: FloatArray, max_difference: float
) -> tuple[IntArray, IntArray]:
    """Indices (k,) into two lists of times, s, of the times that belong together."""
    if len(second) > len(first):
        shorter, longer = matched(second, first, max_difference)[::-1]
        return shorter, longer
    distance, nearest = cKDTree(first[:, None]).query(second[:, None])
    near = np.flatnonzero(distance <= max_difference)
    return np.asarray(nearest)[near], near


def read_covariances(path: Path, trajectory: Path, time: FloatArray) -> FloatArray:
    """Covariances (n, 3, 3), m and rad, of the poses of a trajectory in the same frame as its
    poses.

    The file is ``covariance_est.npz`` of a run's folder, or a text with a line ``t xx xy xh yy yh
    hh`` for each pose, where h is the heading. Comments begin with ``#``.

    Raises
    ------
    TrajectoryError
        If the file cannot be read, does not have a covariance for each pose, or one is not positive
        semi-definite.
    """
    found = _stored(path, trajectory) if path.suffix == ".npz" else _written(path)
    if len(found) != len(time):
        raise TrajectoryError(
            f"{path}: has {len(found)} covariances, and {trajectory} has {len(time)} poses"
        )
    if not np.isfinite(found).all():
        raise TrajectoryError(f"{path}: a covariance is not finite")
    least, _, largest = np.linalg.eigvalsh(found).T
    is_one = least >= -_ROUNDING * largest
    if not is_one.all():
        raise TrajectoryError(
            f"{path}: the numbers at {time[np.argmin(is_one)]:.10g} s are no covariance, because "
            "an eigenvalue is negative"
        )
    return found


def trajectory_scores(pairs: Pairs) -> dict[str, float | int | None]:
    """Errors of the estimate, and where covariances are given whether they are as large as the
    errors.
    """
    scores: dict[str, float | int | None] = {
        "poses": len(pairs.true),
        "poses_unmatched": pairs.unmatched,
        "path_m": metrics.path_length(pairs.true),
        **metrics.trajectory_metrics(pairs.true, pairs.estimated),
    }
    if pairs.covariances is not None:
        scores |= plain(metrics.consistency_metrics(pairs.true, pairs.estimated, pairs.covariances))
    return scores


def map_scores(
    world: World, robot: RobotSpec, walls: FloatArray, motion: FloatArray, pairs: Pairs | None
) -> dict[str, float | int | None]:
    """Scores of the walls of a map (m, 4), m, whose frame is first moved by a rigid motion (3,).

    The metrics of an aligned map take the alignment of the trajectories ``pairs``, which belong to
    the map. Without trajectories there are none of them. The robot says which walls can be seen.
    """
    segments = transform_points(motion, walls.reshape(-1, 2)).reshape(-1, 4)
    visible = metrics.visible_samples(world, robot.radius, robot.reach)
    alignment = np.zeros(3) if pairs is None else pairs.moved(motion).alignment("path")
    scores = metrics.wall_metrics(visible, world.edges, segments, alignment)
    if pairs is None:
        scores = {name: value for name, value in scores.items() if "aligned" not in name}
    return {
        **scores,
        "doors_open": metrics.doors_open(world.doors, segments),
        "landmarks": len(segments),
    }


def _stored(path: Path, trajectory: Path) -> FloatArray:
    """The covariances of a run's folder that go with a trajectory: smoothed or not, of one of
    several robots.
    """
    kind = "smoothed" if "smoothed" in trajectory.stem else "estimated"
    number = trajectory.stem.rpartition("_")[2]
    try:
        arrays = load_arrays(path, (kind,))
        found = np.asarray(arrays[kind], dtype=float)
        return found[:, int(number) if number.isdigit() else 0]
    except KeyError as error:
        raise TrajectoryError(f"{path}: has no array {kind}") from error
    except IndexError as error:
        raise TrajectoryError(f"{path}: has no covariances of robot {number}") from error
    except (OSError, ValueError) as error:
        raise TrajectoryError(f"{path}: cannot be read: {error}") from error


def _written(path: Path) -> FloatArray:
    _, table = read_rows(path, "t xx xy xh yy yh hh")
    found = np.empty((len(table), 3, 3))
    for column, (row_index, other) in enumerate(_UPPER, start=1):
        found[:, row_index, other] = found[:, other, row_index] = table[:, column]
    return found
