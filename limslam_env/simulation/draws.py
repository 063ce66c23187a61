"""Random numbers for the steps of an episode, generated for many steps at once."""

import numpy as np

from limslam_env.geometry import FloatArray

_BLOCK = 64
_NUM_WHEELS = 2


class StepDraws:
    """Numbers from N(0, 1) and U(0, 1) for each beam and each wheel of all robots.

    A step takes the same numbers whatever the noise is, so that runs with equal seeds can be compared in pairs.

    Parameters
    ----------
    ranges, wheels
        Separate generators for beams and wheels, so that the number of beams does not change the wheels' noise.
    num_robots, num_beams
        How many there are.
    """

    def __init__(
        self, ranges: np.random.Generator, wheels: np.random.Generator, num_robots: int, num_beams: int
    ) -> None:
        self._ranges, self._wheels, self._num_beams = ranges, wheels, num_beams
        self._shape = (_BLOCK, num_robots, num_beams + _NUM_WHEELS, 2)
        self._rows: list[FloatArray] = []

    def next(self) -> FloatArray:
        """The numbers of a step, (num_robots, num_beams + 2, 2)."""
        if not self._rows:
            block = np.empty(self._shape)
            beams, wheels = block[:, :, : self._num_beams], block[:, :, self._num_beams :]
            for generator, part in ((self._ranges, beams), (self._wheels, wheels)):
                part[..., 0] = generator.standard_normal(part.shape[:-1])
                part[..., 1] = generator.random(part.shape[:-1])
            self._rows = list(block)
        return self._rows.pop()
