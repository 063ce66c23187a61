"""Gates: how large a squared Mahalanobis distance may be."""

import math


def gate(dof: int, probability: float) -> float:
    """The squared distance that differences of 1 or 2 numbers stay below with a probability, where
    they are as large as stated: the quantile of chi-square, to a tenth, which nothing feels.

    Raises
    ------
    ValueError
        If there are other numbers of degrees of freedom.

    Examples
    --------
    >>> gate(2, 0.9889)
    9.0
    """
    if dof == 1:
        from statistics import NormalDist

        return round(NormalDist().inv_cdf(0.5 + 0.5 * probability) ** 2, 1)
    if dof == 2:
        return round(-2.0 * math.log1p(-probability), 1)
    raise ValueError(f"gates are of 1 or 2 numbers, not {dof}")
