"""Stretches that a robot drove backwards, in logs whose odometry never says so.

Encoders with a single channel count distances without a sign, and so do some converted logs: on
``fr079`` odometry says "ahead" for all of its 393 m, and the robot drove backwards over 6.8 m.
Such a stretch of 3 m is an error of 6 m, which no model of noise explains.

A robot can change its direction only where it stops. After a stop it sees the walls that it has
seen before the stop again: from where it has been before, if it drives backwards, and from ahead
otherwise. Both are tried.

New ground ahead fits worse than known ground behind in any case, above all in corridors and halls.
So a log is changed only if driving ahead contradicts what was seen in several stretches: walls
would stand where there was free space.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.map_graph.chunk_graph import SCORES
from limslam_agent.slam.map_graph.key_poses import STANDING, LogData, integrate, to_world
from limslam_agent.slam.map_graph.local_maps import draw_grid, thinned
from limslam_agent.slam.map_graph.matching import (
    LEAST_POINTS,
    NO_MATCH,
    SearchGrid,
    Window,
    match,
    search_grid,
)
from limslam_env.geometry import FloatArray, IntArray, se2

AFTER = 2.0
"""Distance driven after an event, m, that is compared with half a chunk before it."""
_LEAST_PERIOD = 0.2  # s, over which a speed is measured
_SLOW = 0.35  # the robot may turn round where it is slower than this share of its median speed
LEAST_LENGTH = 0.15
"""Shorter stretches, m, are not judged. Odometry that reports less driving backwards in all has no
sign.
"""
_BEYOND = 1.0  # m of driving after a short stretch that are compared with it
_WINDOW = Window(0.4, math.radians(9.0))
# A stretch was driven backwards if this fits, and better than driving ahead by the lead and by this
# for each metre, since in a corridor both directions fit.
_LEAD = 0.12
_LEAD_PER_METRE = 0.06


def with_reversing(data: LogData, config: GraphConfig) -> LogData:
    """The log with the motions turned round that the ranges say were driven backwards.

    A log whose odometry reports driving backwards itself stays as it is, and so does a log whose
    beams reach less far than what is compared, or one in which nearly no stretch contradicts that
    it was driven ahead.
    """
    if data.max_range < AFTER or -data.moves[:, 0].clip(max=0.0).sum() >= LEAST_LENGTH:
        return data
    views = _LocalViews(data, config)
    stretches = _stretches(data, views.driven)
    judged = [_judged(views, *each) for each in stretches.tolist()]
    if sum(_is_proof(each, config) for each in judged) < config.reversing.fewest:
        return data
    begins, ends = views.travel[stretches.T]
    leads = np.array([lead for lead, _ in judged])
    turned = np.zeros(len(judged), dtype=np.bool_)
    reach = config.maps.half + AFTER
    while leads.max(initial=0.0) > 0.0:
        best = leads.argmax()
        leads[best] = NO_MATCH
        turned[best] = True
        _turn_round(views, *stretches[best])
        # The stretches whose comparison uses this stretch are judged again.
        near = (begins <= ends[best] + reach) & (ends >= begins[best] - reach) & ~turned
        leads[near] = [_judged(views, *each)[0] for each in stretches[near].tolist()]
    return (
        replace(data, odometry=integrate(data.odometry[0], views.moves)) if turned.any() else data
    )


def driven_backwards(
    data: LogData, config: GraphConfig, after: int
) -> Iterator[tuple[int, int, bool]]:
    """Stretches at the end of a drive that look reversed: first and last event, and whether that is
    a proof.

    Those are judged, in their order, that begin at the event ``after`` or later, and at least a
    metre before the end of the data. Of a stretch that is turned round already, what was driven
    since then is part.
    """
    if data.max_range < AFTER:
        return
    views = _LocalViews(data, config)
    latest = views.travel[-1] - _BEYOND
    for begin, end in _stretches(data, views.driven).tolist():
        backwards = views.moves[begin:end, 0].clip(max=0.0)
        if -backwards.sum() >= LEAST_LENGTH:
            rest = end - int((backwards[::-1] < 0.0).argmax())
            if views.driven[end] - views.driven[rest] > STANDING:
                yield rest, end, False
        elif begin >= after and views.travel[begin] <= latest:
            judged = _judged(views, begin, end)
            if judged[0] > 0.0:
                _turn_round(views, begin, end)
                yield begin, end, _is_proof(judged, config)


class _LocalViews:
    """What was seen along a log, whose metres are matched in a window.

    Attributes
    ----------
    moves
        Motions (n - 1, 3) from event to event. They may be changed.
    driven
        Length (n,) of the path up to each event, m.
    travel
        The same, with ``APART`` for each break of odometry.
    """

    def __init__(self, data: LogData, config: GraphConfig) -> None:
        self._data = data
        self._maps = config.maps
        self.moves = data.moves.copy()
        lengths = np.hypot(self.moves[:, 0], self.moves[:, 1])
        self.driven = np.append(0.0, np.cumsum(lengths))
        self.travel = np.append(0.0, np.cumsum(lengths + data.apart[1:]))

    def known(self, event: int) -> SearchGrid | None:
        """What was seen in the last metres before an event, in the frame of its pose. None if that
        is too little.
        """
        first = int(np.searchsorted(self.travel, self.travel[event] - self._maps.half))
        poses = integrate(np.zeros(3), self.moves[first:event])
        places, origins = self._seen(np.arange(first, event + 1), se2.between(poses[-1], poses))
        if len(places) < LEAST_POINTS:
            return None
        grid = draw_grid(places, origins, self._data.max_range, self._maps)
        return search_grid(grid, self._maps.cell, _WINDOW.shift)

    def next_moves(self, event: int, most: float = AFTER) -> FloatArray:
        """A copy of the motions (k, 3) of the first metres after an event, of at most ``most``
        m.
        """
        end = np.searchsorted(self.travel, self.travel[event] + min(AFTER, most), side="right")
        return self.moves[event : end - 1].copy()

    def fit(self, known: SearchGrid, event: int, moves: FloatArray) -> tuple[float, float]:
        """How well that fits which was seen from an event on, along motions (k, 3).

        The score of the best match, and the share of the points that it places where only free
        space was seen before.
        """
        events = np.arange(event, event + len(moves) + 1)
        places, _ = self._seen(events, integrate(np.zeros(3), moves))
        points = thinned(places, self._maps.cell)
        found = match(known, points, np.zeros(3), _WINDOW, NO_MATCH)
        cells = known.at(se2.transform_points(found.pose, points))
        return found.score, float(np.mean(cells < 0)) if len(cells) else 0.0

    def _seen(self, events: IntArray, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points and origins of their beams, (p, 2) each, at events (k,) with poses (k, 3)."""
        row, beam = np.nonzero(self._data.hit[events])
        places = to_world(poses[row], self._data.points[events[row], beam])
        return places, to_world(poses[row], self._data.origins[beam])


