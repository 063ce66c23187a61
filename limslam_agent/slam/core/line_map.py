"""A landmark as the estimators hand it on."""

from dataclasses import dataclass

from limslam_env.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class Landmark:
    """A landmark at one moment.

    Attributes
    ----------
    r, theta
        The line in the world, m and rad.
    covariance
        Of (r, theta), (2, 2).
    ends
        End points (2, 2), m.
    observations
        Number of observed lines that the landmark was estimated from.
    number
        Identifies the landmark; an older landmark has a smaller number.
    segments
        Which rows of the map's segments lie on this landmark. Empty for a provisional landmark.
    """

    r: float
    theta: float
    covariance: FloatArray
    ends: FloatArray
    observations: int
    number: int = 0
    segments: tuple[int, ...] = ()
