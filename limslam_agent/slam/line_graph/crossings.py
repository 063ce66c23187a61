"""Where beams meet lines: the line that predicts each reading best, and the beams that passed
through lines.

Lines are (d, alpha) about one anchor each, as in :mod:`limslam_agent.slam.line_graph.factors`. A
place along a line is its distance from the anchor, m. All is plain numpy: a run asks for it a few
times, and compiling would take longer than that.
"""

from collections.abc import Iterator

import numpy as np

from limslam_agent.kernels.tables import BIN, GRAZING
from limslam_agent.slam.line_graph.factors import rays
from limslam_agent.slam.line_graph.line_merging import NEGATIVE, POSITIVE
from limslam_agent.slam.line_graph.problem import State
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.line import direction, normal

_AT_ONCE = 4096  # beams that are compared with all lines at once, so that little memory is needed


def best_lines(
    state: State,
    places: IntArray,
    beams: FloatArray,
    distances: FloatArray,
    ends: FloatArray,
    beyond: float,
    width: float,
) -> tuple[IntArray, FloatArray]:
    """For each reading, the line that predicts it best, among the lines that the beam meets near
    enough.

    Parameters
    ----------
    state
        Poses, and the m lines.
    places, beams, distances
        Numbers of the poses (k,), beams on the body (k, 3), and readings (k,), m.
    ends, beyond, width
        Ends (m, 2, 2) of the part of each line that was read from each side, m, the distance beyond
        the ends at which a beam may meet it, and half the opening angle of the beams, rad.

    Returns
    -------
    best, misfits
        The line (k,), and the misfits of the reading to the best and the second line (k, 2), m,
        infinite without one.
    """
    best = np.zeros(len(places), dtype=np.int64)
    misfits = np.full((len(places), 2), np.inf)
    if not len(state.lines):
        return best, misfits
    low = ends[..., 0] - beyond
    high = ends[..., 1] + beyond
    for part, cosines, reached, along in _meetings(state, places, beams, width):
        faces_beam = cosines < 0.0
        is_near = along >= np.where(faces_beam, low[:, POSITIVE], low[:, NEGATIVE])
        is_near &= along <= np.where(faces_beam, high[:, POSITIVE], high[:, NEGATIVE])
        off = np.where(is_near, np.abs(reached - distances[part, None]), np.inf)
        rows = np.arange(len(off))
        best[part] = off.argmin(axis=1)
        misfits[part, 0] = off[rows, best[part]]
        off[rows, best[part]] = np.inf
        misfits[part, 1] = off.min(axis=1)
    return best, misfits


def count_crossings(
    state: State,
    places: IntArray,
    beams: FloatArray,
    distances: FloatArray,
    low: IntArray,
    hits: IntArray,
    margin: float,
) -> tuple[IntArray, FloatArray]:
    """Count the beams that passed through each bin (m, b) of the lines, and say how much each of
    them (k,) contradicts a wall.

    A beam passed through a line if it reached more than ``margin`` beyond it, m along the line's
    normal. It passed through a wall if beams ended in that bin of the line, and in one of the two
    adjacent bins on each side of it. Where more beams passed than ended, those that ended are the
    contradiction, as where somebody stood for a moment: all that passed there count as much as
    these.

    Parameters
    ----------
    state, places, beams
        As of :func:`best_lines`.
    distances
        Length of the free path of each beam (k,), m.
    low, hits
        First bin (m,) of each line, and the number of beams that ended in each bin (m, b), 0 beyond
        a line's last bin.
    """
    misses = np.zeros_like(hits)
    is_wall = np.zeros(hits.shape, dtype=bool)
    before = hits[:, :-4] + hits[:, 1:-3]
    after = hits[:, 3:-1] + hits[:, 4:]
    is_wall[:, 2:-2] = (hits[:, 2:-2] > 0) & (before > 0) & (after > 0)
    passed = [np.zeros(0, dtype=np.intp)]
    crossed = [np.zeros((2, 0), dtype=np.int64)]
    for part, cosines, reached, along in _meetings(state, places, beams, 0.0):
        bins = np.floor(along / BIN).astype(np.int64) - low
        is_crossed = (reached + margin / np.abs(cosines) < distances[part, None]) & (bins >= 0)
        beam, line = np.nonzero(is_crossed & (bins < hits.shape[1]))
        passed.append(part.start + beam)
        crossed.append(np.stack((line, bins[beam, line])))
    line, place = np.concatenate(crossed, axis=1)
    np.add.at(misses, (line, place), 1)
    against = np.zeros(len(places))
    shares = np.minimum(hits / np.maximum(misses, 1), 1.0)
    np.maximum.at(against, np.concatenate(passed), (is_wall * shares)[line, place])
    return misses, against


def _meetings(
    state: State, places: IntArray, beams: FloatArray, width: float
) -> Iterator[tuple[slice, FloatArray, FloatArray, FloatArray]]:
    """Some beams at a time: which, and for each of them (k,) and each line (m,), the cosine of the
    angle between beam and normal, the distance at which they meet, infinite if they do not, and
    where along the line, both in m (k, m).

    Beams with half an opening angle ``width``, rad, meet a line at its nearest point inside of
    them.
    """
    across = normal(state.lines)
    tangents = direction(state.lines)
    height = state.lines[:, 0] + (across * state.anchors).sum(axis=1)
    middle = (tangents * state.anchors).sum(axis=1)
    for first in range(0, len(places), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        origins, ahead = rays(state.flat_poses[places[part]], beams[part])
        cosines = ahead @ across.T
        is_met: BoolArray = np.abs(cosines) >= GRAZING
        cosines[~is_met] = 1.0
        away = height - origins @ across.T
        slants = np.arctan((ahead @ tangents.T) / cosines)
        slants -= np.clip(slants, -width, width)
        along = origins @ tangents.T + away * np.tan(slants) - middle
        reached = away * np.sign(cosines) / np.cos(slants)
        reached[~is_met | (reached <= 0.0)] = np.inf
        yield part, cosines, reached, along
