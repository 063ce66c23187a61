"""Constant errors of the odometry, estimated beside a filter that takes them to be zero.

A filter with these errors in its state estimates them from the first step, and a robot that is as specified pays for
that: a regression on noisy odometry is not exact. Here the filter does not know of the errors. Beside its state x and
covariance P stands the derivative V of x by the errors b, which each prediction and update of the filter changes by a
known linear map. The innovations then give the estimate of b, and x + V b with the covariance P + V M V^T, where M is
the covariance of b, is what the filter with b in its state would have estimated (B. Friedland, "Treatment of bias in
recursive filtering", 1969). So the filter can wait with its decision until the data require the errors, and lose
nothing.
"""

import numpy as np

from limslam_agent.slam.core.ekf import POSE
from limslam_env.geometry import FloatArray, IntArray


class SeparateBias:
    """The constant errors b of the odometry of n robots, three numbers each, and what they do to a filter's state.

    Parameters
    ----------
    size
        Length of the filter's state, which holds the robots' poses and nothing else.
    prior
        Covariance (3, 3) of the errors of one robot, about zero.

    Attributes
    ----------
    evidence
        Twice the logarithm of the Bayes factor for errors of one robot against no errors, for the worst robot. It is
        the gain in chi-square by the errors, less what three more parameters gain by chance (R. Kass and A. Raftery,
        "Bayes factors", 1995). If there are no errors, it ever exceeds g with a probability of at most exp(-g / 2).
    """

    def __init__(self, size: int, prior: FloatArray) -> None:
        self._prior = prior
        self._by_errors = np.zeros((size, size))
        self._information, self._score = np.zeros((size, size)), np.zeros(size)
        self.evidence = 0.0

    @property
    def by_errors(self) -> FloatArray:
        """Derivative V of the filter's state by the errors (size, 3 n)."""
        return self._by_errors

    @property
    def estimate(self) -> tuple[FloatArray, FloatArray]:
        """The errors (3 n,) and their covariance (3 n, 3 n)."""
        prior = np.kron(np.eye(len(self._score) // POSE), self._prior)
        covariance = prior @ np.linalg.inv(np.eye(len(prior)) + self._information @ prior)
        return covariance @ self._score, 0.5 * (covariance + covariance.T)

    def predict(self, moved: slice, by_pose: FloatArray, by_errors: FloatArray) -> None:
        """A pose has moved: derivatives (3, 3) of the new pose by the old one, and by the errors of its robot."""
        self._by_errors[moved] = by_pose @ self._by_errors[moved]
        self._by_errors[moved, moved] += by_errors

    def forget(self, part: slice) -> None:
        """A part of the state got a value that does not depend on the errors."""
        self._by_errors[part] = 0.0

    def insert(self, place: int, rows: FloatArray) -> None:
        """States were inserted before ``place``, with these derivatives (k, 3 n)."""
        self._by_errors = np.concatenate((self._by_errors[:place], rows, self._by_errors[place:]))

    def keep(self, places: IntArray) -> None:
        """All states but these were removed."""
        self._by_errors = self._by_errors[places]

    def restart(self, size: int) -> None:
        """The filter has got a new state of this length. Its derivative by the errors is zero from now on."""
        self._by_errors = np.zeros((size, len(self._score)))

    def transport(self, moved: FloatArray) -> None:
        """The error of the first robot's pose was added to the state's error with the factors ``moved`` (size, 3)."""
        self._by_errors += moved @ self._by_errors[:POSE]

    def update(
        self,
        jacobian: FloatArray,
        columns: IntArray,
        innovation: FloatArray,
        covariance: FloatArray,
        unscaled: FloatArray,
    ) -> None:
        """The filter was updated by m measurements.

        Parameters
        ----------
        jacobian, columns
            Their derivative (m, k) by these states (k,).
        innovation, covariance
            The innovation (m,) and its covariance (m, m).
        unscaled
            The gain, transposed and before its division by ``covariance``: the product (m, size) of the derivative by
            all states and the state's covariance before the update.
        """
        by_errors = jacobian @ self._by_errors[columns]
        solved = np.linalg.solve(covariance, np.column_stack((by_errors, innovation)))
        self._information += by_errors.T @ solved[:, :-1]
        self._score += by_errors.T @ solved[:, -1]
        self._by_errors -= unscaled.T @ solved[:, :-1]
        self.evidence = max(self._evidence_of(slice(first, first + POSE)) for first in range(0, len(self._score), POSE))

    def _evidence_of(self, part: slice) -> float:
        narrowed, score = np.eye(POSE) + self._information[part, part] @ self._prior, self._score[part]
        gain = float(score @ self._prior @ np.linalg.solve(narrowed, score))
        return gain - float(np.linalg.slogdet(narrowed)[1])
