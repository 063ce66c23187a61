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
from limslam_agent.slam.map_graph.agreement import supported
from limslam_agent.slam.map_graph.chunk_graph import (
    KEPT,
    KEPT_WEIGHT,
    NO_SUPPORT,
    OUTVOTED,
    Hops,
    Loop,
    carry_over,
    inflated,
    relations_of,
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
from limslam_agent.slam.map_graph.smoothing import (
    bundle,
    cautious_graph,
    motion_covariances,
    smooth_locally,
)
from limslam_env.geometry import FloatArray, IntArray, se2

# How often the delay of the ranges is estimated and corrected before the search. A correction of
# less, s, is the last.
_SYNCHRONISATIONS = 3
_SYNCHRONOUS = 0.02


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
    while True:
        if has_loops:
            found = smooth_with_loops(keys, local, trajectory, report)
        else:
            kind = "local" if has_points else "odometry"
            none = np.zeros(1, dtype=np.int64)
            found = GraphResult(kind, keys, local, local.bias, [], none)
        trajectory = found.trajectory
        placed = trajectory.moved(np.asarray(start, dtype=float))
        yield replace(found, trajectory=placed, errors=joined_bias(known, found.errors))
        if not has_loops:
            return


def _synchronised(data: LogData, config: GraphConfig) -> tuple[KeyPoses, Trajectory, FloatArray]:
    """The log with its odometry at the times of the ranges, its local trajectory, and what was
    corrected (5,).

    The motions between key poses are linear in the delay for short delays only, so the delay is
    estimated repeatedly.
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
    return keys, local, known


def smooth_with_loops(
    keys: KeyPoses, local: Trajectory, trajectory: Trajectory, report: Report
) -> GraphResult:
    """Find the loops between chunks that are cut from a trajectory, and solve for all key poses.

    The trajectory ``local`` without loops tells how well the motions between the chunks are known.
    """
    maps = keys.config.maps
    report("search for loops")
    middles = chunk_middles(keys, maps.hop)
    poses = trajectory.poses[middles]
    covariances = motion_covariances(cautious_graph(keys, local), local.poses, middles)
    hops = Hops(se2.between(poses[:-1], poses[1:]), inflated(covariances))
    found = search_loops(cut_chunks(keys, trajectory, middles), poses[0], hops, maps)
    good = supported(found, poses, keys.key_travel[middles], maps.hop)
    loops = [loop for loop, agreed in zip(found, good, strict=True) if agreed]
    report(f"all poses, {len(loops)} loops")
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


def _between_keys(loops: Sequence[Loop], middles: IntArray) -> Relations:
    """The loops that are kept, between chunks with the middles (c,), as relations between key
    poses.
    """
    ends, relative, information = relations_of([loop for loop in loops if loop.reason == KEPT])
    return middles[ends], relative, information
