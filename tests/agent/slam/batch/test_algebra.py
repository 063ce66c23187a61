"""The batch's small linear algebra against numpy's."""

import numpy as np
import pytest
from support.batch_stages import cached

from limslam_agent.kernels import algebra as small
from limslam_agent.slam.batch import algebra
from limslam_env.geometry import FloatArray

factorise, whiten, solve_factored = (cached(each) for each in (small.factorise, small.whiten, small.solve_factored))
add_products, block_of, gather_rows = (
    cached(each) for each in (algebra.add_products, algebra.block_of, algebra.gather_rows)
)
quantile, sort_with, squared_distance = (
    cached(each) for each in (small.quantile, small.sort_with, algebra.squared_distance)
)
orthonormalise = cached(small.orthonormalise)
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


def test_a_packed_covariance() -> None:
    size, matrix = 11, positive(11)
    top, rest = matrix[:3].copy(), matrix[np.tril_indices(11)].copy()
    columns = np.array([3, 7, 10])
    np.testing.assert_array_equal(gather_rows(top, rest, columns, size), matrix[columns])
    both = np.array([0, 2, 5, 9])
    np.testing.assert_array_equal(block_of(top, rest, both), matrix[np.ix_(both, both)])
    left, right = GENERATOR.normal(size=(8, size)), GENERATOR.normal(size=(8, size))
    add_products(rest, left, right, 8, 3, size)
    rows, places = np.tril_indices(11)
    expected = np.where(rows >= 3, (matrix + left.T @ right)[rows, places], matrix[rows, places])
    np.testing.assert_allclose(rest, expected, atol=1e-9)


def test_quantiles_and_sorting() -> None:
    values = np.sort(GENERATOR.normal(size=13))
    for share in (0.0, 0.15, 0.5, 0.85, 1.0):
        assert quantile(values, 13, share) == pytest.approx(np.quantile(values, share), abs=1e-12)
    keys, follow = np.array([2.0, 1.0, 2.0, 0.0, 1.0]), np.arange(5)
    sort_with(keys, follow, 5)
    assert keys.tolist() == [0.0, 1.0, 1.0, 2.0, 2.0]
    assert follow.tolist() == [3, 1, 4, 0, 2]


def test_orthonormal_columns_and_distances() -> None:
    values = GENERATOR.normal(size=(9, 4))
    orthonormalise(values, 1, 4, 9)
    np.testing.assert_allclose(values[:, 1:].T @ values[:, 1:], np.eye(3), atol=1e-12)
    covariance, off = positive(2), np.array([0.3, -0.7])
    expected = off @ np.linalg.solve(covariance + np.diag([0.1, 0.2]), off)
    assert squared_distance(covariance, off, (0.1, 0.2)) == pytest.approx(expected, abs=1e-12)
