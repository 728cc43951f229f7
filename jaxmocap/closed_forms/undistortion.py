"""Removing distortion by repetition: as the optical tracking document prints it, and as it must read to converge."""

import jax
import jax.numpy as jnp

from jaxmocap._arrays import Vector2
from jaxmocap.cameras import BrownDistortion, Intrinsics


def undistort_pixel_printed(intrinsics: Intrinsics, lens: BrownDistortion, uv: Vector2, steps: int) -> Vector2:
    r"""The printed iteration, n steps, in pixels. It does NOT return the inverse.

    u <- (u + u0 k)/k,  v <- (v + v0 k)/k,  with k = kappa1 r^2 + kappa2 r^4 and r the normalised radius of (u, v).

    Two things are wrong with it. The divisor must be 1 + k, from solving u_d = u_u + (u_u - u0) k (4.20) for u_u;
    without the 1 an almost ideal lens (k near 0) divides by almost nothing. And the numerator must hold the observed
    pixel in every step, not the last estimate, or each step removes the distortion once more.

    Args:
        intrinsics: K [px].
        lens: kappa1 and kappa2 are used.
        uv: observed pixel [px].
        steps: n.

    Returns:
        The n-th iterate [px]; not finite when it meets k = 0.
    Source: optical tracking document, eq. 4.22-4.23, literally.
    """
    centre = jnp.stack([intrinsics.cx, intrinsics.cy])

    def step(_, current: Vector2) -> Vector2:
        k = _k(lens, intrinsics.normalised_from_pixel(current))
        return (current + centre * k) / k

    return jax.lax.fori_loop(0, steps, step, uv)


def undistort_pixel_corrected(intrinsics: Intrinsics, lens: BrownDistortion, uv: Vector2, steps: int) -> Vector2:
    r"""The fixed-point iteration that (4.20)-(4.21) lead to, n steps, in pixels.

    u <- (u_d + u0 k)/(1 + k), the same for v, with k at the last estimate and u_d the observed pixel throughout.
    Converges linearly, at a rate of about 2 |k|; `cameras.undistort` is Newton's method on the same equation.

    Args:
        intrinsics: K [px].
        lens: kappa1 and kappa2 are used.
        uv: observed pixel [px].
        steps: n.

    Returns:
        The n-th iterate [px].
    Source: optical tracking document, eq. 4.20-4.21 solved for the ideal pixel; replaces 4.22-4.23.
    """
    centre = jnp.stack([intrinsics.cx, intrinsics.cy])

    def step(_, current: Vector2) -> Vector2:
        k = _k(lens, intrinsics.normalised_from_pixel(current))
        return (uv + centre * k) / (1.0 + k)

    return jax.lax.fori_loop(0, steps, step, uv)


def _k(lens: BrownDistortion, xy: Vector2):
    r2 = jnp.sum(xy * xy)
    return lens.k1 * r2 + lens.k2 * r2 * r2
