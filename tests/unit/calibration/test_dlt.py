import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from samplers import cameras
from scipy.spatial.transform import Rotation

from jaxmocap.calibration.dlt import (
    decompose_projection,
    fit_projection_linear,
    project_with_matrix,
    refine_projection,
)

ALL = jnp.ones(20, bool)


def _scene(seed, n=20):
    """A camera with skew, its centre, and points in space and in the picture, by numpy."""
    rng = np.random.default_rng(seed)
    K = cameras(6, seed)[seed % 6].K
    R, C = Rotation.from_quat(rng.normal(size=4)).as_matrix(), rng.normal(size=3) * 5
    p_camera = rng.uniform([-1, -1, 4], [1, 1, 8], (n, 3))
    points = p_camera @ R + C
    P = K @ np.hstack([R, -(R @ C)[:, None]])
    m = p_camera @ K.T
    return K, R, C, P, points, m[:, :2] / m[:, 2:]


@pytest.mark.parametrize("seed", range(4))
def test_exact_points_give_the_exact_matrix(seed):
    K, R, C, P, points, uv = _scene(seed)
    found = fit_projection_linear(jnp.asarray(points), jnp.asarray(uv), ALL)
    np.testing.assert_allclose(found, P / np.linalg.norm(P), atol=1e-10)
    K2, R2, C2 = decompose_projection(found)
    np.testing.assert_allclose(K2, K, rtol=1e-7, atol=1e-6)
    np.testing.assert_allclose(R2, R, atol=1e-9)
    np.testing.assert_allclose(C2, C, atol=1e-8)


def test_six_points_are_enough_and_masked_ones_do_not_matter():
    _, _, _, P, points, uv = _scene(1)
    wrong = uv.copy()
    wrong[6:] = 1e6
    mask = jnp.arange(20) < 6
    found = fit_projection_linear(jnp.asarray(points), jnp.asarray(wrong), mask)
    np.testing.assert_allclose(found, P / np.linalg.norm(P), atol=1e-7)


@pytest.mark.parametrize("scale", [1.0, -3.0, 1e-4])
def test_decomposition_of_any_multiple(scale):
    K, R, C, P, *_ = _scene(2)
    K2, R2, C2 = decompose_projection(jnp.asarray(scale * P))
    np.testing.assert_allclose(K2, K, rtol=1e-10, atol=1e-8)
    np.testing.assert_allclose(R2, R, atol=1e-11)
    np.testing.assert_allclose(C2, C, atol=1e-10)
    assert np.all(np.diagonal(K2) > 0) and np.linalg.det(R2) > 0


def test_refined_matrix_is_scipys_optimum():
    _, _, _, P, points, uv = _scene(3)
    uv = uv + np.random.default_rng(0).normal(0, 1.0, uv.shape)
    linear = fit_projection_linear(jnp.asarray(points), jnp.asarray(uv), ALL)
    refined = np.asarray(refine_projection(linear, jnp.asarray(points), jnp.asarray(uv), ALL))

    def cost(p):
        m = np.hstack([points, np.ones((20, 1))]) @ p.reshape(3, 4).T
        return (m[:, :2] / m[:, 2:] - uv).ravel()

    P1 = P / P[2, 3]
    best = scipy.optimize.least_squares(
        cost, P1.ravel(), x_scale=np.abs(P1).ravel(), xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    assert np.sum(cost(refined) ** 2) <= 2 * best.cost * (1 + 1e-9)
    assert np.sum(cost(refined) ** 2) < np.sum(cost(np.asarray(linear)) ** 2)


def test_projection_is_finite_on_the_principal_plane():
    P = jnp.eye(3, 4)
    assert np.all(np.isfinite(project_with_matrix(P, jnp.array([1.0, 2.0, 0.0]))))
    np.testing.assert_allclose(project_with_matrix(P, jnp.array([1.0, 2.0, 4.0])), [0.25, 0.5])
