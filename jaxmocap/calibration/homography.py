"""Homographies between a plane and its image: linear with normalised data, then refined."""

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float

from jaxmocap._arrays import Matrix3, Vector2
from jaxmocap.geometry.projective import normalising_transform, similarity_inverse, smallest_singular_vector


def apply_homography(H: Matrix3, xy: Vector2) -> Vector2:
    """Image of a point of the plane; finite also on the line that has none. Source: eq. 4.29."""
    m = H[:, :2] @ xy + H[:, 2]
    return m[:2] / jnp.where(jnp.abs(m[2]) > 1e-300, m[2], 1.0)


def fit_homography_linear(
    xy: Float[Array, "points 2"], uv: Float[Array, "points 2"], mask: Bool[Array, "points"]
) -> Matrix3:
    """Homography by the normalised linear method.

    Args:
        xy: points of the plane [scene].
        uv: their images [px].
        mask: True where both are known; at least 4, no three of them on a line.

    Returns:
        H with uv ~ H (x, y, 1), |H| = 1, points in front (positive third coordinate on average).
    Source: optical tracking document, eq. 4.30-4.31.
    """
    T, U = normalising_transform(uv, mask), normalising_transform(xy, mask)
    m = uv * T[0, 0] + T[:2, 2][None, :]
    M = jnp.concatenate([xy * U[0, 0] + U[:2, 2][None, :], jnp.ones_like(xy[:, :1])], axis=1)
    zero = jnp.zeros_like(M)
    rows = jnp.concatenate(
        [
            jnp.concatenate([M, zero, -m[:, :1] * M], axis=1),
            jnp.concatenate([zero, M, -m[:, 1:] * M], axis=1),
        ]
    )
    rows = jnp.where(jnp.concatenate([mask, mask])[:, None], rows, 0.0)
    H = similarity_inverse(T) @ smallest_singular_vector(rows).reshape(3, 3) @ U
    depth = jnp.sum(jnp.where(mask, xy @ H[2, :2] + H[2, 2], 0.0))
    return H * jnp.where(depth < 0, -1.0, 1.0) / jnp.linalg.norm(H)


def refine_homography(
    H: Matrix3, xy: Float[Array, "points 2"], uv: Float[Array, "points 2"], mask: Bool[Array, "points"]
) -> Matrix3:
    """Homography of the smallest transfer error in the image, from a linear one.

    Args:
        H: start.
        xy: points of the plane [scene].
        uv: their images [px].
        mask: True where both are known.

    Returns:
        H with |H| = 1.
    Source: optical tracking document, 4.4.4 (geometric refinement).
    """
    T, U = normalising_transform(uv, mask), normalising_transform(xy, mask)
    m = uv * T[0, 0] + T[:2, 2][None, :]
    M = xy * U[0, 0] + U[:2, 2][None, :]
    start = T @ H @ similarity_inverse(U)
    start = start / jnp.linalg.norm(start)

    def residual(h: Matrix3, args: None) -> tuple[Array, Array]:
        del args
        error = jax.vmap(apply_homography, (None, 0))(h, M) - m
        return jnp.where(mask[:, None], error, 0.0), jnp.sum(h * h) - 1.0

    solver = optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10)
    best = optx.least_squares(residual, solver, start, max_steps=50, throw=False).value
    best = similarity_inverse(T) @ best @ U
    return best / jnp.linalg.norm(best)
