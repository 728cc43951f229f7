"""Homogeneous coordinates, normalising transforms, RQ, null vectors."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from jaxmocap.geometry import projective


def test_homogeneous_appends_one():
    assert np.array_equal(projective.homogeneous(jnp.array([3.0, 4.0])), [3, 4, 1])


def test_normalising_transform_by_hand():
    """A square of side 2 about (5, 7): every corner is sqrt(2) away already, so it is only moved."""
    square = jnp.array([[4.0, 6], [6, 6], [6, 8], [4, 8]])
    T = projective.normalising_transform(square, jnp.ones(4, bool))
    np.testing.assert_allclose(T, [[1, 0, -5], [0, 1, -7], [0, 0, 1]], atol=1e-15)


@pytest.mark.parametrize("d", [2, 3])
def test_normalised_points_have_mean_zero_and_rms_root_d(d):
    rng = np.random.default_rng(d)
    points, mask = rng.normal(1000, 300, (30, d)), rng.uniform(size=30) < 0.7
    points[~mask] = np.nan  # what is masked may be anything
    T = np.asarray(projective.normalising_transform(jnp.array(points), jnp.array(mask)))
    q = points[mask] @ T[:d, :d].T + T[:d, d]
    np.testing.assert_allclose(q.mean(axis=0), 0, atol=1e-13)
    np.testing.assert_allclose(np.sqrt((q**2).sum(axis=1).mean()), np.sqrt(d), rtol=1e-13)
    np.testing.assert_allclose(T[:d, :d], T[0, 0] * np.eye(d))
    assert np.array_equal(T[d], np.eye(d + 1)[d])


def test_points_that_coincide_are_only_moved_and_no_points_stay():
    T = projective.normalising_transform(jnp.full((3, 2), 4.0), jnp.ones(3, bool))
    assert np.array_equal(T, [[1, 0, -4], [0, 1, -4], [0, 0, 1]])
    assert np.array_equal(projective.normalising_transform(jnp.ones((3, 2)), jnp.zeros(3, bool)), np.eye(3))


def test_rq_by_hand():
    """A camera matrix times a quarter turn about z."""
    K, R = np.array([[800.0, 2, 320], [0, 810, 240], [0, 0, 1]]), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    got_K, got_R = projective.rq(jnp.array(K @ R))
    np.testing.assert_allclose(got_K, K, atol=1e-12)
    np.testing.assert_allclose(got_R, R, atol=1e-14)


def test_rq_against_scipy_up_to_its_signs():
    for M in np.random.default_rng(0).normal(size=(20, 3, 3)):
        K, R = (np.asarray(a) for a in projective.rq(jnp.array(M)))
        expected_K, expected_R = scipy.linalg.rq(M)
        sign = np.sign(np.diag(expected_K))
        np.testing.assert_allclose(K, expected_K * sign, atol=1e-13)
        np.testing.assert_allclose(R, sign[:, None] * expected_R, atol=1e-13)
        assert np.all(np.diag(K) > 0) and np.linalg.det(R) * np.linalg.det(M) > 0


@pytest.mark.parametrize("rows, columns", [(20, 12), (12, 12), (8, 9), (11, 12)])
def test_smallest_singular_vector_finds_the_null_vector(rows, columns):
    rng = np.random.default_rng(rows)
    x = rng.normal(size=columns)
    x /= np.linalg.norm(x)
    A = rng.normal(size=(rows, columns))
    A -= np.outer(A @ x, x)
    got = np.asarray(projective.smallest_singular_vector(jnp.array(A)))
    np.testing.assert_allclose(abs(got @ x), 1, rtol=1e-13)


def test_smallest_singular_vector_is_the_eigenvector_of_the_normal_matrix():
    A = np.random.default_rng(3).normal(size=(40, 6))
    got = np.asarray(projective.smallest_singular_vector(jnp.array(A)))
    np.testing.assert_allclose(abs(got @ np.linalg.eigh(A.T @ A)[1][:, 0]), 1, rtol=1e-13)


@pytest.mark.parametrize("d", [2, 3])
def test_similarity_inverse_against_numpy(d):
    T = np.diag([2.5] * d + [1.0])
    T[:d, d] = np.arange(d) - 7.0
    np.testing.assert_allclose(projective.similarity_inverse(jnp.array(T)), np.linalg.inv(T), atol=1e-15)


def test_determinant_against_numpy():
    for M in np.random.default_rng(4).normal(size=(10, 3, 3)):
        np.testing.assert_allclose(projective.determinant(jnp.array(M)), np.linalg.det(M), rtol=1e-12, atol=1e-14)
