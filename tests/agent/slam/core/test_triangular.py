"""Triangular systems: the solution of scipy, for any number of columns."""

import numpy as np
import pytest
from scipy.linalg import solve_triangular

from limslam_agent.slam.core.triangular import solve_lower


@pytest.mark.parametrize("shape", [(1,), (30,), (30, 1), (1, 5), (9, 2), (30, 5), (30, 6), (70, 150)])
@pytest.mark.parametrize("order", ["C", "F"])
def test_a_triangular_system_is_solved_as_scipy_solves_it(shape, order):
    generator = np.random.default_rng([1, *shape])
    matrix = generator.normal(size=(shape[0], shape[0]))
    factor = np.linalg.cholesky(matrix @ matrix.T + np.eye(shape[0]))
    values = np.array(generator.normal(size=shape), order=order)
    before = values.copy()
    solution = solve_lower(factor, values)
    expected = solve_triangular(factor, values, lower=True, check_finite=False)
    np.testing.assert_allclose(solution, expected, rtol=1e-12)
    np.testing.assert_array_equal(values, before)
    np.testing.assert_allclose(factor @ solution, values, atol=1e-9)


def test_what_is_above_the_diagonal_is_not_read():
    full = np.array([[2.0, np.nan], [1.0, 4.0]])
    np.testing.assert_array_equal(solve_lower(full, np.array([2.0, 9.0])), [1.0, 2.0])
