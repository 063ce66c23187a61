"""The chance that a pose is off: farther from the truth than ``FAR``, or turned by more than
``TURNED``.

Two causes count. The error may be as large as its covariance allows for. Or the pose is another one
altogether, at a place that was taken for the right one: then the covariance says nothing, and what
counts is the evidence of the rays (:mod:`~limslam_agent.status.known_map`). The status of an
estimate, while a robot drives and at the end, follows from this one number.
"""

import math

import numpy as np

from limslam_env.geometry import FloatArray

FAR = 0.5
TURNED = math.radians(10.0)
"""A pose is off if it is farther from the true one than this, m, or turned by more than this,
rad.
"""

LIMIT = 0.05
"""An estimate is ``ok`` if the chance that it is off is less."""

# How unlikely a wrong place is before the rays have spoken: a logarithm, without its sign
_MISTAKEN = 7.5
_ANGLES = np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False)
_LEAST = 1e-12  # m^2 and rad^2


def chance_off(covariances: FloatArray) -> FloatArray:
    """The chances (...,) that Gaussian errors of poses with covariances (..., 3, 3) are too large.

    A position with the variances a and b along its axes, in units of which it lies at a distance r
    in a uniformly distributed direction p, is farther off than ``FAR`` if r^2 exceeds FAR^2 / (a
    cos^2 p + b sin^2 p). So the chance is the mean of exp(-r^2 / 2) over all directions.
    """
    x = covariances[..., 0, 0]
    y = covariances[..., 1, 1]
    apart = np.hypot(0.5 * (x - y), covariances[..., 0, 1])[..., None]
    variances = 0.5 * (x + y)[..., None] + apart * np.cos(_ANGLES)
    far = np.exp(-0.5 * FAR**2 / np.maximum(variances, _LEAST)).mean(axis=-1)
    turned = np.sqrt(0.5 * TURNED**2 / np.maximum(covariances[..., 2, 2], _LEAST))
    return np.asarray(1.0 - (1.0 - far) * (1.0 - np.vectorize(math.erfc, otypes=[float])(turned)))


def chance_path_off(covariance: FloatArray) -> float:
    """The chance that a path is farther off than ``FAR``, as a root mean square over positions with
    a joint covariance (2 k, 2 k), m^2.

    The mean square is taken to have a chi-square distribution with its mean and variance (F.
    Satterthwaite, "An approximate distribution of estimates of variance components", 1946).
    """
    from scipy.special import gammaincc

    mean = max(float(covariance.trace()), _LEAST)
    size = max(float((covariance**2).sum()), _LEAST**2)
    freedoms = mean**2 / size
    threshold = 0.5 * len(covariance) * FAR**2
    return float(gammaincc(0.5 * freedoms, 0.5 * threshold * mean / size))


def chance_mistaken(evidence: float) -> float:
    """The chance of a wrong place by the evidence for it: the logarithm of the ratio of its
    likelihood to that of the right one.
    """
    return 0.5 + 0.5 * math.tanh(0.5 * (evidence - _MISTAKEN))


def either(one: float, other: float) -> float:
    """The chance of at least one of two independent causes."""
    return 1.0 - (1.0 - one) * (1.0 - other)


def planar_covariance(std: float) -> FloatArray:
    """A covariance (3, 3) of positions with a root mean square error, m, and an exact heading."""
    return np.diag([0.5, 0.5, 0.0]) * std**2


def in_words(chance: float, covariance: FloatArray, what: str = "the pose") -> str:
    """Why an estimate with a covariance (3, 3) is not ``ok``; without its heading if that is
    exact.
    """
    limits = f"{FAR:g} m"
    stds = f"{math.sqrt(max(float(covariance[0, 0] + covariance[1, 1]), 0.0)):.2f} m"
    if covariance[2, 2] > 0.0:
        limits += f" or {math.degrees(TURNED):.0f} deg"
        stds += f" and {math.degrees(math.sqrt(float(covariance[2, 2]))):.1f} deg"
    return (
        f"the chance that {what} is more than {limits} off is {100.0 * chance:.0f} % "
        f"(standard deviation {stds})"
    )


def rate_evidence(counted: float, tested: float, right: float, wrong: float) -> float:
    """The evidence for a rate ``wrong`` of what is counted, against a rate ``right``."""
    fitting = tested - counted
    return counted * math.log(wrong / right) + fitting * math.log((1.0 - wrong) / (1.0 - right))
