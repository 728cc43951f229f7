"""Rotations by hand: quarter and half turns, the document's printed formulas, wrong calls."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from samplers import central_difference

from jaxmocap import _errors
from jaxmocap.geometry import rotation

QUARTER_Z = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
HALF_X = np.diag([1.0, -1, -1])


def test_a_quarter_turn_about_z_takes_x_to_y():
    w = jnp.array([0.0, 0.0, np.pi / 2])
    np.testing.assert_allclose(rotation.exp(w), QUARTER_Z, atol=1e-15)
    np.testing.assert_allclose(rotation.rotate(w, jnp.array([1.0, 0.0, 0.0])), [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(rotation.log(jnp.array(QUARTER_Z)), w, atol=1e-15)


def test_a_half_turn_about_x():
    w = rotation.log(jnp.array(HALF_X))
    np.testing.assert_allclose(np.abs(w), [np.pi, 0, 0], atol=1e-15)
    np.testing.assert_allclose(rotation.exp(w), HALF_X, atol=3e-16)


@pytest.mark.parametrize("axis", [[1, 1, 0], [1, -1, 0], [-1, 1, 0], [0, 1, -1], [1, 0, -1], [-1, 2, -3], [0, 0, -1]])
def test_half_turn_signs_come_from_the_off_diagonal(axis):
    a = np.array(axis) / np.linalg.norm(axis)
    w = np.asarray(rotation.log(jnp.array(2 * np.outer(a, a) - np.eye(3))))
    np.testing.assert_allclose(np.abs(w @ a), np.pi, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(w), np.pi, atol=1e-15)


def test_exp_is_exact_at_zero_and_log_at_the_identity():
    assert np.array_equal(rotation.exp(jnp.zeros(3)), np.eye(3))
    assert np.array_equal(rotation.log(jnp.eye(3)), np.zeros(3))


def test_the_document_s_formula_3_10_gives_the_same_matrix():
    w = np.array([0.3, -1.1, 0.7])
    t = np.sqrt(w @ w)
    cross = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    printed = np.cos(t) * np.eye(3) + np.sin(t) / t * cross + (1 - np.cos(t)) / t**2 * np.outer(w, w)
    np.testing.assert_allclose(rotation.exp(jnp.array(w)), printed, atol=1e-15)


def test_cross_matrix_is_the_cross_product():
    v, p = np.array([1.0, 2, 3]), np.array([-4.0, 5, 6])
    np.testing.assert_allclose(rotation.cross_matrix(jnp.array(v)) @ p, [-3, -18, 13])  # 2*6-3*5, 3*-4-1*6, 1*5-2*-4


@pytest.mark.parametrize("t", [0.0, 1e-8, 1e-3, 0.1, 0.7, 0.70711, 0.708, 1.0, 3.0, 10.0])
def test_rodrigues_coefficients_against_exact_arithmetic(t):
    """Sums the two series in rational arithmetic; 0.7071... is where the code changes from series to quotient."""
    from fractions import Fraction
    from math import factorial

    x = Fraction(t * t)
    exact = [sum((-1) ** k * x**k / factorial(2 * k + m) for k in range(40)) for m in (1, 2)]
    derivative = [sum((-1) ** k * k * x ** (k - 1) / factorial(2 * k + m) for k in range(1, 40)) for m in (1, 2)]
    got, slope = jax.jvp(rotation.rodrigues_coefficients, (jnp.array(t * t),), (jnp.array(1.0),))
    np.testing.assert_allclose(got, [float(e) for e in exact], rtol=0, atol=2e-16)
    np.testing.assert_allclose(slope, [float(e) for e in derivative], rtol=0, atol=4e-16)


def test_quaternion_of_a_third_of_a_turn_about_the_diagonal():
    """x -> y -> z -> x is 120 degrees about (1, 1, 1): q = (1, 1, 1, 1) / 2."""
    R = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_allclose(rotation.quaternion_from_matrix(jnp.array(R)), [0.5] * 4, atol=1e-15)
    np.testing.assert_allclose(rotation.matrix_from_quaternion(jnp.array([2.0, 2, 2, 2])), R, atol=1e-15)
    third = 2 * np.pi / 3 / np.sqrt(3) * np.ones(3)
    np.testing.assert_allclose(rotation.rotvec_from_quaternion(jnp.array([-3.0, -3, -3, -3])), third, atol=1e-15)
    np.testing.assert_allclose(rotation.quaternion_from_rotvec(jnp.array(third)), [0.5] * 4, atol=1e-15)


def test_the_document_s_quaternion_rule_3_8_turns_points_alike():
    q = np.array([0.1, -0.5, 0.3, 0.8]) / np.linalg.norm([0.1, -0.5, 0.3, 0.8])
    v, s, p = q[:3], q[3], np.array([1.0, 2, -1])
    printed = (s * s - v @ v) * p + 2 * s * np.cross(v, p) + 2 * (v @ p) * v
    np.testing.assert_allclose(rotation.matrix_from_quaternion(jnp.array(q)) @ p, printed, atol=1e-15)


def test_canonical_by_hand():
    for angle, expected in [
        (0.0, 0.0),
        (3.0, 3.0),
        (4.0, 4.0 - 2 * np.pi),
        (7.0, 7.0 - 2 * np.pi),
        (-4, 2 * np.pi - 4),
    ]:
        got = rotation.canonical(jnp.array([0.0, angle, 0.0]))
        np.testing.assert_allclose(got, [0, expected, 0], atol=1e-15)


def test_canonical_can_be_differentiated_at_zero_both_ways():
    np.testing.assert_allclose(jax.jacfwd(rotation.canonical)(jnp.zeros(3)), np.eye(3))
    np.testing.assert_allclose(jax.jacrev(rotation.canonical)(jnp.zeros(3)), np.eye(3))


def test_axis_and_angle_by_hand():
    axis, angle = rotation.axis_angle_from_rotvec(jnp.array([0.0, 0.0, -1.5]))
    np.testing.assert_allclose(axis, [0, 0, -1])
    np.testing.assert_allclose(angle, 1.5)
    axis, angle = rotation.axis_angle_from_rotvec(jnp.zeros(3))
    assert np.array_equal(axis, [1, 0, 0]) and angle == 0
    np.testing.assert_allclose(
        rotation.rotvec_from_axis_angle(jnp.array([0.0, 3.0, 4.0]), jnp.array(2.0)), [0, 1.2, 1.6]
    )


def test_axis_and_angle_beyond_pi_turn_the_other_way():
    axis, angle = rotation.axis_angle_from_rotvec(jnp.array([4.0, 0.0, 0.0]))
    np.testing.assert_allclose(axis, [-1, 0, 0])
    np.testing.assert_allclose(angle, 2 * np.pi - 4)


def test_left_jacobian_at_zero_and_for_a_half_turn():
    assert np.array_equal(rotation.left_jacobian(jnp.zeros(3)), np.eye(3))
    # Half a turn about z: I + 2/pi^2 [w] + 1/pi^2 [w]^2 with w = pi e_z.
    expected = np.array([[0, -2 / np.pi, 0], [2 / np.pi, 0, 0], [0, 0, 1.0]])
    np.testing.assert_allclose(rotation.left_jacobian(jnp.array([0, 0, np.pi])), expected, atol=1e-15)


def test_nearest_rotation_by_hand():
    np.testing.assert_allclose(rotation.nearest_rotation(jnp.array(3.0 * QUARTER_Z)), QUARTER_Z, atol=1e-15)
    # The nearest rotation to diag(1, 1, -0.1) flips back the axis that costs least.
    np.testing.assert_allclose(rotation.nearest_rotation(jnp.diag(jnp.array([1.0, 1, -0.1]))), np.eye(3), atol=1e-15)


def test_nearest_rotation_beats_every_neighbour():
    rng = np.random.default_rng(0)
    for M in rng.normal(size=(5, 3, 3)):
        R = np.asarray(rotation.nearest_rotation(jnp.array(M)))
        assert np.isclose(np.linalg.det(R), 1)
        for d in 1e-3 * rng.normal(size=(20, 3)):
            other = R @ (np.eye(3) + np.cross(np.eye(3), d))
            other = np.linalg.qr(other)[0] * np.sign(np.diag(np.linalg.qr(other)[1]))[None, :]
            assert np.linalg.norm(M - R) < np.linalg.norm(M - other)


def test_stop_motion_rotation_is_rz_ry_rx():
    x, y, z = 0.2, -0.4, 0.9
    Rx = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    Ry = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    Rz = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    for angles, order in [((z, y, x), "ZYX"), ((x, y, z), "xyz")]:
        np.testing.assert_allclose(rotation.matrix_from_euler(jnp.array(angles), order), Rz @ Ry @ Rx, atol=1e-15)
        np.testing.assert_allclose(rotation.euler_from_matrix(jnp.array(Rz @ Ry @ Rx), order), angles, atol=1e-15)


@pytest.mark.parametrize("order", ["", "xy", "xxz", "xzz", "abc", "Xyz", "xyzx", "xyx "])
def test_a_wrong_order_is_refused(order):
    for call in (
        lambda: rotation.matrix_from_euler(jnp.zeros(3), order),
        lambda: rotation.euler_from_matrix(jnp.eye(3), order),
    ):
        with pytest.raises(_errors.InputError, match="order: expected three letters"):
            call()


def test_closed_form_of_central_difference_helper():
    """The helper that other tests compare with gets a known derivative right."""
    J = central_difference(lambda x: np.array([x[0] ** 2, x[0] * x[1]]), np.array([2.0, 3.0]))
    np.testing.assert_allclose(J, [[4, 0], [3, 2]], rtol=1e-9)
