"""Metrics of data association: of observed lines, of landmarks, and of beams that hit another robot. Pure functions."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limslam_env.geometry import BoolArray, IntArray

_ROBOT = -2


@dataclass(frozen=True)
class AssociationEvent:
    """One observed line, and the landmark that it was matched to or (``is_new``) that was created from it."""

    landmark: int
    is_new: bool
    true_walls: tuple[int, ...]  # for each reading in the line, the index of the wall hit; -1 nothing, -2 a robot


def association_metrics(events: Sequence[AssociationEvent], wall_count: int) -> dict[str, float | None]:
    """How often observed lines got the right landmark, judged by the walls (``wall_count`` of them) truly hit.

    An observation's true wall is the one that more than half of its readings hit, a landmark's that of the
    observation that created it. Where either has none there is no right answer: such events are mixed.

    Counts (int) of ``association_right``, ``association_wrong`` (matched to another wall's landmark),
    ``association_new`` (rightly), ``association_wrongly_new`` (the wall had a landmark), ``association_mixed``;
    ``association_right_share`` is the share of right and rightly new among all not mixed, None if there are none.
    """
    counts = dict.fromkeys(("right", "wrong", "wrongly_new", "new", "mixed"), 0)
    wall_of: dict[int, int | None] = {}
    for event in events:
        wall = _majority(event.true_walls, wall_count)
        known = wall if event.is_new else wall_of.get(event.landmark)
        if wall is None or known is None:
            verdict = "mixed"
        elif event.is_new:
            verdict = "wrongly_new" if wall in wall_of.values() else "new"
        else:
            verdict = "right" if wall == known else "wrong"
        counts[verdict] += 1
        wall_of[event.landmark] = known
    judged = len(events) - counts["mixed"]
    share = (counts["right"] + counts["new"]) / judged if judged else None
    return {**{f"association_{name}": count for name, count in counts.items()}, "association_right_share": share}


def closure_metrics(
    events: Sequence[AssociationEvent], closures: Sequence[tuple[int, int]], wall_count: int
) -> dict[str, int]:
    """How many of the merged pairs of landmarks truly belong to one wall.

    Counts of ``closures_right``, ``closures_wrong`` and ``closures_mixed``: a landmark's true wall is that of the
    observation that created it, and where either has none there is no right answer.
    """
    wall_of = {event.landmark: _majority(event.true_walls, wall_count) for event in events if event.is_new}
    counts = dict.fromkeys(("right", "wrong", "mixed"), 0)
    for older, younger in closures:
        first, second = wall_of.get(older), wall_of.get(younger)
        is_known = first is not None and second is not None
        counts[("right" if first == second else "wrong") if is_known else "mixed"] += 1
    return {f"closures_{name}": count for name, count in counts.items()}


def dropped_beam_metrics(dropped: BoolArray, wall_seen: IntArray) -> dict[str, float | None]:
    """How beams that hit another robot were classified, and how many other beams were rejected.

    ``robot_beams_dropped`` is the share of the beams on robots that were left out, ``robot_beams_dropped_wrongly`` the
    share of what was left out that had hit no robot, both None where there is nothing to share. ``dropped`` and
    ``wall_seen`` have one shape; -2 in the latter is a robot.
    """
    on_robot = wall_seen == _ROBOT
    hits, left_out = int(np.count_nonzero(on_robot)), int(np.count_nonzero(dropped))
    return {
        "robot_beams_dropped": float(np.count_nonzero(dropped & on_robot)) / hits if hits else None,
        "robot_beams_dropped_wrongly": float(np.count_nonzero(dropped & ~on_robot)) / left_out if left_out else None,
    }


def _majority(walls: tuple[int, ...], wall_count: int) -> int | None:
    """The wall that more than half of the readings hit; None if there is none."""
    if walls and max(walls) >= wall_count:
        raise ValueError(f"a reading of wall {max(walls)}, but there are {wall_count} walls")
    counts = np.bincount([wall for wall in walls if wall >= 0], minlength=1)
    return int(np.argmax(counts)) if 2 * counts.max() > len(walls) else None
