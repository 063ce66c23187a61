"""Renewal of an online estimate: the last minutes of a drive are smoothed, and joined with the map
from before.

The smoother estimates the lines and the last pose of a stretch of a drive relative to the pose at
its beginning, from the readings of this stretch alone. So they are independent of the map from
before, given that pose, and the two are joined like two local maps (J. Tardos, J. Neira, P. Newman
and J. Leonard, "Robust mapping and localization in indoor environments using sonar data", 2002):
moved to the same frame with the joint covariance, after which the lines of the same wall are made
equal. All readings are used once, and only the map remains of them.

Some errors are the same in each stretch: a few readings at the ends of a wall belong to its
neighbours, for example. Without the ageing of the map they would count as independent each time,
and the map would become surer than it is.
"""

from dataclasses import replace

import numpy as np

from limslam_agent.config.smoother import SmootherConfig
from limslam_agent.kernels.tables import POSE
from limslam_agent.slam.consistent.map_state import MapState, lines_moved_with, poses_moved_with
from limslam_agent.slam.consistent.wall_map import NEW, Wall
from limslam_agent.slam.line_graph.association import Association
from limslam_agent.slam.line_graph.map import contradictions, drawn_pieces, tally
from limslam_agent.slam.line_graph.run import FilteredRun
from limslam_agent.slam.line_graph.smoother import filter_labels, settle
from limslam_env.geometry import FloatArray, IntArray

_SHORTEST = 0.3  # m: least length of a wall that the error of its direction is based on
_CONTRADICTED = 0.01  # share of the beams that go through walls of a wrong map


def renewed(
    start: MapState, stretch: FilteredRun, config: SmootherConfig
) -> tuple[MapState, FloatArray] | None:
    """The state at the end of a stretch of one robot's drive, by all readings since its beginning.

    Parameters
    ----------
    start
        The state at the beginning of the stretch.
    stretch
        The observations since then, and the filter's estimates, which begin at the pose of
        ``start``.
    config
        Settings of the smoother.

    Returns
    -------
    state, poses
        The map from before with the walls of the stretch, which have the number ``NEW``, and the
        last pose; and all poses of the stretch (t, 3). None if the stretch cannot be smoothed, or
        if its beams contradict the result.
    """
    association = settle(stretch, config)
    if association is None or contradictions(association) > _CONTRADICTED:
        return None
    # A wall has some errors in each stretch again, which are about as large as that of a range.
    aged = _aged(start, association.problem.range_std)
    labels = filter_labels(association.problem, stretch)
    return _joined(aged, association, labels), association.state.poses[0]


def _aged(state: MapState, end_std: float) -> MapState:
    """The map with the ends of each wall, m, less certain by a standard deviation, m."""
    variance = end_std**2
    lengths = np.array([np.ptp(wall.extent.ends) for wall in state.walls])
    lengths = np.maximum(lengths, _SHORTEST)
    added = np.column_stack((np.full(len(lengths), 0.5 * variance), 2.0 * variance / lengths**2))
    return replace(state, covariance=state.covariance + np.diag(np.append(np.zeros(POSE), added)))


def _joined(start: MapState, association: Association, labels: IntArray) -> MapState:
    """The map from before, and the walls and the last pose of a stretch, with their joint
    covariance.

    ``labels`` (k,) are the numbers of the landmarks that the filter has taken the readings for, or
    -1.
    """
    state = association.state
    solution = association.solution
    extents = {
        index: extent
        for index, extent in enumerate(tally(association)[0])
        if len(drawn_pieces(extent))
    }
    kept = np.array(list(extents), dtype=int)
    counts = np.bincount(association.labels + 1)[1:]
    lines = state.lines[kept]
    anchors = state.anchors[kept]
    last = state.poses[0, -1]
    nodes = solution.graph.nodes
    columns = np.append(nodes.columns("poses")[-1], nodes.columns("lines")[kept])
    x, y, _ = start.pose.tolist()
    by_start = np.vstack(
        (poses_moved_with((x, y), last[None]), lines_moved_with((x, y), lines, anchors))
    )
    size = len(columns) + 2 * len(start.lines)
    old = np.arange(POSE, POSE + 2 * len(start.lines))
    new = np.append(np.arange(POSE), np.arange(old.size + POSE, size))
    covariance = np.empty((size, size))
    covariance[np.ix_(old, old)] = start.covariance[POSE:, POSE:]
    crossed = by_start @ start.covariance[:POSE, POSE:]
    covariance[np.ix_(new, old)] = crossed
    covariance[np.ix_(old, new)] = crossed.T
    moved = by_start @ start.covariance[:POSE, :POSE] @ by_start.T
    covariance[np.ix_(new, new)] = moved + solution.covariance(columns)
    return MapState(
        pose=last,
        lines=np.vstack((start.lines, lines)),
        anchors=np.vstack((start.anchors, anchors)),
        covariance=covariance,
        walls=[
            *start.walls,
            *(
                Wall(
                    NEW,
                    extents[index],
                    1,
                    int(counts[index]),
                    known_as=_most_frequent(labels[association.labels == index]),
                )
                for index in kept.tolist()
            ),
        ],
    )


def _most_frequent(labels: IntArray) -> int:
    """The most frequent of some labels that are not -1; ``NEW`` if there are none."""
    known = labels[labels >= 0]
    return int(np.bincount(known).argmax()) if len(known) else NEW
