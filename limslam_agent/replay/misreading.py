"""Whether the ranges of a log fit its odometry better if the log is read in another way.

A wrong order of the beams, a laser that is mounted backwards, exchanged wheels, or a heading that
counts clockwise makes a map that is wrong everywhere, and nothing in the log says so. But what is
seen next then does not fit what was seen just before, and it does if the log is read rightly. On
``csail`` and ``fr079`` the mean score of this comparison is 0.35 to 0.49 with four to six beams,
and 0.18 to 0.30 for logs that were read wrongly.
"""

from dataclasses import replace

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.key_poses import LogData
from limslam_agent.slam.graph.local_views import AFTER, BEFORE, LocalViews
from limslam_agent.slam.graph.matching import NO_MATCH, Window
from limslam_env.geometry import FloatArray

_MOST_PLACES = 60
_WINDOW = Window(0.2, np.radians(4.0), np.radians(2.0))
_FEWEST_PLACES = 10  # fewer comparisons than these say nothing
# Another reading is better if its mean score leads by this, and by so many standard errors of the
# difference.
_LEAST_LEAD, _LEAST_SIGMAS = 0.08, 2.5


def misread(data: LogData, config: GraphConfig, *, by_wheels: bool = False) -> str:
    """What fits better than the log as it was read, as a sentence; empty if nothing does.

    The odometry of ``data`` may have been computed from wheel travel.
    """
    places = _places(data, config)
    if len(places) < _FEWEST_PLACES:
        return ""
    plain = _scores(data, places, config)
    best, found = 0.0, ""
    for question, signs in (_OF_WHEELS if by_wheels else _OF_POSES).items():
        leads = _scores(_read(data, *signs), places, config) - plain
        leads = leads[np.isfinite(leads)]
        if len(leads) < _FEWEST_PLACES:
            continue
        mean, error = float(leads.mean()), float(leads.std()) / np.sqrt(len(leads))
        if mean > max(best, _LEAST_LEAD, _LEAST_SIGMAS * error):
            best, found = mean, f"the ranges fit odometry better {question}"
    return found


def _places(data: LogData, config: GraphConfig) -> list[int]:
    """Events at which what is seen next is compared with what was seen before."""
    driven = LocalViews(data, config, _WINDOW).driven
    apart = max(AFTER, driven[-1] / _MOST_PLACES)
    return [
        int(each) for each in np.searchsorted(driven, np.arange(BEFORE, driven[-1] - AFTER, apart))
    ]


def _scores(data: LogData, places: list[int], config: GraphConfig) -> FloatArray:
    """The score (k,) at each event; NaN where too little was seen."""
    views = LocalViews(data, config, _WINDOW)
    return np.array([_score(views, place) for place in places])


def _score(views: LocalViews, place: int) -> float:
    known, moves = views.known(place), views.next_moves(place)
    if known is None or not len(moves):
        return np.nan
    score, _ = views.fit(known, place, moves)
    return score if score > NO_MATCH else np.nan


def _read(
    data: LogData, beams: tuple[float, float], odometry: tuple[float, float, float]
) -> LogData:
    """The log with signs of x and y of its beams, and of x, y and heading of its odometry."""
    x, y = beams
    angles = np.arctan2(y * np.sin(data.angles), x * np.cos(data.angles))
    return replace(
        data, angles=angles, origins=data.origins * beams, odometry=data.odometry * odometry
    )


_KEPT = (1.0, 1.0, 1.0)
_LOOKING_BACK = {
    "if the beams look the other way: is the sensor mounted backwards, or ahead negative?": (
        (-1.0, -1.0),
        _KEPT,
    )
}
# Other ways to read a log, by the question to its owner: signs as in ``_read``.
_OF_POSES = {
    "with left and right exchanged: are the beams in the wrong order, or is odometry mirrored?": (
        (1.0, -1.0),
        _KEPT,
    ),
    **_LOOKING_BACK,
    "with a heading of the other sign: does the heading of odometry count clockwise?": (
        (1.0, 1.0),
        (1.0, 1.0, -1.0),
    ),
    "with y of the other sign: does y of odometry point to the right?": (
        (1.0, 1.0),
        (1.0, -1.0, 1.0),
    ),
}
# A robot whose wheels are exchanged drives the mirrored path. One whose encoders count backwards
# drives the path that is mirrored across its axle.
_OF_WHEELS = {
    "with left and right exchanged: are the wheels exchanged, or the beams in the wrong order?": (
        (1.0, -1.0),
        _KEPT,
    ),
    **_LOOKING_BACK,
    "with ahead and back exchanged: do the encoders of both wheels count backwards?": (
        (-1.0, 1.0),
        _KEPT,
    ),
}
