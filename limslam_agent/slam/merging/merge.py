"""Map merging: the decision whether two logs become one map, and the reason if they do not."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.agreement import visit_counts
from limslam_agent.slam.graph.key_poses import Trajectory
from limslam_agent.slam.merging.chains import Chain
from limslam_agent.slam.merging.joint_graph import JointMap, joint_map
from limslam_agent.slam.merging.placements import CrossScore, Placement, placements
from limslam_agent.slam.merging.placing import Pieces, candidates
from limslam_env.geometry import FloatArray, se2

# Least distance driven between local maps that agree, m: with less, they share most of their readings.
_SPREAD = 8.0
# Least number of points of walls that the other log confirms. Points of overlapping local maps count repeatedly.
_LEAST_POINTS = 600
# Largest share of contradicted points among those that the other log has seen: of a placement, and of the smoothed map.
_PLACED_CONTRADICTED, _JOINED_CONTRADICTED = 0.25, 0.2
_RUNNER_UP = 0.5  # largest value of another placement, as a share of the best one
# That value counts only for a share of itself if more points contradict the other placement than the best one, by this
# difference of the shares of contradicted points.
_DISCOUNT, _DISCOUNTED = 0.5, 0.03
_LEAST_LOOPS = 3  # between the logs in the smoothed map
_FALL = 0.1  # largest fall of the score G of each log by itself

NO_MATCH = "no two local maps of one log fit in the other log at places that agree"


@dataclass(frozen=True, eq=False)
class Merging:
    """The decision about two logs.

    Attributes
    ----------
    joint
        The map of both logs; None if they are not joined.
    refusal
        Why they are not joined; empty if they are.
    record
        The decision for ``result.json``.
    """

    joint: JointMap | None
    refusal: str
    record: dict[str, Any]


def merge(
    first: Chain,
    second: Chain,
    graph: GraphConfig,
    report: Callable[[str], None] = lambda _: None,
) -> Merging:
    """Place the second log in the first one, and smooth both as one graph if one placement only fits.

    The joining is taken back if the smoothed map of both logs contradicts itself.
    """
    reach = max(first.data.max_range, second.data.max_range)
    report("both logs, local maps are matched")
    known, local = (Pieces.of(chain, reach) for chain in (first, second))
    ranked = placements(known, local, candidates(known, local))
    if not ranked:
        return Merging(None, NO_MATCH, {"event": "not joined", "reason": NO_MATCH})
    best = ranked[0]
    runner_up = _runner_up(best, ranked[1:])
    record = _figures(best, local, runner_up)
    refusal = _refusal(best, local, runner_up)
    if refusal:
        return Merging(None, refusal, {"event": "not joined", "reason": refusal, "match": record})
    joint = joint_map(first, second, known, local, best, graph, report)
    checked, refusal = _checked(joint, reach, graph)
    if refusal:
        taken_back = f"joined and taken back: {refusal}"
        return Merging(None, taken_back, {"event": "not joined", "reason": taken_back, "match": record, **checked})
    start = joint.trajectory.poses[len(first.keys)]
    details = {"start": start.tolist(), "match": record, **checked}
    return Merging(joint, "", {"event": "joined", "reason": "the local maps fit at one place only", **details})


def _runner_up(best: Placement, others: Sequence[Placement]) -> float:
    """The value of the best other placement, as a share of the best value."""
    limit = best.contradicted_share + _DISCOUNTED
    values = [each.value * (_DISCOUNT if each.contradicted_share > limit else 1.0) for each in others]
    worth = best.value
    return max(*values, 0.0, 0.0) / worth if worth > 0.0 else 1.0


def _figures(best: Placement, local: Pieces, runner_up: float) -> dict[str, Any]:
    motion = se2.compose(best.poses[0], se2.inverse(local.poses[0]))
    return {
        "pose": motion.tolist(),
        "score": float(np.mean([each.score for each in best.members])) if best.members else 0.0,
        "local_maps": len(best.members),
        "confirmed_points": best.confirmed,
        "contradicted_points": best.contradicted,
        "runner_up": float(runner_up),
    }


def _refusal(best: Placement, local: Pieces, runner_up: float) -> str:
    travel = [local.maps[each.piece].travel for each in best.members]
    if not travel or max(travel) - min(travel) < _SPREAD:
        return NO_MATCH
    if best.confirmed < _LEAST_POINTS:
        return f"only {best.confirmed} points of walls fit"
    if best.contradicted_share > _PLACED_CONTRADICTED:
        return f"one log looks through {best.contradicted_share:.0%} of the walls that the other log has seen there"
    if runner_up > _RUNNER_UP:
        return f"ambiguous: another place has {runner_up:.0%} of the best score"
    return ""


def _checked(joint: JointMap, reach: float, graph: GraphConfig) -> tuple[dict[str, Any], str]:
    """Figures of a joined map, and why it contradicts itself; empty if it does not."""
    chains = _smoothed_chains(joint)
    known, local = (Pieces.of(chain, reach) for chain in chains)
    confirmed, contradicted = CrossScore.of(known, local)(local.poses)
    share = contradicted / max(confirmed + contradicted, 1)
    kept = sum(each.kept for each in joint.cross_loops)
    falls = [
        _own_score(before, graph) - _own_score(after, graph)
        for before, after in zip((joint.first, joint.second), chains, strict=True)
    ]
    figures = {
        "loops_between": kept,
        "loops_between_found": len(joint.cross_loops),
        "confirmed_points": confirmed,
        "contradicted_points": contradicted,
        "score_changes": [-float(fall) for fall in falls],
    }
    if kept < _LEAST_LOOPS:
        return figures, f"only {kept} loops between the logs are left"
    if share > _JOINED_CONTRADICTED:
        return figures, f"one log looks through {share:.0%} of the walls of the other log"
    if max(falls) > _FALL:
        which = ("first", "second")[int(np.argmax(falls))]
        return figures, f"the map of the {which} log agrees less with itself"
    return figures, ""


def _smoothed_chains(joint: JointMap) -> tuple[Chain, Chain]:
    count, bias = len(joint.first.keys), joint.trajectory.bias
    poses: list[FloatArray] = [joint.trajectory.poses[:count], joint.trajectory.poses[count:]]
    one, other = (
        replace(chain, smoothed=Trajectory(part, bias))
        for chain, part in zip((joint.first, joint.second), poses, strict=True)
    )
    return one, other


def _own_score(chain: Chain, graph: GraphConfig) -> float:
    """G of one log alone."""
    confirmed, contradicted = visit_counts(chain.keys, chain.smoothed, graph, chain.data.max_range).shares
    return confirmed - contradicted
