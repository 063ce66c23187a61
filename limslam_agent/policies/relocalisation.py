"""Active relocalisation: a lost robot explores where it learns most about its place.

The places where a lost robot may be predict what lies beyond its frontiers: free ground or walls, or nothing, where the
earlier map knows nothing. What the robot learns by looking at a cell is the mutual information of the cell's state and
of the place (D. Fox, W. Burgard and S. Thrun, "Active Markov localization for mobile robots", 1998). It is large where
the likely places predict different things, or where the only likely place predicts something at all, since ground that
the earlier map does not have may look alike.
"""

import numpy as np

from limslam_agent.belief import Belief, Guess
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import transform_points

_AROUND = 0.7  # m: how far around a frontier cell the robot looks
_STEP = 0.2  # m: between the points that are compared
_GUESSES = 6  # number of the likeliest places that are compared
_FREE = 0.95, 0.6  # probability that a point is free: where a place predicts that, and where nothing is known
_LARGEST = 2.0  # log odds of a place: more are an overconfident likelihood
_ENOUGH = 0.03  # mean information of a point, nats, from which on a frontier costs nothing more
_TURN = 1.0  # m of path: cost of a frontier at the robot's side, and half of that of one behind it
_PRICE = 3.0  # m of path: cost of a frontier that tells the robot nothing about its place


def search_cost(belief: Belief, cells: BoolArray) -> FloatArray:
    """Additional cost (rows, columns), m, of frontier cells of a mask (rows, columns) for a lost robot; 0 otherwise.

    A cell costs more the less the robot learns there about its place, and if the robot must turn back to it.
    """
    total = np.zeros(cells.shape)
    if belief.status.level == "lost":
        at = np.argwhere(cells)
        cost = _TURN * (1.0 - _ahead(belief, at))
        if belief.guesses:
            cost += _PRICE * (1.0 - np.minimum(_information(belief, at) / _ENOUGH, 1.0))
        total[at[:, 0], at[:, 1]] = cost
    return total


def _ahead(belief: Belief, cells: IntArray) -> FloatArray:
    """Cosine (n,) of the angle between the robot's heading and the direction to cells (n, 2)."""
    x, y, heading = belief.pose.tolist()
    off = belief.grid.centres(cells) - np.array([x, y])
    return np.asarray((off @ [np.cos(heading), np.sin(heading)]) / np.maximum(np.hypot(*off.T), 1e-9))


def _information(belief: Belief, cells: IntArray) -> FloatArray:
    """Mean information (n,), nats, about the place in the unknown points around cells (n, 2)."""
    side = np.arange(-_AROUND, _AROUND + 0.5 * _STEP, _STEP)
    disc = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    disc = disc[np.hypot(*disc.T) <= _AROUND]
    points = (belief.grid.centres(cells)[:, None] + disc).reshape(-1, 2)
    is_new = belief.grid.values_at(points) == 0
    guesses = sorted(belief.guesses, key=lambda guess: -guess.log_odds)[:_GUESSES]
    # The last hypothesis is ground that the earlier map does not have.
    odds = np.exp([*(min(guess.log_odds, _LARGEST) for guess in guesses), 0.0])
    shares = (odds / odds.sum())[:, None]
    free = np.array([*(_predicted(guess, points) for guess in guesses), np.full(len(points), _FREE[1])])
    known = _entropy((shares * free).sum(axis=0)) - (shares * _entropy(free)).sum(axis=0)
    return np.asarray(np.where(is_new, known, 0.0).reshape(len(cells), -1).mean(axis=1))


def _predicted(guess: Guess, points: FloatArray) -> FloatArray:
    """Probability (n,) that points (n, 2) of the present frame are free if a guess is right."""
    values = guess.grid.values_at(transform_points(guess.pose, points))
    sure, unknown = _FREE
    return np.where(values > 0, sure, np.where(values < 0, 1.0 - sure, unknown))


def _entropy(free: FloatArray) -> FloatArray:
    """Entropy (n,), nats, of events of these probabilities (n,)."""
    return np.asarray(-free * np.log(free) - (1.0 - free) * np.log(1.0 - free))
