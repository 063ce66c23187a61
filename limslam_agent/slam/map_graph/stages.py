"""The smoothing of a log: all stages of the graph of local maps in order. No stage uses the ground
truth.

The log is solved in a frame in which it begins at the origin, and the result is then transformed to
the start pose. The result therefore does not depend on the start pose.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.factors import Relations
from limslam_agent.slam.map_graph.agreement import judged_together, visit_counts
from limslam_agent.slam.map_graph.chunk_graph import (
    KEPT_WEIGHT,
    Hops,
    carry_over,
    inflated,
    search_loops,
    solve_annealed,
)
from limslam_agent.slam.map_graph.key_poses import (
    ERRORS,
    KeyPoses,
    LogData,
    Trajectory,
    choose_keys,
    delayed,
    event_poses,
    joined_bias,
    odometry_trajectory,
)
from limslam_agent.slam.map_graph.local_maps import chunk_middles, cut_chunks
from limslam_agent.slam.map_graph.loops import (
    KEPT,
    NO_SUPPORT,
    OUTVOTED,
    Loop,
    relations_of,
    supported,
)
from limslam_agent.slam.map_graph.posterior import (
    covariance_in,
    with_learned_errors,
    with_learned_noise,
)
from limslam_agent.slam.map_graph.smoothing import (
    bundle,
    cautious_graph,
    motion_covariances,
    odometry_graph,
    smooth_locally,
)
from limslam_env.geometry import FloatArray, IntArray, se2

# How often the delay of the ranges is estimated and corrected before the search. A correction of
# less, s, is the last.
_SYNCHRONISATIONS = 3
_SYNCHRONOUS = 0.02
# How often the noise of odometry is learned, as long as its variance falls below this share
_LEARNED = 3
_BETTER = 0.5
_CAUTION = 2.0  # of the variances of odometry alone, where they limit those of hops
# Where visits contradict each other, hops as near as this, in lengths of chunks, have these further
# standard deviations, m and rad
_BENT_WITHIN = 3.0
_BENT_STDS = 0.3, 0.3, 0.25


@dataclass(frozen=True, eq=False)
class GraphResult:
    """A smoothed log, or two logs that were smoothed as one."""

    # what the path follows: ``loops``, ``local`` (odometry and the walls along the way) or
    # ``odometry``
    kind: str
    # keys, trajectory: the key poses and their trajectory
    keys: KeyPoses = field(repr=False)
    trajectory: Trajectory = field(repr=False)
    errors: FloatArray  # the estimated constant errors (5,) of odometry, as in :class:`Trajectory`
    loops: list[Loop]  # all loops that were found
    chunk_keys: IntArray  # the key poses (c,) in the middle of the chunks
    # the trajectory without loops, by which the noise of odometry is learned
    local: Trajectory | None = field(default=None, repr=False)

    @property
    def learned(self) -> KeyPoses:
        """The key poses with the noise and the constant errors that odometry has by the ranges."""
        if self.local is None or len(self.keys) < 2 or len(self.keys.point_event) == 0:
            return self.keys
        keys = with_learned_noise(self.keys, self.local, cautious_graph)
        return with_learned_errors(keys, self.local, cautious_graph(keys, self.local))

    @property
    def poses(self) -> FloatArray:
        """Poses (n, 3) of all events."""
        return event_poses(self.keys, self.trajectory)

    @property
    def relations(self) -> Relations:
        """The loops that are part of the result, as relations between key poses."""
        return _between_keys(self.loops, self.chunk_keys)


Report = Callable[[str], None]
"""Called with the stage that begins, in words."""


def saying(where: str, report: Report) -> Report:
    """A report that names the place before each stage."""
    return lambda stage: report(f"{where}, {stage}")


def rounds(
    data: LogData, start: FloatArray, config: GraphConfig, report: Report
) -> Iterator[GraphResult]:
    """Smooth a log after its end, and again without an end: each path gives better local maps for
    the next search.

    A log without loops has one round.

    Parameters
    ----------
    data
        The recorded log.
    start
        Pose (3,) of the first event in the frame of the result.
    config
        The settings; the defaults serve all logs.
    report
        Called at the start of each stage.
    """
    report("local smoothing")
    keys, local, known = _synchronised(data, config)
    trajectory = local
    has_points = len(keys.point_event) > 0
    has_loops = has_points and len(chunk_middles(keys, config.maps.hop)) > 1
    doubtful = np.zeros(0, dtype=np.int64)
    covariances = hop_covariances(keys, local) if has_loops else np.zeros((0, 3, 3))
    while True:
        if has_loops:
            found = smooth_with_loops(keys, covariances, trajectory, report, doubtful)
            doubtful = visit_counts(keys, found.trajectory).doubtful()
        else:
            kind = "local" if has_points else "odometry"
            none = np.zeros(1, dtype=np.int64)
            found = GraphResult(kind, keys, local, local.bias, [], none)
        trajectory = found.trajectory
        placed = trajectory.moved(np.asarray(start, dtype=float))
        yield replace(
            found, trajectory=placed, errors=joined_bias(known, found.errors), local=local
        )
        if not has_loops:
            return


def _synchronised(data: LogData, config: GraphConfig) -> tuple[KeyPoses, Trajectory, FloatArray]:
    """The log with its odometry at the times of the ranges, its local trajectory, and what was
    corrected (5,).

    The motions between key poses are linear in the delay for short delays only, so the delay is
    estimated repeatedly. Where odometry is better than is assumed, its noise is then learned, and
    all is smoothed again: walls that are not straight would bend the path otherwise.
    """
    known = np.zeros(ERRORS)
    delay = 0.0
    for _ in range(_SYNCHRONISATIONS):
        data = delayed(data, delay)
        known = known + np.array([0.0, 0.0, 0.0, delay, 0.0])
        keys = choose_keys(data, config)
        local = odometry_trajectory(keys, np.zeros(3))
        if len(keys) > 1 and len(keys.point_event):
            local = smooth_locally(keys, local)
        delay = float(local.bias[3])
        if abs(delay) < _SYNCHRONOUS:
            break
    has_points = len(keys) > 1 and len(keys.point_event) > 0
    for _ in range(_LEARNED if has_points else 0):
        exact = with_learned_noise(keys, local, cautious_graph)
        if exact.step_variances[:, 2].sum() > _BETTER * keys.step_variances[:, 2].sum():
            break
        keys = exact
        narrow = with_learned_errors(keys, local)
        local = smooth_locally(narrow, odometry_trajectory(keys, np.zeros(3)))
    return keys, local, known


def by_odometry(found: GraphResult, start: FloatArray) -> tuple[GraphResult, FloatArray]:
    """The path of odometry alone of a log that was smoothed, and the covariance (2 k, 2 k) of its
    positions, by what the log says of its odometry.
    """
    keys = found.learned
    path = odometry_trajectory(keys, np.asarray(start, dtype=float))
    covariance = covariance_in(odometry_graph(keys, path), keys, path)
    return replace(found, kind="odometry", trajectory=path, errors=path.bias, loops=[]), covariance


def smooth_with_loops(
    keys: KeyPoses,
    covariances: FloatArray,
    trajectory: Trajectory,
    report: Report,
    doubtful: IntArray | None = None,
) -> GraphResult:
    """Find the loops between chunks that are cut from a trajectory, and solve for all key poses.

    The motions between the chunks have the covariances (c - 1, 3, 3) of :func:`hop_covariances`.
    Around ``doubtful`` key poses, where visits of a place contradict each other, they are bent.
    """
    maps = keys.config.maps
    report("search for loops")
    middles = chunk_middles(keys, maps.hop)
    poses = trajectory.poses[middles]
    if doubtful is not None and len(doubtful):
        travel = keys.key_travel
        away = np.abs(travel[middles[1:], None] - travel[doubtful]).min(axis=1)
        bent = away < _BENT_WITHIN * maps.length
        covariances = covariances + bent[:, None, None] * np.diag(np.square(_BENT_STDS))
    hops = Hops(se2.between(poses[:-1], poses[1:]), covariances)
    chunks = cut_chunks(keys, trajectory, middles)
    found = search_loops(chunks, poses[0], hops, maps)
    good = supported(found, poses, keys.key_travel[middles], maps.hop)
    loops = [loop for loop, agreed in zip(found, good, strict=True) if agreed]
    report(f"all poses, {len(loops)} loops")
    solved, _ = solve_annealed(poses[0], hops, loops)
    loops = judged_together(loops, solved, chunks, maps)
    solved, weights = solve_annealed(poses[0], hops, loops)
    judged = [
        replace(loop, reason=KEPT if weight > KEPT_WEIGHT else OUTVOTED)
        for loop, weight in zip(loops, weights, strict=True)
    ]
    judged += [
        replace(loop, reason=NO_SUPPORT)
        for loop, agreed in zip(found, good, strict=True)
        if not agreed
    ]
    moved = carry_over(keys, trajectory, middles, solved)
    smoothed = bundle(keys, moved, _between_keys(judged, middles))
    return GraphResult("loops", keys, smoothed, smoothed.bias, judged, middles)


def hop_covariances(keys: KeyPoses, local: Trajectory) -> FloatArray:
    """Covariances (c - 1, 3, 3) of the motions between chunks by the local graph, which are at most
    those by odometry alone, with its constant errors as far as the log tells them.
    """
    middles = chunk_middles(keys, keys.config.maps.hop)
    keys = with_learned_errors(keys, local, cautious_graph(keys, local))
    by_links, by_odometry = (
        motion_covariances(graph(keys, local), local.poses, middles)
        for graph in (cautious_graph, odometry_graph)
    )
    information = np.linalg.inv(inflated(by_links)) + np.linalg.inv(_CAUTION * by_odometry)
    return np.asarray(np.linalg.inv(information))


def _between_keys(loops: Sequence[Loop], middles: IntArray) -> Relations:
    """The loops that are kept, between chunks with the middles (c,), as relations between key
    poses.
    """
    ends, relative, information = relations_of([loop for loop in loops if loop.reason == KEPT])
    return middles[ends], relative, information