def _turn_round(views: _LocalViews, begin: int, end: int) -> None:
    views.moves[begin:end, :2] *= -1.0


def _is_proof(judged: tuple[float, float], config: GraphConfig) -> bool:
    """Whether a stretch that was judged contradicts that it was driven ahead."""
    return judged[0] > 0.0 and judged[1] >= config.reversing.contradicted


def reversed_distance(data: LogData, directed: LogData) -> tuple[float, int]:
    """Distance that is driven backwards in the second log and not in the first one, m, and the
    number of stretches.
    """
    before, after = (each.moves[:, 0] for each in (data, directed))
    moved = np.abs(before) > STANDING
    before = before[moved]
    after = after[moved]
    backwards = (after < 0.0) & (before > 0.0)
    begins = backwards & ~np.append(False, backwards[:-1])
    return float(before[backwards].sum()), int(begins.sum())


def _judged(views: _LocalViews, begin: int, end: int) -> tuple[float, float]:
    """By how much a stretch fits better than is needed if it was driven backwards.

    Also the share of its points that would lie in free space if it was driven ahead.
    """
    known = views.known(begin)
    length = float(views.travel[end] - views.travel[begin])
    if known is None:
        return NO_MATCH, 0.0
    moves = views.next_moves(begin, length + _BEYOND)
    ahead, contradicted = views.fit(known, begin, moves)
    moves[: end - begin, :2] *= -1.0
    backwards, _ = views.fit(known, begin, moves)
    lead = backwards - ahead - _LEAD - _LEAD_PER_METRE * length
    return (lead if backwards >= SCORES[0] else NO_MATCH), contradicted


def _stretches(data: LogData, travel: FloatArray) -> IntArray:
    """First and last event (k, 2) of the stretches between stops. At a break of odometry, a robot
    may have stopped.
    """
    speeds = _speeds(np.maximum.accumulate(data.time), travel)
    driving = speeds[np.diff(travel) > 0.0]
    moving = (
        speeds >= _SLOW * np.median(driving)
        if len(driving)
        else np.zeros(len(speeds), dtype=np.bool_)
    )
    moving[data.breaks - 1] = False
    changes = np.diff(np.concatenate(([False], moving, [False])).astype(np.int64))
    found = np.column_stack((np.flatnonzero(changes > 0), np.flatnonzero(changes < 0)))
    return np.asarray(found[travel[found[:, 1]] - travel[found[:, 0]] >= LEAST_LENGTH])


def _speeds(time: FloatArray, travel: FloatArray) -> FloatArray:
    """Mean speeds (n - 1,) between events, m/s, each over ``_LEAST_PERIOD`` at least.

    Odometry that is read twice at nearly the same time, for itself and with a scan, has not stopped
    in between.
    """
    middles = 0.5 * (time[1:] + time[:-1])
    half = 0.5 * np.maximum(np.diff(time), _LEAST_PERIOD)
    ends = np.interp(middles + half, time, travel)
    return np.asarray((ends - np.interp(middles - half, time, travel)) / (2.0 * half))
