"""The small linear algebra of the kernels against numpy's."""

import numpy as np
import pytest

from limslam_agent.kernels import algebra, covariance
from limslam_agent.kernels.compilation import entry
from limslam_env.geometry import FloatArray

factorise, whiten, solve_factored = (
    entry(each.py_func) for each in (algebra.factorise, algebra.whiten, algebra.solve_factored)
)
add_products, orthonormalise = entry(covariance.add_products.py_func), entry(algebra.orthonormalise.py_func)
quantile, sort_with = entry(algebra.quantile.py_func), entry(algebra.sort_with.py_func)
GENERATOR = np.random.default_rng(0)


def positive(size: int) -> FloatArray:
    root = GENERATOR.normal(size=(size, size))
    return np.asarray(root @ root.T + np.eye(size))


@pytest.mark.parametrize("size", [1, 2, 7, 20])
def test_triangular_systems(size: int) -> None:
    matrix, values = positive(size), GENERATOR.normal(size=(size, 3))
    factor, whitened, solved = matrix.copy(), values.copy(), values[:, 0].copy()
    factorise(factor, size)
    whiten(factor, whitened, size, 3)
    solve_factored(factor, solved, size)
    lower = np.linalg.cholesky(matrix)
    np.testing.assert_allclose(np.tril(factor), lower, atol=1e-9)
    np.testing.assert_allclose(whitened, np.linalg.solve(lower, values), atol=1e-9)
    np.testing.assert_allclose(solved, np.linalg.solve(matrix, values[:, 0]), atol=1e-9)


@pytest.mark.parametrize("whole", [3, 6])
def test_a_symmetric_product_is_added_to_a_part_of_a_matrix(whole: int) -> None:
    matrix, root, weights = positive(23), GENERATOR.normal(size=(8, 19)), GENERATOR.normal(size=8)
    found, expected = matrix.copy(), matrix.copy()
    add_products(found, whole, weights[:, None] * root, root)
    covariance.mirror(found, 19, whole)
    expected[:19, :19] += root.T @ (weights[:, None] * root)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_quantiles_and_sorting() -> None:
    values = np.sort(GENERATOR.normal(size=13))
    for share in (0.0, 0.15, 0.5, 0.85, 1.0):
        assert quantile(values, 13, share) == pytest.approx(np.quantile(values, share), abs=1e-12)
    keys, follow = np.array([2.0, 1.0, 2.0, 0.0, 1.0]), np.arange(5)
    sort_with(keys, follow, 5)
    assert keys.tolist() == [0.0, 1.0, 1.0, 2.0, 2.0]
    assert follow.tolist() == [3, 1, 4, 0, 2]


def test_orthonormal_columns() -> None:
    values = GENERATOR.normal(size=(9, 4))
    orthonormalise(values, 1, 4, 9)
    np.testing.assert_allclose(values[:, 1:].T @ values[:, 1:], np.eye(3), atol=1e-12)
