"""Laws of poses, over every kind of rotation vector."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import ROTATION_KINDS, central_difference, over, rotation_vectors

from jaxmocap.geometry import Pose

SAMPLES = 10
kinds = pytest.mark.parametrize("kind", ROTATION_KINDS)


def draw(kind, seed):
    """Ten poses of a kind as one module with a leading axis."""
    rng = np.random.default_rng(seed)
    return Pose(jnp.array(rotation_vectors(kind, SAMPLES, seed)), jnp.array(rng.normal(size=(SAMPLES, 3)) * 10))


def matrix(T):
    return T.matrix()


def act(T, p):
    return T.act(p)


def compose(T, S):
    return T.compose(S)


def compose_three(T_a_b, T_b_c, T_c_d):
    return T_a_b.compose(T_b_c).compose(T_c_d).matrix(), T_a_b.compose(T_b_c.compose(T_c_d)).matrix()


def undo(T):
    return T.compose(T.inverse()).matrix(), T.inverse().compose(T).matrix(), T.inverse().inverse()


def canonical(T):
    return T.canonical()


def matrix_and_back(T):
    return Pose.from_matrix(T.matrix()).matrix()


def retract(T, delta):
    return T.retract(delta).matrix()


@kinds
@pytest.mark.parametrize("other", ["uniform", "pi", "1e-7 from identity"])
def test_T_a_b_T_b_c_takes_c_to_a(kind, other):
    T_a_b, T_b_c = draw(kind, 1), draw(other, 2)
    p_c = np.random.default_rng(3).normal(size=(SAMPLES, 3))
    T_a_c = over(compose, T_a_b, T_b_c)
    np.testing.assert_allclose(over(matrix, T_a_c), over(matrix, T_a_b) @ over(matrix, T_b_c), atol=1e-13)
    np.testing.assert_allclose(over(act, T_a_c, p_c), over(act, T_a_b, over(act, T_b_c, p_c)), atol=1e-13)
    assert np.all(np.linalg.norm(T_a_c.rotvec, axis=1) <= np.pi + 1e-14)


@kinds
def test_act_is_the_matrix_on_the_homogeneous_point(kind):
    T, p = draw(kind, 4), np.random.default_rng(5).normal(size=(SAMPLES, 3))
    M = over(matrix, T)
    np.testing.assert_allclose(over(act, T, p), np.einsum("nij,nj->ni", M[:, :3, :3], p) + M[:, :3, 3], atol=1e-13)
    assert np.array_equal(M[:, 3], np.tile([0.0, 0, 0, 1], (SAMPLES, 1)))


@kinds
def test_inverse_undoes_on_both_sides(kind):
    right, left, twice = over(undo, T := draw(kind, 6))
    np.testing.assert_allclose(right, np.tile(np.eye(4), (SAMPLES, 1, 1)), atol=3e-14)
    np.testing.assert_allclose(left, np.tile(np.eye(4), (SAMPLES, 1, 1)), atol=3e-14)
    assert np.array_equal(twice.rotvec, T.rotvec)
    np.testing.assert_allclose(twice.translation, T.translation, atol=3e-14)


@kinds
def test_compose_is_associative(kind):
    first, second = over(compose_three, draw(kind, 7), draw("uniform", 8), draw(kind, 9))
    np.testing.assert_allclose(first, second, atol=1e-13)


@kinds
def test_canonical_and_matrix_round_trip_keep_the_pose(kind):
    T = draw(kind, 10)
    np.testing.assert_allclose(over(matrix, over(canonical, T)), over(matrix, T), atol=1e-13)
    np.testing.assert_allclose(over(matrix_and_back, T), over(matrix, T), atol=1e-13)


@kinds
def test_retract_to_first_order_turns_about_the_axes_of_a(kind):
    """retract(d) = (I + [d_w]) R p + t + d_t up to the square of d; retract(0) changes nothing."""
    T, rng = draw(kind, 11), np.random.default_rng(12)
    M, delta = over(matrix, T), rng.normal(size=(SAMPLES, 6))
    np.testing.assert_allclose(over(retract, T, 0 * delta), M, atol=1e-14)
    moved = over(retract, T, 1e-6 * delta)
    expected = M.copy()
    expected[:, :3, :3] += 1e-6 * np.cross(delta[:, None, :3], M[:, :3, :3].transpose(0, 2, 1)).transpose(0, 2, 1)
    expected[:, :3, 3] += 1e-6 * delta[:, 3:]
    np.testing.assert_allclose(moved, expected, atol=2e-11)


def test_retract_can_be_differentiated_at_zero_from_every_pose():
    value, forward, reverse = (jax.jit(f) for f in (retract, jax.jacfwd(retract, 1), jax.jacrev(retract, 1)))
    for kind in ROTATION_KINDS:
        T = jax.tree.map(lambda leaf: leaf[3], draw(kind, 13))
        J = forward(T, jnp.zeros(6))
        np.testing.assert_allclose(J, reverse(T, jnp.zeros(6)), atol=1e-13)
        np.testing.assert_allclose(J, central_difference(partial(value, T), np.zeros(6), 1e-5), atol=1e-9)
