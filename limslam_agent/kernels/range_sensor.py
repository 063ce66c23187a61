"""What a range sensor reads of a wall, in compiled code: its opening angle, its bias and its noise."""

import math

from limslam_agent.kernels.compilation import compiled


@compiled
def read_share(cosine: float, width: float) -> float:
    """The share of its distance that a wall reads, given the cosine between the beam and the wall's normal.

    The beam has half an opening angle ``width``, rad. It reads the nearest point of the wall inside of it.
    """
    if width == 0.0:
        return 1.0
    steep, sine = abs(cosine), math.sqrt(max(1.0 - cosine * cosine, 0.0))
    turned = steep * math.cos(width) + sine * math.sin(width)
    return steep if sine <= math.sin(width) else steep / turned


@compiled
def reading_of(sensor: tuple[float, float, float, float], distance: float, cosine: float) -> tuple[float, float]:
    """The range, m, that a sensor reads of a wall at a distance along the middle of its beam, and its variance, m^2.

    ``sensor`` is ``RangeSensor.numbers``, and the cosine is that of :func:`read_share`.
    """
    std, growth, cone, bias = sensor
    seen = distance * read_share(cosine, cone)
    return seen + bias, std**2 + (growth * seen**2) ** 2
