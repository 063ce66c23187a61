"""Whether the ranges of a log fit its odometry better if the log is read in another way.

A wrong order of the beams, a laser that is mounted backwards, exchanged wheels, or a heading that counts clockwise
makes a map that is wrong everywhere, and nothing in the log says so. But what is seen next then does not fit what was
seen just before, and it does if the log is read rightly. On ``csail`` and ``fr079`` the mean score of this comparison
is 0.35 to 0.49 with four to six beams, and 0.18 to 0.30 for logs that were read wrongly.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.key_poses import LogData
from limslam_agent.slam.graph.local_views import AFTER, BEFORE, LocalViews
from limslam_agent.slam.graph.matching import NO_MATCH, Window
from limslam_env.geometry import FloatArray, se2

_MOST_PLACES = 60
_WINDOW = Window(0.2, np.radians(4.0), np.radians(2.0))

FEWEST_PLACES = 10
"""Fewer comparisons than these say nothing."""

LEAST_LEAD, LEAST_SIGMAS = 0.08, 2.5
"""Another reading is better if its mean score leads by this, and by so many standard errors of the difference."""


@dataclass(frozen=True)
class _Reading:
    """Another way to read a log: the log as it would be then, and the question to its owner."""

    read: Callable[[LogData], LogData]
    question: str


def misread(data: LogData, config: GraphConfig, *, by_wheels: bool = False) -> str:
    """What fits better than the log as it was read, as a sentence; empty if nothing does.

    The odometry of ``data`` may have been computed from wheel travel.
    """
    places = _places(data, config)
    if len(places) < FEWEST_PLACES:
        return ""
    plain = _scores(data, places, config)
    best, found = 0.0, ""
    for other in _OF_WHEELS if by_wheels else _OF_POSES:
        leads = _scores(other.read(data), places, config) - plain
        leads = leads[np.isfinite(leads)]
        if len(leads) < FEWEST_PLACES:
            continue
        mean, error = float(leads.mean()), float(leads.std()) / np.sqrt(len(leads))
        if mean > max(best, LEAST_LEAD, LEAST_SIGMAS * error):
            best, found = mean, f"the ranges fit odometry better {other.question}"
    return found


def _places(data: LogData, config: GraphConfig) -> list[int]:
    """Events at which what is seen next is compared with what was seen before."""
    travel = LocalViews(data, config, _WINDOW).travel
    apart = max(AFTER, travel[-1] / _MOST_PLACES)
    return [int(each) for each in np.searchsorted(travel, np.arange(BEFORE, travel[-1] - AFTER, apart))]


def _scores(data: LogData, places: list[int], config: GraphConfig) -> FloatArray:
    """The score (k,) at each event; NaN where too little was seen."""
    views = LocalViews(data, config, _WINDOW)
    return np.array([_score(views, place) for place in places])


def _score(views: LocalViews, place: int) -> float:
    known, moves = views.known(place), views.next_moves(place)
    if known is None or not len(moves):
        return np.nan
    score = views.fit(known, place, moves).score
    return score if score > NO_MATCH else np.nan


def _mirrored(data: LogData) -> LogData:
    return replace(data, angles=-data.angles, origins=data.origins * np.array([1.0, -1.0]))


def _looking_back(data: LogData) -> LogData:
    return replace(data, angles=se2.wrap_angle(data.angles + np.pi), origins=-data.origins)


def _mirrored_ahead(data: LogData) -> LogData:
    return replace(data, angles=se2.wrap_angle(np.pi - data.angles), origins=data.origins * np.array([-1.0, 1.0]))


def _clockwise(data: LogData) -> LogData:
    return replace(data, odometry=data.odometry * np.array([1.0, 1.0, -1.0]))


def _mirrored_places(data: LogData) -> LogData:
    return replace(data, odometry=data.odometry * np.array([1.0, -1.0, 1.0]))


_LOOKING_BACK = _Reading(
    _looking_back, "if the beams look the other way: is the sensor mounted backwards, or ahead negative?"
)
_OF_POSES = (
    _Reading(_mirrored, "with left and right exchanged: are the beams in the wrong order, or is odometry mirrored?"),
    _LOOKING_BACK,
    _Reading(_clockwise, "with a heading of the other sign: does the heading of odometry count clockwise?"),
    _Reading(_mirrored_places, "with y of the other sign: does y of odometry point to the right?"),
)
# A robot whose wheels are exchanged drives the mirrored path. One whose encoders count backwards drives the path that
# is mirrored across its axle.
_OF_WHEELS = (
    _Reading(_mirrored, "with left and right exchanged: are the wheels exchanged, or the beams in the wrong order?"),
    _LOOKING_BACK,
    _Reading(_mirrored_ahead, "with ahead and back exchanged: do the encoders of both wheels count backwards?"),
)
