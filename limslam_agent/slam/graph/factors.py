"""Factors and robust kernels that both smoothers use, with their derivatives.

A step is added to the parameters of a pose directly.
"""

import numpy as np

from limslam_agent.slam.graph.graph import Factors, Keys, RobustKernel
from limslam_env.geometry import FloatArray, IntArray, se2

Relations = tuple[IntArray, FloatArray, FloatArray]
"""Relative poses between poses: their ends (f, 2), relative poses (f, 3) and information (f, 3,
3).
"""


def prior(kind: str, values: FloatArray, information: FloatArray) -> Factors:
    """Values (f, d) of all nodes of a kind, about a likeliest value of 0 with inverse covariances
    (d, d) or (f, d, d).
    """
    count, width = values.shape
    keys: Keys = ((kind, np.arange(count)),)
    identity = np.tile(np.eye(width), (count, 1, 1))
    return Factors(keys, values, identity, np.broadcast_to(information, (count, width, width)))


def relation(
    poses: FloatArray, ends: IntArray, measured: FloatArray, information: FloatArray | None = None
) -> Factors:
    """Relative poses (f, 3) that were measured between poses ``ends`` (f, 2), of all poses (m, 3).

    The errors are the estimated relative poses minus the measured ones, with wrapped headings.
    """
    a = poses[ends[:, 0]]
    b = poses[ends[:, 1]]
    cos = np.cos(a[:, 2])
    sin = np.sin(a[:, 2])
    dx = b[:, 0] - a[:, 0]
    dy = b[:, 1] - a[:, 1]
    x = cos * dx + sin * dy
    y = cos * dy - sin * dx
    turn = se2.wrap_angle(b[:, 2] - a[:, 2] - measured[:, 2])
    jacobian = np.zeros((len(a), 3, 6))
    jacobian[:, 0, 3] = jacobian[:, 1, 4] = cos
    jacobian[:, 0, 4] = sin
    jacobian[:, 1, 3] = -sin
    jacobian[:, :2, :2] = -jacobian[:, :2, 3:5]
    jacobian[:, 0, 2] = y
    jacobian[:, 1, 2] = -x
    jacobian[:, 2, 2] = -1.0
    jacobian[:, 2, 5] = 1.0
    errors = np.column_stack((x - measured[:, 0], y - measured[:, 1], turn))
    keys: Keys = (("poses", ends[:, 0]), ("poses", ends[:, 1]))
    return Factors(keys, errors, jacobian, information)


def geman_mcclure(scale: float) -> RobustKernel:
    """The kernel of S. Geman and D. McClure, "Bayesian image analysis", 1985, with a scale in
    standard deviations.
    """
    return lambda chi2: (1.0 + chi2 / scale**2) ** -2


def cauchy(scale: float) -> RobustKernel:
    """The Cauchy kernel, with a scale as a chi-square."""
    return lambda chi2: 1.0 / (1.0 + chi2 / scale)


def cauchy_cost(scale: float, chi2: FloatArray) -> FloatArray:
    """What factors (f,) with these chi-squares cost by the Cauchy kernel."""
    return np.asarray(scale * np.log1p(chi2 / scale))


def dynamic_covariance_scaling(scale: float) -> RobustKernel:
    """The kernel of P. Agarwal et al., "Robust map optimization using dynamic covariance scaling",
    2013, with a scale as a chi-square.
    """
    return lambda chi2: np.minimum(1.0, 2.0 * scale / (scale + chi2)) ** 2
