"""The two faces of a wall: whether a line that is seen from behind is the same line.

A beam hits a wall from one side. A thin board is one line from both sides. A wall of a building is two lines, which are
as far apart as the wall is thick. What was measured of the line decides between the two hypotheses, together with the
kind of the walls for which this is known already: most buildings have walls of one kind.

The rows "drive 4 cm" and "thick walls" of the scoreboard feel the numbers below.
"""

import math

POSITIVE, NEGATIVE = 0, 1
"""Sides of a line from which beams hit it. Its normal points to the positive side."""

THINNEST, THICKEST = 0.05, 0.35
"""Thicknesses of walls, m, within which all thicknesses are equally likely."""

PRIOR_LENGTH = 0.05
"""Length of boards and of walls that is taken as known before any is, m (a Beta distribution).

A small length says that most buildings have one kind.
"""

LEAST_SHARE = 1.0 / 3.0
"""Least prior odds of a board: however many walls a building has, it also has doors and partitions."""

SURE = math.log(100.0)
"""Least logarithm of the odds of a board. A false board bends the map, and a missed one is found later."""

SURE_OF_WALL = math.log(10.0)
"""Least logarithm of the Bayes factor of a wall against a board."""

ELSEWHERE = 0.1
"""Density of lines that are something else than this wall, 1/m: a line in front of a face is no proof of a board."""


def board_evidence(behind: float, variance: float) -> float:
    """Logarithm of the Bayes factor of a board against a wall.

    Parameters
    ----------
    behind, variance
        How far the line that is seen from one side lies behind the line that is seen from the other side, m, and the
        variance of that, m^2.
    """
    std = math.sqrt(variance)
    nearer = math.erf((THINNEST - behind) / (math.sqrt(2.0) * std))
    farther = math.erf((THICKEST - behind) / (math.sqrt(2.0) * std))
    wall = 0.5 * (farther - nearer) / (THICKEST - THINNEST) + ELSEWHERE
    return -0.5 * behind * behind / variance - math.log(math.sqrt(2.0 * math.pi) * std) - math.log(wall)


def board_odds(evidence: float, boards: float, walls: float) -> float:
    """Logarithm of the posterior odds of a board, given its evidence and the lengths of known boards and walls, m."""
    return evidence + math.log(max((boards + PRIOR_LENGTH) / (walls + PRIOR_LENGTH), LEAST_SHARE))


def is_wall(evidence: float, behind: float) -> bool:
    """Whether two lines that are seen from opposite sides are the two faces of one wall, by their evidence alone."""
    return evidence < -SURE_OF_WALL and 0.0 < behind < THICKEST
