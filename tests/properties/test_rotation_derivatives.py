"""Derivatives of rotations: forward = reverse = central difference, finite twice over at 0, pi and 2 pi."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import central_difference, over, rotation_vectors, unit_vectors

from jaxmocap.geometry import rotation

P = jnp.array([0.3, -1.2, 2.0])
AXES = unit_vectors(np.random.default_rng(9), 4)  # x, y, z and one more


def rotate_p(w):
    return rotation.rotate(w, P)


def log_exp(w):
    return rotation.log(rotation.exp(w))


def log_product(w):
    """The difference of two rotations as a solver writes it: log(exp(w) exp(x)^T), x a fixed half turn."""
    return rotation.log(rotation.exp(w) @ rotation.exp(jnp.array([0.0, jnp.pi, 0.0])).T)


FUNCTIONS = (
    rotation.exp,
    rotate_p,
    rotation.left_jacobian,
    rotation.quaternion_from_rotvec,
    rotation.canonical,
    log_exp,
)
POINTS = {
    "identity": np.zeros((1, 3)),
    "1e-12": 1e-12 * AXES,
    "1e-7": 1e-7 * AXES,
    "switch of the series": np.sqrt(0.5) * AXES,
    "pi": np.pi * AXES,
    "just below pi": (np.pi - 1e-7) * AXES,
    "2 pi": 2 * np.pi * AXES,
    "uniform": rotation_vectors("uniform", 4, seed=8),
    "beyond 2 pi": rotation_vectors("beyond 2 pi", 4, seed=8),
}
points = pytest.mark.parametrize("where", POINTS)
functions = pytest.mark.parametrize("fn", FUNCTIONS, ids=lambda f: f.__name__)


@cache
def derivatives(fn):
    def both(w):
        return jax.jacfwd(fn)(w), jax.jacrev(fn)(w), jax.jacfwd(jax.jacrev(fn))(w)

    return jax.jit(both), jax.jit(fn), jax.jit(jax.jacfwd(fn))


@functions
@points
def test_forward_reverse_and_second_derivatives(fn, where):
    both, value, first = derivatives(fn)
    for w in POINTS[where]:
        forward, reverse, second = (np.asarray(a) for a in both(jnp.array(w)))
        assert np.all(np.isfinite(second))
        np.testing.assert_allclose(forward, reverse, atol=2e-13)
        if "pi" in where and "beyond" not in where and fn in (rotation.canonical, log_exp):
            continue  # log jumps there; the branches are checked below
        np.testing.assert_allclose(forward, central_difference(value, w, 1e-5), atol=2e-9)
        np.testing.assert_allclose(second, central_difference(first, w, 1e-5), atol=5e-9)
        np.testing.assert_allclose(second, np.swapaxes(second, -1, -2), atol=1e-10)


def test_second_derivatives_at_the_identity_by_hand():
    """exp = I + [w] + [w]^2 / 2 + ...: d2 exp / dw_i dw_j = ([e_i][e_j] + [e_j][e_i]) / 2."""
    E = np.stack([np.cross(np.eye(3), e) for e in np.eye(3)])  # [e_i]
    expected = np.einsum("iab,jbc->acij", E, E)
    expected = (expected + np.swapaxes(expected, -1, -2)) / 2
    first, _, second = derivatives(rotation.exp)[0](jnp.zeros(3))
    np.testing.assert_allclose(second, expected, atol=1e-15)
    np.testing.assert_allclose(first, np.moveaxis(E, 0, -1), atol=1e-15)


def test_derivative_of_exp_is_the_left_jacobian():
    w = np.concatenate(list(POINTS.values()))
    J, R, dR = over(rotation.left_jacobian, w), over(rotation.exp, w), over(jax.jacfwd(rotation.exp), w)
    cross = over(rotation.cross_matrix, J.transpose(0, 2, 1).reshape(-1, 3)).reshape(-1, 3, 3, 3)  # n, column, 3, 3
    np.testing.assert_allclose(dR, np.einsum("ncab,nbd->nadc", cross, R), atol=1e-14)


def test_log_of_exp_has_the_derivative_of_the_branch_it_is_on():
    """Identity below pi; I - 2 pi (I - n n^T) / |w| beyond; at pi exactly one of the two, whichever sign came."""
    for n in AXES:
        for angle in (0.0, 1e-9, 1.0, np.pi - 1e-7, np.pi, np.pi + 1e-7, 4.0):
            got = np.asarray(derivatives(log_exp)[2](jnp.array(angle * n)))
            turned = np.eye(3) - 2 * np.pi / max(angle, 1.0) * (np.eye(3) - np.outer(n, n))
            below, beyond = np.allclose(got, np.eye(3), atol=1e-9), np.allclose(got, turned, atol=1e-9)
            assert below if angle < 3.1415926 - 1e-6 else beyond if angle > 3.1416 else below or beyond


@pytest.mark.parametrize("turn", ["identity", "pi", "2 pi"])
def test_log_of_a_matrix_has_finite_first_and_second_derivatives(turn):
    both = derivatives(rotation.log)[0]
    for R in over(rotation.exp, POINTS[turn]):
        forward, reverse, second = both(jnp.array(R))
        assert np.all(np.isfinite(second))
        np.testing.assert_allclose(reverse, forward, atol=1e-12)
    # At the identity: d log along [e_i] is e_i.
    along = np.einsum(
        "cab,iab->ci", np.asarray(both(jnp.eye(3))[0]), np.stack([np.cross(np.eye(3), e) for e in np.eye(3)])
    )
    np.testing.assert_allclose(along, np.eye(3), atol=1e-15)


def test_the_difference_of_equal_half_turns_can_be_differentiated():
    both, value, _ = derivatives(log_product)
    w = np.array([0.0, np.pi, 0.0])
    forward, reverse, second = both(jnp.array(w))
    half_turn = [[0, 0, 2 / np.pi], [0, 1, 0], [-2 / np.pi, 0, 0]]  # left Jacobian by hand: log(exp(J d)) = J d
    np.testing.assert_allclose(forward, half_turn, atol=1e-14)
    np.testing.assert_allclose(reverse, half_turn, atol=1e-14)
    np.testing.assert_allclose(forward, central_difference(value, w, 1e-5), atol=1e-9)
    assert np.all(np.isfinite(second))


@pytest.mark.parametrize("kind", ["rotations", "others"])
def test_nearest_rotation_can_be_differentiated_everywhere(kind):
    """At exact rotations all singular values are equal; a matrix of negative determinant is turned over."""
    R = over(rotation.exp, np.concatenate([np.zeros((1, 3)), rotation_vectors("uniform", 3, seed=5)]))
    others = np.concatenate([np.random.default_rng(3).normal(size=(3, 3, 3)), np.diag([1.0, 1.0, -0.1])[None]])
    both, value, _ = derivatives(rotation.nearest_rotation)
    for M in R if kind == "rotations" else others:
        forward, reverse, second = (np.asarray(a) for a in both(jnp.array(M)))
        slopes = central_difference(lambda m: value(m.reshape(3, 3)), M.ravel(), 1e-5)
        np.testing.assert_allclose(forward, slopes.reshape(3, 3, 3, 3), atol=2e-8)
        np.testing.assert_allclose(reverse, forward, atol=1e-12)
        assert np.all(np.isfinite(second))
        if kind == "rotations":  # along the rotations it is the identity, across them nothing
            W = rotation.cross_matrix(jnp.array([0.3, -0.7, 0.2]))
            np.testing.assert_allclose(np.einsum("abij,ij->ab", forward, M @ W), M @ W, atol=1e-13)
            np.testing.assert_allclose(np.einsum("abij,ij->ab", forward, M @ W @ W), 0.0, atol=1e-13)


@pytest.mark.parametrize("order", ["ZXZ", "zxz", "ZYX"])
def test_euler_angles_have_finite_derivatives_at_gimbal_lock(order):
    """Where the middle letter turns by 0 (ZXZ) or 90 degrees, only the sum or difference of the others is known."""
    middle = 0.0 if order.upper() == "ZXZ" else np.pi / 2
    both, _, _ = derivatives(lambda R: rotation.euler_from_matrix(R, order))
    for first in (0.0, 0.7):
        about = np.array([first, middle, 0.0] if order.isupper() else [0.0, middle, first])
        R = rotation.matrix_from_euler(jnp.array(about), order)
        forward, reverse, second = (np.asarray(a) for a in both(R))
        assert np.all(np.isfinite(second))
        np.testing.assert_allclose(reverse, forward, atol=1e-12)
        # Turning on about z, the axis of the outer letter, moves that angle alone, at the rate of the turn.
        outer = 0 if order.isupper() else 2
        turn = rotation.cross_matrix(jnp.array([0.0, 0.0, 1.0])) @ R
        moved = np.einsum("aij,ij->a", forward, turn)
        np.testing.assert_allclose(moved, np.eye(3)[outer], atol=1e-12)
