import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.optim.schur import backward_blocks, cholesky_blocks, forward_blocks, solve_positive


@pytest.mark.parametrize("n", [1, 3, 6, 12, 13, 15])
def test_factors_of_blocks(n):
    """Both the written-out path (to 12) and LAPACK's."""
    rng = np.random.default_rng(n)
    A = rng.normal(size=(5, n, n + 3))
    A = A @ A.transpose(0, 2, 1)
    B = rng.normal(size=(5, n, 2))
    L = cholesky_blocks(jnp.asarray(np.moveaxis(A, 0, -1)))
    np.testing.assert_allclose(np.moveaxis(L, -1, 0), np.linalg.cholesky(A), rtol=1e-9, atol=1e-12)
    last = jnp.asarray(np.moveaxis(B, 0, -1))
    for i in range(5):
        C = np.linalg.cholesky(A[i])
        np.testing.assert_allclose(forward_blocks(L, last)[..., i], np.linalg.solve(C, B[i]), rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(backward_blocks(L, last)[..., i], np.linalg.solve(C.T, B[i]), rtol=1e-8, atol=1e-10)


def test_solve_positive_with_parameters_of_very_different_size():
    rng = np.random.default_rng(0)
    J = rng.normal(size=(20, 4)) * np.array([1e-6, 1.0, 1e3, 1e8])
    x = rng.normal(size=4) / np.array([1e-6, 1.0, 1e3, 1e8])
    np.testing.assert_allclose(solve_positive(jnp.asarray(J.T @ J), jnp.asarray(J.T @ (J @ x))), x, rtol=1e-9)
    assert np.all(np.isnan(solve_positive(jnp.asarray([[1.0, 2.0], [2.0, 1.0]]), jnp.ones(2))))
