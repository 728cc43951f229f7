"""Derivatives of the exponential map in closed form."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmocap._arrays import Matrix3, Scalar, Vector3
from jaxmocap.geometry import rotation

# Taylor series in t^2 of (t cos t - sin t)/t^3 and (t sin t - 2 (1 - cos t))/t^4. Both quotients are 0/0 at 0 and
# lose 1e-16/t^3 near it, so the series is used below t = 1; nine terms leave less than 1e-17 there.
_SINC_SLOPE = (-1 / 3, 1 / 30, -1 / 840, 1 / 45360, -1 / 3991680, 1 / 518918400, -1 / 93405312000,
               1 / 22230464256000, -1 / 6758061133824000)  # fmt: skip
_VERSINE_SLOPE = (-1 / 12, 1 / 180, -1 / 6720, 1 / 453600, -1 / 47900160, 1 / 7264857600, -1 / 1494484992000,
                  1 / 400148356608000, -1 / 135161222676480000)  # fmt: skip


def J_rotated_rotvec(rotvec: Vector3, p: Vector3) -> Matrix3:
    r"""Derivative of R(w) p by w.

    d(R p)/dw = - sin t/t [p] + (t cos t - sin t)/t^3 (w x p) w^T + (t sin t - 2 (1 - cos t))/t^4 (w x (w x p)) w^T
    + (1 - cos t)/t^2 (-[w x p] + (w.p) I - p w^T), with [a] the matrix of a x.

    Args:
        rotvec: w [rad].
        p: the point turned [any unit].

    Returns:
        J, row = coordinate of the turned point [unit of p per rad].
    Source: optical tracking document, derivative of W P below eq. 5.42 with a time step of 1.
    """
    t2 = jnp.sum(rotvec * rotvec)
    sinc, versine = rotation.rodrigues_coefficients(t2)
    sinc_slope, versine_slope = _slopes(t2)
    across = jnp.cross(rotvec, p)
    twice = jnp.cross(rotvec, across)
    return (
        -sinc * rotation.cross_matrix(p)
        + jnp.outer(sinc_slope * across + versine_slope * twice, rotvec)
        + versine * (-rotation.cross_matrix(across) + jnp.dot(rotvec, p) * jnp.eye(3) - jnp.outer(p, rotvec))
    )


def J_matrix_rotvec(rotvec: Vector3) -> Float[Array, "3 3 3"]:
    r"""Derivative of the rotation matrix exp(w) by w: [:, :, i] = [J e_i] exp(w), J the left Jacobian.

    Args:
        rotvec: w [rad].

    Returns:
        Derivative, last axis = coordinate of w [1/rad].
    Source: optical tracking document, eq. 3.11 differentiated; Barfoot, State Estimation for Robotics, eq. 7.77.
    """
    R, J = rotation.exp(rotvec), rotation.left_jacobian(rotvec)
    return jnp.stack([rotation.cross_matrix(J[:, i]) @ R for i in range(3)], axis=-1)


def _slopes(t2: Scalar) -> tuple[Scalar, Scalar]:
    """The two quotients of the docstring above, twice the derivatives of Rodrigues' coefficients by t^2."""
    small = t2 < 1.0
    t = jnp.sqrt(jnp.where(small, 1.0, t2))
    near = jnp.where(small, t2, 0.0)
    far_sinc = (t * jnp.cos(t) - jnp.sin(t)) / t**3
    far_versine = (t * jnp.sin(t) - 2.0 * (1.0 - jnp.cos(t))) / t**4
    series = [jnp.polyval(jnp.array(c[::-1]), near) for c in (_SINC_SLOPE, _VERSINE_SLOPE)]
    return jnp.where(small, series[0], far_sinc), jnp.where(small, series[1], far_versine)
