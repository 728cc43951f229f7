"""Rotations by the exponential map: exact at 0 and pi, differentiable everywhere, no special casing by the caller.

A rotation vector is axis times angle [rad]; quaternions are (x, y, z, w), vector part first, as the optical
tracking document writes them (section 3) and as scipy does.

The two coefficients of Rodrigues' formula are functions of the SQUARED angle, and near zero they are summed as
power series: a quotient such as sin(t)/t loses half its digits in every derivative when t is small, and is 0/0 at
the identity, where calibrations of well-built rigs start.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmocap._arrays import Flag, Matrix3, Scalar, Vector3
from jaxmocap._errors import InputError

Quaternion = Float[Array, "4"]

# Below this squared angle the series is used. Nine terms leave (1/2)^9 / 19! < 1e-19 of the sum there.
_SERIES_BELOW = 0.5
_SERIES_SINC = tuple(
    (-1.0) ** k / f for k, f in enumerate((1.0, 6.0, 120.0, 5040.0, 362880.0, 39916800.0, 6227020800.0,
                                           1307674368000.0, 355687428096000.0))
)  # fmt: skip
_SERIES_VERSINE = tuple(
    (-1.0) ** k / f for k, f in enumerate((2.0, 24.0, 720.0, 40320.0, 3628800.0, 479001600.0, 87178291200.0,
                                           20922789888000.0, 6402373705728000.0))
)  # fmt: skip


def _series(coefficients: tuple[float, ...], x: Scalar) -> Scalar:
    total = jnp.full_like(x, coefficients[-1])
    for c in coefficients[-2::-1]:
        total = total * x + c
    return total


def rodrigues_coefficients(angle_squared: Scalar) -> tuple[Scalar, Scalar]:
    r"""The coefficients sin(t)/t and (1 - cos t)/t^2 of Rodrigues' formula as functions of t^2.

    Args:
        angle_squared: t^2 [rad^2], not negative.

    Returns:
        Both coefficients [1]; finite with finite derivatives of every order, also at 0.
    Source: optical tracking document, eq. 3.10.
    """
    small = angle_squared < _SERIES_BELOW
    # Both branches of `where` are differentiated, so each one must see an argument it likes.
    t2 = jnp.where(small, 1.0, angle_squared)
    t = jnp.sqrt(t2)
    near = jnp.where(small, angle_squared, 0.0)
    sinc = jnp.where(small, _series(_SERIES_SINC, near), jnp.sin(t) / t)
    versine = jnp.where(small, _series(_SERIES_VERSINE, near), (1.0 - jnp.cos(t)) / t2)
    return sinc, versine


def rotate(rotvec: Vector3, p: Vector3) -> Vector3:
    r"""A point turned by a rotation vector, R(rotvec) p.

    p' = p + sin(t)/t (w x p) + (1 - cos t)/t^2 w x (w x p), t = |w|. Written out in components: under `vmap` these
    become long vectors, where a 3x3 product would become a batch of tiny matrix products (measured 5 x slower).

    Args:
        rotvec: w [rad].
        p: point or direction [any unit].

    Returns:
        The turned vector, in the unit of p.
    Source: optical tracking document, eq. 3.13-3.14 (geometric form).
    """
    x, y, z = rotvec[0], rotvec[1], rotvec[2]
    a, b = rodrigues_coefficients(x * x + y * y + z * z)
    px, py, pz = p[0], p[1], p[2]
    cx, cy, cz = y * pz - z * py, z * px - x * pz, x * py - y * px
    return jnp.stack(
        [
            px + a * cx + b * (y * cz - z * cy),
            py + a * cy + b * (z * cx - x * cz),
            pz + a * cz + b * (x * cy - y * cx),
        ]
    )


def cross_matrix(v: Vector3) -> Matrix3:
    """The matrix [v]_x with [v]_x p = v x p.

    Source: optical tracking document, eq. 3.5.
    """
    zero = jnp.zeros_like(v[0])
    return jnp.stack(
        [
            jnp.stack([zero, -v[2], v[1]]),
            jnp.stack([v[2], zero, -v[0]]),
            jnp.stack([-v[1], v[0], zero]),
        ]
    )


def exp(rotvec: Vector3) -> Matrix3:
    r"""Rotation matrix of a rotation vector.

    R = I + sin(t)/t [w]_x + (1 - cos t)/t^2 [w]_x^2.

    Args:
        rotvec: w [rad], of any length; beyond pi and 2 pi it is as regular as elsewhere.

    Returns:
        R, orthonormal to rounding; exact and with exact derivatives at w = 0.
    Source: optical tracking document, eq. 3.11.
    """
    x, y, z = rotvec[0], rotvec[1], rotvec[2]
    a, b = rodrigues_coefficients(x * x + y * y + z * z)
    return jnp.stack(
        [
            jnp.stack([1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y]),
            jnp.stack([b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x]),
            jnp.stack([b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)]),
        ]
    )


def left_jacobian(rotvec: Vector3) -> Matrix3:
    r"""The matrix J with exp(w + d) = exp(J(w) d) exp(w) to first order in d.

    J = I + (1 - cos t)/t^2 [w]_x + (t - sin t)/t^3 [w]_x^2.

    Args:
        rotvec: w [rad].

    Returns:
        J [1].
    Source: derivative of the exponential map, optical tracking document section 3 (eq. 3.11); Barfoot,
        State Estimation for Robotics, eq. 7.77.
    """
    t2 = jnp.sum(rotvec * rotvec)
    a, b = rodrigues_coefficients(t2)
    small = t2 < _SERIES_BELOW
    # (1 - sinc t)/t^2; its series is that of sinc, shifted by one term.
    shifted = tuple(-c for c in _SERIES_SINC[1:])
    c = jnp.where(small, _series(shifted, jnp.where(small, t2, 0.0)), (1.0 - a) / jnp.where(small, 1.0, t2))
    k = cross_matrix(rotvec)
    return jnp.eye(3) + b * k + c * (k @ k)


def quaternion_from_matrix(R: Matrix3) -> Quaternion:
    """Unit quaternion (x, y, z, w), w >= 0, of a rotation matrix.

    Of the four textbook quotients the one with the largest divisor is used, so nothing cancels at any angle.

    Args:
        R: rotation matrix.

    Returns:
        Quaternion of norm 1; at angle pi the sign is that of the largest component.
    Source: optical tracking document, eq. 3.7; Shepperd, J. Guidance 1(3), 1978.
    """
    m00, m11, m22 = R[0, 0], R[1, 1], R[2, 2]
    four_squares = jnp.stack([1 + m00 - m11 - m22, 1 - m00 + m11 - m22, 1 - m00 - m11 + m22, 1 + m00 + m11 + m22])
    # Row k is 4 q_k times the quaternion.
    rows = jnp.stack(
        [
            jnp.stack([four_squares[0], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[2, 1] - R[1, 2]]),
            jnp.stack([R[0, 1] + R[1, 0], four_squares[1], R[1, 2] + R[2, 1], R[0, 2] - R[2, 0]]),
            jnp.stack([R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], four_squares[2], R[1, 0] - R[0, 1]]),
            jnp.stack([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], four_squares[3]]),
        ]
    )
    q = rows[jnp.argmax(four_squares)]
    q = q / jnp.sqrt(jnp.sum(q * q))
    return jnp.where(q[3] < 0, -q, q)


def rotvec_from_quaternion(q: Quaternion) -> Vector3:
    """Rotation vector, |w| <= pi, of a quaternion (x, y, z, w) of any norm but 0.

    Args:
        q: quaternion; q and -q give the same rotation.

    Returns:
        w [rad]; differentiable at the identity and at pi.
    Source: optical tracking document, eq. 3.9, inverted.
    """
    q = q / jnp.sqrt(jnp.sum(q * q))
    q = jnp.where(q[3] < 0, -q, q)
    s2 = jnp.sum(q[:3] * q[:3])
    small = s2 < 1e-4
    s = jnp.sqrt(jnp.where(small, 1.0, s2))
    far = 2.0 * jnp.arctan2(s, q[3]) / s
    # 2 asin(s)/s = 2 (1 + s^2/6 + 3 s^4/40 + 5 s^6/112 + 35 s^8/1152 + ...): the next term is 2e-22 here.
    near = 2.0 * _series((1.0, 1 / 6, 3 / 40, 5 / 112, 35 / 1152), jnp.where(small, s2, 0.0))
    return jnp.where(small, near, far) * q[:3]


def quaternion_from_rotvec(rotvec: Vector3) -> Quaternion:
    """Unit quaternion (x, y, z, w) of a rotation vector.

    Source: optical tracking document, eq. 3.9.
    """
    sinc_half, versine_half = rodrigues_coefficients(jnp.sum(rotvec * rotvec) / 4.0)
    w = 1.0 - versine_half * jnp.sum(rotvec * rotvec) / 4.0
    return jnp.concatenate([0.5 * sinc_half * rotvec, w[None]])


def matrix_from_quaternion(q: Quaternion) -> Matrix3:
    """Rotation matrix of a quaternion (x, y, z, w) of any norm but 0.

    Source: optical tracking document, eq. 3.8.
    """
    q = q / jnp.sqrt(jnp.sum(q * q))
    k = cross_matrix(q[:3])
    return jnp.eye(3) + 2.0 * q[3] * k + 2.0 * (k @ k)


def log(R: Matrix3) -> Vector3:
    """Rotation vector, |w| <= pi, of a rotation matrix.

    Goes through the quaternion: the printed quotient t / (2 sin t) is 0/0 at 0 and at pi.

    Args:
        R: rotation matrix.

    Returns:
        w [rad]; at angle pi, where w and -w are the same rotation, one of the two.
    Source: optical tracking document, eq. 3.17 and the cases beneath it.
    """
    return rotvec_from_quaternion(quaternion_from_matrix(R))


def canonical(rotvec: Vector3) -> Vector3:
    """The rotation vector of the same rotation with |w| <= pi.

    Source: optical tracking document, section 3 (the map is periodic with 2 pi along its axis).
    """
    angle = _safe_norm(rotvec)
    turns = jnp.round(angle / (2 * jnp.pi))
    return rotvec * (1.0 - 2 * jnp.pi * turns / angle)


def _safe_norm(v: Vector3) -> Scalar:
    """|v|, but 1 for v = 0, where the root has no derivative (0 times infinity is NaN in reverse mode)."""
    squared = jnp.sum(v * v)
    return jnp.sqrt(jnp.where(squared > 0, squared, 1.0))


def between(a: Vector3, b: Vector3, axis: Vector3) -> Matrix3:
    r"""The smallest rotation that takes one direction to another: R a = b without twist.

    R = c I + [v]_x + v v^T / (1 + c), v = a x b, c = a . b.

    Args:
        a: unit vector.
        b: unit vector.
        axis: unit vector perpendicular to a, by which to turn if b = -a, where every axis would do.

    Returns:
        R; finite everywhere, with derivatives where b is not -a.
    Source: stop-motion document, 6.3 (bones know a direction only); optical tracking document, eq. 3.11 rewritten.
    """
    v, c = jnp.cross(a, b), jnp.sum(a * b)
    opposite = c < -1.0 + 1e-12
    R = c * jnp.eye(3) + cross_matrix(v) + v[:, None] * v[None, :] / jnp.where(opposite, 1.0, 1.0 + c)
    half_turn = 2.0 * axis[:, None] * axis[None, :] - jnp.eye(3)
    return jnp.where(opposite, half_turn, R)


@jax.custom_jvp
def nearest_rotation(M: Matrix3) -> Matrix3:
    r"""The rotation matrix nearest to M in the Frobenius norm (determinant +1).

    With M = R S, S symmetric, dR = R [w]_x, where (tr(S) I - S) w is the vector of R^T dM - dM^T R: right at an exact
    rotation too, where the singular values are equal and a derivative through their vectors would be 0/0.

    Args:
        M: any matrix.

    Returns:
        R; differentiable wherever it is unique.
    Source: optical tracking document, 4.4.5 (re-orthonormalisation); Arun, Huang, Blostein 1987.
    """
    U, _, Vt = jnp.linalg.svd(M)
    # Determinants are +-1; written out, they need no factorisation.
    sign = jnp.sign(jnp.sum(U[0] * jnp.cross(U[1], U[2])) * jnp.sum(Vt[0] * jnp.cross(Vt[1], Vt[2])))
    return (U * jnp.stack([jnp.ones_like(sign), jnp.ones_like(sign), sign])[None, :]) @ Vt


@nearest_rotation.defjvp
def _nearest_rotation_jvp(primals: tuple[Matrix3], tangents: tuple[Matrix3]) -> tuple[Matrix3, Matrix3]:
    (M,), (dM,) = primals, tangents
    R = nearest_rotation(M)
    S, A = R.T @ M, R.T @ dM
    # R^T dM = [w] S + dS; its skew part ([w] S + S [w]) / 2 has the vector (tr(S) I - S) w / 2.
    skew = jnp.stack([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])
    w = jnp.linalg.solve(jnp.trace(S) * jnp.eye(3, dtype=S.dtype) - S, skew)
    return R, R @ cross_matrix(w)


def axis_angle_from_rotvec(rotvec: Vector3) -> tuple[Vector3, Scalar]:
    """Unit axis and angle in [0, pi] of a rotation vector; the axis of no rotation is x by convention.

    Source: optical tracking document, eq. 3.9 (w = angle times axis).
    """
    w = canonical(rotvec)
    angle = _safe_norm(w)
    turned = jnp.sum(w * w) > 0
    x_axis = jnp.array([1.0, 0.0, 0.0], dtype=w.dtype)
    return jnp.where(turned, w / angle, x_axis), jnp.where(turned, angle, 0.0)


def rotvec_from_axis_angle(axis: Vector3, angle: Scalar) -> Vector3:
    """Rotation vector of an axis (any length but 0) and an angle [rad].

    Source: optical tracking document, eq. 3.9.
    """
    return axis * (angle / jnp.sqrt(jnp.sum(axis * axis)))


def matrix_from_euler(angles: Vector3, order: str) -> Matrix3:
    """Rotation matrix of three Euler angles.

    Args:
        angles: [rad], in the order of the letters.
        order: three letters, each unlike its neighbour: capitals turn about the axes of the turning body ("ZYX":
            R = Rz Ry Rx), small letters about fixed axes ("xyz": R = Rz Ry Rx with the angles x first); as in scipy.

    Returns:
        R.

    Raises:
        InputError: if the letters are not an order.
    Source: stop-motion document, eq. 4.16 (its r_x, r_y, r_z).
    """
    _check_order(order)
    turns = [exp(jnp.eye(3)["xyz".index(c.lower())] * angles[i]) for i, c in enumerate(order)]
    if order.islower():
        turns = turns[::-1]
    return turns[0] @ turns[1] @ turns[2]


def euler_from_matrix(R: Matrix3, order: str) -> Vector3:
    """Euler angles [rad] of a rotation matrix, the inverse of `matrix_from_euler`.

    At gimbal lock (middle angle at the end of its range) only a sum or difference of the outer angles is
    determined; the third letter's angle (for capitals; the first for small letters) is then 0. For a letter that
    occurs twice ("ZXZ") the identity is such a lock. Derivatives are finite there: those of the sum or difference,
    and 0 for the others, which in truth have none there.

    Args:
        R: rotation matrix.
        order: as in `matrix_from_euler`.

    Returns:
        Angles: outer ones in (-pi, pi], the middle one in [-pi/2, pi/2] for three different letters, else [0, pi].

    Raises:
        InputError: if the letters are not an order.
    Source: stop-motion document, eq. 4.16 inverted.
    """
    _check_order(order)
    letters = order.lower() if order.isupper() else order.lower()[::-1]
    i, j = "xyz".index(letters[0]), "xyz".index(letters[1])
    k = 3 - i - j
    even = 1.0 if (j - i) % 3 == 1 else -1.0
    proper = letters[0] == letters[2]
    if proper:  # R[i, i] = cos(middle)
        sin_middle, locked = _hypot(R[i, j], R[i, k])
        middle = jnp.arctan2(sin_middle, R[i, i])
        sine, cosine = R[j, i], -even * R[k, i]
    else:  # Tait-Bryan angles: R[i, k] = +-sin(middle)
        cos_middle, locked = _hypot(R[i, i], R[i, j])
        middle = jnp.arctan2(even * R[i, k], cos_middle)
        sine, cosine = -even * R[j, k], R[k, k]
    first = jnp.arctan2(jnp.where(locked, even * R[k, j], sine), jnp.where(locked, R[j, j], cosine))
    # The last angle is read after the first turn is undone: near the lock the outer angles are badly determined one
    # by one, and read independently they would not make up the rotation again (wrong by 1e-16 / distance).
    row = jnp.cos(first) * R[j] + even * jnp.sin(first) * R[k]
    last = jnp.arctan2(-even * row[k] if proper else even * row[i], row[j])
    angles = jnp.stack([first, middle, jnp.where(locked, 0.0, last)])
    return angles if order.isupper() else angles[::-1]


def _hypot(a: Scalar, b: Scalar) -> tuple[Scalar, Flag]:
    """The length of (a, b), and whether it is too small to have a direction: its derivative is then 0, not NaN."""
    squared = a * a + b * b
    small = squared < 1e-24
    length = jnp.sqrt(jnp.where(small, 1.0, squared))
    return jnp.where(small, jnp.hypot(*jax.lax.stop_gradient((a, b))), length), small


def _check_order(order: str) -> None:
    letters = order.lower()
    if (
        len(order) != 3
        or not (order.isupper() or order.islower())
        or any(c not in "xyz" for c in letters)
        or letters[0] == letters[1]
        or letters[1] == letters[2]
    ):
        raise InputError(f"order: expected three letters of x, y, z such as 'ZYX' or 'xyz', got {order!r}")
