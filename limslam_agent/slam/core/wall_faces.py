"""The two faces of a wall: whether a line that is seen from behind is the same line.

A beam hits a wall from one side. A thin board is one line from both sides. A wall of a building is two lines, which are
as far apart as the wall is thick. What was measured of the line decides between the two hypotheses, together with the
kind of the walls for which this is known already: most buildings have walls of one kind.

The functions are scalar and use nothing but :mod:`math`, so that kernels can compile them.
"""

import math

POSITIVE, NEGATIVE = 0, 1
"""Sides of a line from which beams hit it. Its normal points to the positive side."""

THINNEST, THICKEST = 0.05, 0.35
"""Thicknesses of walls, m, within which all thicknesses are equally likely."""

PSEUDO_COUNT = 0.2
"""Prior count of boards and of walls (a Beta distribution). A small count says that a building has one kind."""

SURE = math.log(10.0)
"""Least logarithm of the odds at which a hypothesis is accepted."""

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


def board_odds(evidence: float, boards: int, walls: int) -> float:
    """Logarithm of the posterior odds of a board, given its evidence and the numbers of known boards and walls."""
    return evidence + math.log((boards + PSEUDO_COUNT) / (walls + PSEUDO_COUNT))


def is_wall(evidence: float, behind: float) -> bool:
    """Whether two lines that are seen from opposite sides are the two faces of one wall, by their evidence alone."""
    return evidence < -SURE and 0.0 < behind < THICKEST
