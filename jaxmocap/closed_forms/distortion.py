"""Derivatives of the Brown lens in closed form."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmocap._arrays import Vector2
from jaxmocap.cameras import BrownDistortion


def J_distorted_ideal(lens: BrownDistortion, xy: Vector2) -> Float[Array, "2 2"]:
    r"""Derivative of the real point by the ideal one.

    L I + 2 L' m m^T + tangential part, with L = 1 + k1 s + k2 s^2 + k3 s^3, L' = dL/ds, s = |m|^2.

    Args:
        lens: k1 k2 p1 p2 k3 [1].
        xy: ideal normalised point m [1].

    Returns:
        J [1].
    Source: optical tracking document, eq. 4.16-4.17 differentiated; tangential part as Brown 1966.
    """
    x, y = xy[0], xy[1]
    s = x * x + y * y
    L = 1.0 + s * (lens.k1 + s * (lens.k2 + s * lens.k3))
    slope = lens.k1 + s * (2.0 * lens.k2 + s * 3.0 * lens.k3)
    mixed = 2.0 * (slope * x * y + lens.p1 * x + lens.p2 * y)
    return jnp.stack(
        [
            jnp.stack([L + 2.0 * slope * x * x + 2.0 * lens.p1 * y + 6.0 * lens.p2 * x, mixed]),
            jnp.stack([mixed, L + 2.0 * slope * y * y + 6.0 * lens.p1 * y + 2.0 * lens.p2 * x]),
        ]
    )


def J_distorted_numbers(xy: Vector2) -> Float[Array, "2 5"]:
    r"""Derivative of the real point by k1 k2 p1 p2 k3, in which it is linear.

    Args:
        xy: ideal normalised point [1].

    Returns:
        J, columns in the order k1 k2 p1 p2 k3 [1].
    Source: optical tracking document, eq. 4.16-4.17 differentiated; tangential part as Brown 1966.
    """
    x, y = xy[0], xy[1]
    s = x * x + y * y
    return jnp.stack(
        [
            jnp.stack([x * s, x * s * s, 2.0 * x * y, s + 2.0 * x * x, x * s * s * s]),
            jnp.stack([y * s, y * s * s, s + 2.0 * y * y, 2.0 * x * y, y * s * s * s]),
        ]
    )
