"""Laws of rotations, over every kind of rotation vector including 0, pi and beyond 2 pi."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from samplers import ROTATION_KINDS, over, rotation_vectors

from jaxmocap.geometry import rotation

SAMPLES = 20
kinds = pytest.mark.parametrize("kind", ROTATION_KINDS)


@kinds
def test_exp_is_orthonormal(kind):
    R = over(rotation.exp, rotation_vectors(kind, SAMPLES))
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=5e-15)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=5e-15)


@kinds
def test_exp_of_log_is_the_rotation_and_log_is_at_most_pi_long(kind):
    R = over(rotation.exp, rotation_vectors(kind, SAMPLES))
    w = over(rotation.log, R)
    np.testing.assert_allclose(over(rotation.exp, w), R, atol=1e-14)
    assert np.all(np.linalg.norm(w, axis=1) <= np.pi + 1e-14)


def log_exp(w):
    return rotation.log(rotation.exp(w))


@kinds
def test_log_of_exp_is_canonical_up_to_the_sign_at_pi(kind):
    w = rotation_vectors(kind, SAMPLES)
    got, expected = over(log_exp, w), over(rotation.canonical, w)
    if kind == "pi":
        got = got * np.sign(np.sum(got * expected, axis=1, keepdims=True))
    np.testing.assert_allclose(got, expected, rtol=1e-13, atol=2e-14)


@pytest.mark.parametrize("angle", [1e-12, 1e-9, 1e-7, 1e-5, 1e-3])
def test_log_keeps_every_digit_of_a_tiny_rotation(angle):
    w = angle * np.array([[0.6, 0.0, -0.8], [0.0, 1.0, 0.0]])
    np.testing.assert_allclose(over(log_exp, w), w, rtol=1e-15, atol=angle * 1e-15)


@kinds
def test_canonical_is_the_same_rotation_at_most_pi_long_and_does_nothing_twice(kind):
    w = rotation_vectors(kind, SAMPLES)
    c = over(rotation.canonical, w)
    assert np.all(np.linalg.norm(c, axis=1) <= np.pi * (1 + 1e-15))
    np.testing.assert_allclose(over(rotation.exp, c), over(rotation.exp, w), atol=1e-14)
    np.testing.assert_allclose(over(rotation.canonical, c), c, atol=1e-15)


@kinds
def test_rotate_is_the_product_with_the_matrix(kind):
    w = rotation_vectors(kind, SAMPLES)
    p = np.random.default_rng(0).normal(size=w.shape) * 100
    got = over(rotation.rotate, w, p)
    np.testing.assert_allclose(got, np.einsum("nij,nj->ni", over(rotation.exp, w), p), atol=5e-13)
    np.testing.assert_allclose(np.linalg.norm(got, axis=1), np.linalg.norm(p, axis=1), rtol=5e-15)
    np.testing.assert_allclose(over(rotation.rotate, w, w), w, rtol=1e-14, atol=1e-14)  # the axis stays


@kinds
def test_exp_of_minus_is_the_transpose(kind):
    w = rotation_vectors(kind, SAMPLES)
    np.testing.assert_allclose(over(rotation.exp, -w), over(rotation.exp, w).transpose(0, 2, 1), atol=1e-15)


def first_order_miss(w, d):
    left, right = rotation.exp(w + d), rotation.exp(rotation.left_jacobian(w) @ d) @ rotation.exp(w)
    return jnp.max(jnp.abs(left - right))


@kinds
def test_left_jacobian_first_order_law(kind):
    """exp(w + d) = exp(J(w) d) exp(w): the miss falls with the square of d."""
    w = rotation_vectors(kind, SAMPLES)
    d = np.random.default_rng(1).normal(size=w.shape)
    large, small = over(first_order_miss, w, 1e-2 * d), over(first_order_miss, w, 1e-4 * d)
    assert np.all(large < 2e-3)
    assert np.all(small < 1.2e-4 * large + 1e-14)


@kinds
def test_left_jacobian_carries_the_axis_to_itself(kind):
    w = rotation_vectors(kind, SAMPLES)
    J = over(rotation.left_jacobian, w)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", J, w), w, rtol=1e-13, atol=1e-13)


@kinds
def test_left_jacobian_is_the_mean_of_the_rotations_on_the_way(kind):
    """J(w) = integral of exp(s w), s = 0..1: by 40-point Gauss quadrature, an independent route."""
    w = rotation_vectors(kind, SAMPLES)
    s, weight = np.polynomial.legendre.leggauss(40)
    mean = sum(0.5 * b * over(rotation.exp, 0.5 * (a + 1) * w) for a, b in zip(s, weight))
    np.testing.assert_allclose(over(rotation.left_jacobian, w), mean, atol=1e-13)


@kinds
def test_quaternions_and_back(kind):
    w = rotation_vectors(kind, SAMPLES)
    R = over(rotation.exp, w)
    q = over(rotation.quaternion_from_rotvec, w)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1, rtol=5e-15)
    np.testing.assert_allclose(over(rotation.matrix_from_quaternion, q), R, atol=1e-14)
    np.testing.assert_allclose(over(rotation.matrix_from_quaternion, -3 * q), R, atol=1e-14)
    np.testing.assert_allclose(over(rotation.exp, over(rotation.rotvec_from_quaternion, q)), R, atol=1e-14)
    back = over(rotation.quaternion_from_matrix, R)
    assert np.all(back[:, 3] >= 0)
    np.testing.assert_allclose(over(rotation.matrix_from_quaternion, back), R, atol=1e-14)


@kinds
def test_axis_angle_and_back(kind):
    w = rotation_vectors(kind, SAMPLES)
    axis, angle = over(rotation.axis_angle_from_rotvec, w)
    np.testing.assert_allclose(np.linalg.norm(axis, axis=1), 1, rtol=1e-15)
    assert np.all((angle >= 0) & (angle <= np.pi * (1 + 1e-15)))
    back = over(rotation.rotvec_from_axis_angle, 5.0 * axis, angle)
    np.testing.assert_allclose(over(rotation.exp, back), over(rotation.exp, w), atol=1e-14)


@kinds
def test_nearest_rotation_leaves_rotations_alone_and_repairs_noise(kind):
    R = over(rotation.exp, rotation_vectors(kind, SAMPLES))
    np.testing.assert_allclose(over(rotation.nearest_rotation, R), R, atol=1e-14)
    noise = 1e-3 * np.random.default_rng(2).normal(size=R.shape)
    got = over(rotation.nearest_rotation, 2.5 * (R + noise))
    assert np.max(np.abs(got - R)) < 5e-3
    np.testing.assert_allclose(np.linalg.det(got), 1, rtol=1e-13)
    S = np.einsum("nji,njk->nik", got, R + noise)  # R^T M of the nearest rotation is symmetric
    np.testing.assert_allclose(S, S.transpose(0, 2, 1), atol=1e-14)


coordinate = st.floats(-20, 20, allow_nan=False)
_round_trip = jax.jit(lambda w: (rotation.exp(w), rotation.exp(rotation.log(rotation.exp(w)))))


@given(st.tuples(coordinate, coordinate, coordinate))
def test_any_rotation_vector_makes_the_round_trip(w):
    R, again = _round_trip(jnp.array(w))
    np.testing.assert_allclose(again, R, atol=5e-14)
    np.testing.assert_allclose(np.asarray(R) @ np.asarray(R).T, np.eye(3), atol=5e-14)
