"""Rotations and poses against scipy and jaxlie on the same input."""

from functools import cache
from itertools import product

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
from samplers import ROTATION_KINDS, all_rotation_vectors, over, rotation_vectors
from scipy.spatial.transform import Rotation

from jaxmocap.geometry import Pose, rotation

ORDERS = ["".join(o) for letters in ("xyz", "XYZ") for o in product(letters, repeat=3) if o[0] != o[1] != o[2]]


@pytest.mark.parametrize("kind", ROTATION_KINDS)
def test_exp_and_quaternion_against_scipy(kind):
    w = rotation_vectors(kind, 40)
    np.testing.assert_allclose(over(rotation.exp, w), Rotation.from_rotvec(w).as_matrix(), atol=5e-15)
    q = over(rotation.quaternion_from_matrix, Rotation.from_rotvec(w).as_matrix())
    expected = Rotation.from_rotvec(w).as_quat()
    np.testing.assert_allclose(q * np.sign(np.sum(q * expected, axis=1, keepdims=True)), expected, atol=5e-15)


@pytest.mark.parametrize("kind", [k for k in ROTATION_KINDS if "pi" not in k or "2 pi" in k])
def test_log_against_scipy_where_it_is_unique(kind):
    w = rotation_vectors(kind, 40, seed=1)
    R = Rotation.from_rotvec(w)
    np.testing.assert_allclose(over(rotation.log, R.as_matrix()), R.as_rotvec(), atol=1e-14)
    np.testing.assert_allclose(over(rotation.rotvec_from_quaternion, R.as_quat()), R.as_rotvec(), atol=1e-14)


def theirs(fn, *samples):
    """The same through jaxlie, which mixes ranks."""
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        return np.stack([np.asarray(fn(*(jnp.asarray(a) for a in sample))) for sample in zip(*samples)])


@pytest.mark.parametrize("kind", ROTATION_KINDS)
def test_rotate_against_jaxlie(kind):
    w = rotation_vectors(kind, 5, seed=2)
    p = np.random.default_rng(0).normal(size=w.shape)
    np.testing.assert_allclose(
        over(rotation.rotate, w, p), theirs(jax.jit(lambda a, b: jaxlie.SO3.exp(a) @ b), w, p), atol=2e-14
    )


@pytest.mark.parametrize("kind", ["uniform", "identity", "just below pi", "beyond 2 pi"])
def test_left_jacobian_against_jaxlie(kind):
    """The translation of jaxlie's SE(3) exponential of (v, w) is J_left(w) v."""
    w = rotation_vectors(kind, 5, seed=3)
    v = np.random.default_rng(1).normal(size=w.shape)
    expected = theirs(jax.jit(lambda a, b: jaxlie.SE3.exp(jnp.concatenate([b, a])).translation()), w, v)
    got = np.einsum("nij,nj->ni", over(rotation.left_jacobian, w), v)
    np.testing.assert_allclose(got, expected, atol=1e-13)


def our_poses(w, t, u, s, p):
    T_a_b, T_b_c = Pose(w, t), Pose(u, s)
    return T_a_b.compose(T_b_c).matrix(), T_a_b.inverse().matrix(), T_a_b.act(p)


@jax.jit
def their_poses(w, t, u, s, p):
    T_a_b, T_b_c = (jaxlie.SE3.from_rotation_and_translation(jaxlie.SO3.exp(a), b) for a, b in ((w, t), (u, s)))
    parts = (T_a_b @ T_b_c).as_matrix(), T_a_b.inverse().as_matrix(), T_a_b @ p
    return jnp.concatenate([part.ravel() for part in parts])


def test_poses_against_jaxlie():
    rng = np.random.default_rng(4)
    w = all_rotation_vectors(6, seed=4)
    u = rng.permutation(w)
    t, s, p = rng.normal(size=(3, *w.shape))
    got = np.concatenate([part.reshape(len(w), -1) for part in over(our_poses, w, t, u, s, p)], axis=1)
    np.testing.assert_allclose(got, theirs(their_poses, w, t, u, s, p), atol=2e-14)


@cache
def euler(order):
    """Angles -> matrix and matrix -> angles for one order, as functions whose compiled form is kept."""
    return lambda a: rotation.matrix_from_euler(a, order), lambda m: rotation.euler_from_matrix(m, order)


@pytest.mark.parametrize("order", ORDERS)
def test_euler_angles_against_scipy(order):
    """Random angles with the middle one inside its range, so that scipy's angles come back; then at gimbal lock."""
    rng = np.random.default_rng(5)
    matrix_from, angles_from = euler(order)
    angles = rng.uniform(-np.pi, np.pi, (30, 3))
    low, high = (0.0, np.pi) if order[0] == order[2] else (-np.pi / 2, np.pi / 2)
    angles[:, 1] = rng.uniform(low + 1e-3, high - 1e-3, 30)
    R = Rotation.from_euler(order, angles).as_matrix()
    np.testing.assert_allclose(over(matrix_from, angles), R, atol=5e-15)
    np.testing.assert_allclose(over(angles_from, R), angles, atol=1e-11)

    angles[:, 1] = np.resize((low, high), 30)
    R = Rotation.from_euler(order, angles).as_matrix()
    got = over(angles_from, R)
    np.testing.assert_allclose(Rotation.from_euler(order, got).as_matrix(), R, atol=1e-14)
    np.testing.assert_allclose(got[:, 1], angles[:, 1], atol=1e-14)
    assert np.all(got[:, 2 if order.isupper() else 0] == 0)


@pytest.mark.parametrize("order", ["ZYX", "xyz", "XZY", "ZXZ", "zyz", "XZX"])
@pytest.mark.parametrize("distance", [1e-5, 1e-7, 1e-9, 1e-11, 1e-13])
def test_euler_angles_near_gimbal_lock_still_make_the_rotation(order, distance):
    """Rotations that are products of others, so that the tiny entries carry rounding as they do in use."""
    rng = np.random.default_rng(7)
    angles = rng.uniform(-np.pi, np.pi, (30, 3))
    angles[:, 1] = distance if order[0] == order[2] else np.pi / 2 - distance
    other = Rotation.from_quat(rng.normal(size=(30, 4)))
    R = (Rotation.from_euler(order, angles) * other * other.inv()).as_matrix()
    got = over(euler(order)[1], R)
    np.testing.assert_allclose(Rotation.from_euler(order, got).as_matrix(), R, atol=2e-12)
