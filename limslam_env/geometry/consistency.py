"""Whether the errors of poses are as large as their covariances say."""

import numpy as np

from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import wrap_angle

BAND_95 = (0.21579528262389785, 9.348403604496145)
"""Quantiles 2.5 % and 97.5 % of the chi-square distribution with three degrees of freedom."""

# Travel from a known start that says nothing about consistency, m
_KNOWN_START = 0.5


def has_left_start(true: FloatArray) -> BoolArray:
    """At which of the true poses (n, 3) NEES counts (n,): before 0.5 m of travel, the known start
    has P = 0.

    Examples
    --------
    >>> import numpy as np
    >>> from limslam_env.geometry.consistency import has_left_start
    >>> has_left_start(np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.6, 0.0, 0.0]])).tolist()
    [False, False, True]
    """
    steps = np.hypot(*np.diff(true[:, :2], axis=0).T)
    return np.append(0.0, np.cumsum(steps)) >= _KNOWN_START


def nees(true: FloatArray, estimated: FloatArray, covariances: FloatArray) -> FloatArray:
    """The normalised estimation error squared (NEES), ``e^T P^-1 e``, of poses.

    It is 3 on average for an estimate that knows its error (Bar-Shalom, Li and Kirubarajan,
    "Estimation with Applications to Tracking and Navigation", section 5.4).

    Parameters
    ----------
    true, estimated
        Poses (n, 3), m and rad.
    covariances
        Covariances (n, 3, 3) of the estimated poses.

    Returns
    -------
    FloatArray
        NEES (n,). Infinite where P is singular, or the result negative.

    Examples
    --------
    >>> import numpy as np
    >>> from limslam_env.geometry.consistency import nees
    >>> found = nees(np.zeros((1, 3)), np.array([[0.2, 0.0, 0.0]]), 0.01 * np.eye(3)[None])
    >>> found.round(6).tolist()
    [4.0]
    """
    errors = true - estimated
    errors[:, 2] = wrap_angle(errors[:, 2])
    # The sign of the determinant finds the matrices that ``solve`` would refuse, and the whole
    # stack with them.
    regular = np.linalg.slogdet(covariances).sign > 0.0
    found = np.full(len(errors), np.inf)
    solved = np.linalg.solve(covariances[regular], errors[regular, :, None])[..., 0]
    found[regular] = np.einsum("ni,ni->n", errors[regular], solved)
    found[found < 0.0] = np.inf
    return found
