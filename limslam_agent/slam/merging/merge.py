"""Map merging: the decision whether two logs become one map, and the reason if they do not.

A match between the logs is a loop between two chains. It is found, supported, weighted and removed like every other
loop (:mod:`limslam_agent.slam.graph.smooth`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.agreement import LoopVerdict
from limslam_agent.slam.graph.chunk_graph import carry_over
from limslam_agent.slam.graph.smooth import GraphResult, Report, smooth_with_loops
from limslam_agent.slam.merging.chains import Chain, divided, joined_problem
from limslam_agent.slam.merging.placements import Placement, cross_counts, placements
from limslam_agent.slam.merging.placing import Pieces, candidates
from limslam_env.geometry import se2

# Least distance driven between local maps that agree, m: with less, they share most of their readings.
_SPREAD = 8.0
# Least number of points of walls that the other log confirms. Points of overlapping local maps count repeatedly.
_LEAST_POINTS = 600
# Largest share of contradicted points among those that the other log has seen: of a placement, and of the smoothed map.
_PLACED_CONTRADICTED, _JOINED_CONTRADICTED = 0.25, 0.2
_RUNNER_UP = 0.5  # largest value of another placement, as a share of the best one
_LEAST_LOOPS = 3  # between the logs in the smoothed map

NO_MATCH = "no two local maps of one log fit in the other log at places that agree"


@dataclass(frozen=True, eq=False)
class Merging:
    """The decision about two logs.

    Attributes
    ----------
    first, second
        The logs, the second one at its placement.
    joint
        The smoothed map of both logs; None if they are not joined.
    refusal
        Why they are not joined; empty if they are.
    record
        The decision for ``result.json``.
    """

    first: Chain
    second: Chain
    joint: GraphResult | None
    refusal: str
    record: dict[str, Any]


def merge(first: Chain, second: Chain, graph: GraphConfig, report: Report = lambda _: None) -> Merging:
    """Place the second log in the first one, and smooth both as one graph if one placement only fits.

    The joining is taken back if the smoothed map of both logs contradicts itself.
    """
    reach = max(first.data.max_range, second.data.max_range)
    report("both logs, local maps are matched")
    known, local = (Pieces.of(chain, reach) for chain in (first, second))
    ranked = placements(known, local, candidates(known, local))
    if not ranked:
        return Merging(first, second, None, NO_MATCH, {"event": "not joined", "reason": NO_MATCH})
    match, refusal = _figures(ranked, local), _refusal(ranked, local)
    if refusal:
        return Merging(first, second, None, refusal, {"event": "not joined", "reason": refusal, "match": match})
    middles = np.array([each.middle for each in local.maps])
    second = replace(second, smoothed=carry_over(second.keys, second.smoothed, middles, ranked[0].poses))
    joint = smooth_with_loops(*joined_problem(first, second, graph), lambda stage: report(f"both logs, {stage}"))
    checked, contradiction = _checked(joint, first, second, reach)
    if contradiction:
        refusal = f"joined and taken back: {contradiction}"
        record = {"event": "not joined", "reason": refusal, "match": match, **checked}
        return Merging(first, second, None, refusal, record)
    start = joint.trajectory.poses[len(first.keys)].tolist()
    record = {"event": "joined", "reason": "the local maps fit at one place only", "start": start, "match": match}
    return Merging(first, second, joint, "", {**record, **checked})


def cross_loops(joint: GraphResult, first: Chain) -> list[LoopVerdict]:
    """The verdicts on the loops between the logs."""
    border = np.searchsorted(joint.chunk_keys, len(first.keys))
    return [each for each in joint.verdicts if (each.loop.first < border) != (each.loop.second < border)]


def _runner_up(ranked: Sequence[Placement]) -> float:
    """The value of the second-best placement, as a share of the best value."""
    best = ranked[0].value
    return max([0.0, *(each.value for each in ranked[1:])]) / best if best > 0.0 else 1.0


def _figures(ranked: Sequence[Placement], local: Pieces) -> dict[str, Any]:
    best = ranked[0]
    return {
        "pose": se2.compose(best.poses[0], se2.inverse(local.poses[0])).tolist(),
        "score": float(np.mean([each.score for each in best.members])),
        "local_maps": len(best.members),
        "confirmed_points": best.confirmed,
        "contradicted_points": best.contradicted,
        "runner_up": float(_runner_up(ranked)),
    }


def _refusal(ranked: Sequence[Placement], local: Pieces) -> str:
    best = ranked[0]
    if np.ptp([local.maps[each.piece].travel for each in best.members]) < _SPREAD:
        return NO_MATCH
    if best.confirmed < _LEAST_POINTS:
        return f"only {best.confirmed} points of walls fit"
    if best.contradicted_share > _PLACED_CONTRADICTED:
        return f"one log looks through {best.contradicted_share:.0%} of the walls that the other log has seen there"
    if _runner_up(ranked) > _RUNNER_UP:
        return f"ambiguous: another place has {_runner_up(ranked):.0%} of the best score"
    return ""


def _checked(joint: GraphResult, first: Chain, second: Chain, reach: float) -> tuple[dict[str, Any], str]:
    """Figures of a joined map, and why it contradicts itself; empty if it does not."""
    paths = divided(joint.trajectory, first)
    known, local = (
        Pieces.of(replace(chain, smoothed=path), reach) for chain, path in zip((first, second), paths, strict=True)
    )
    confirmed, contradicted = cross_counts(known, local, local.poses)
    share = contradicted / max(confirmed + contradicted, 1)
    loops = cross_loops(joint, first)
    kept = sum(each.kept for each in loops)
    figures = {
        "loops_between": kept,
        "loops_between_found": len(loops),
        "confirmed_points": confirmed,
        "contradicted_points": contradicted,
    }
    if kept < _LEAST_LOOPS:
        return figures, f"only {kept} loops between the logs are left"
    if share > _JOINED_CONTRADICTED:
        return figures, f"one log looks through {share:.0%} of the walls that the other log has seen"
    return figures, ""
