"""Settings of the status: when an estimate is unsure or lost.

All values are choices of this project, tuned on seeds that are not reported. Lengths are in metres, angles in radians.
"""

from dataclasses import dataclass, field
from typing import Annotated

from limslam_agent.config.bounds import Bounded, Bounds, Count, NonNegative, Positive, Share


@dataclass(frozen=True)
class ContradictionConfig(Bounded):
    """When a reading contradicts the map.

    Attributes
    ----------
    inset
        A beam should end at a wall if it meets the wall at least this far inside the wall's ends, m.
    sigmas, slack
        A beam has passed through a wall if its reading exceeds the expected range by more than this number of standard
        deviations plus ``slack``, m.
    least_cosine
        Beams whose angle to the wall's normal has a smaller cosine are not compared with the wall.
    free, free_cells
        A beam has ended in free space if all cells around its end have at least the value ``free``, up to this number
        of cells to each side, and no wall of the map is near its end. A wall is near if its distance is less than
        ``sigmas`` standard deviations of a range plus ``slack``. Walls are corrected when a loop is closed, and the
        grid is not.
    """

    inset: NonNegative = 0.10
    sigmas: NonNegative = 3.0
    slack: NonNegative = 0.10
    least_cosine: Share = 0.35
    free: Count = 4
    free_cells: Annotated[int, Bounds(0, 100)] = 2


@dataclass(frozen=True)
class StatusConfig(Bounded):
    """All settings of the status. Most of its numbers are constants beside the code.

    Attributes
    ----------
    contradictions
        When a reading contradicts the map.
    max_jump
        The estimate is lost if the odometry reports a longer motion in one step, m.
    """

    contradictions: ContradictionConfig = field(default_factory=ContradictionConfig)
    max_jump: Positive = 1.0
