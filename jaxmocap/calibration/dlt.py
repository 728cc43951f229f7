"""Projection matrices from known points: linear, refined, and taken apart."""

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float

from jaxmocap._arrays import Matrix3, Vector3
from jaxmocap.geometry.projective import (
    determinant,
    normalising_transform,
    rq,
    similarity_inverse,
    smallest_singular_vector,
)


def fit_projection_linear(
    points: Float[Array, "points 3"], uv: Float[Array, "points 2"], mask: Bool[Array, "points"]
) -> Float[Array, "3 4"]:
    r"""Projection matrix by the normalised direct linear transform.

    Args:
        points: known points in space, not all in one plane.
        uv: their images [px].
        mask: True where both are known; at least 6.

    Returns:
        P with |P| = 1 and points in front (P's third row times a point is positive on average).
    Source: optical tracking document, eq. 4.24-4.25, algorithms 1-2.
    """
    T, U = normalising_transform(uv, mask), normalising_transform(points, mask)
    m = uv * T[0, 0] + T[:2, 2][None, :]
    M = jnp.concatenate([points * U[0, 0] + U[:3, 3][None, :], jnp.ones_like(points[:, :1])], axis=1)
    zero = jnp.zeros_like(M)
    rows = jnp.concatenate(
        [
            jnp.concatenate([M, zero, -m[:, :1] * M], axis=1),
            jnp.concatenate([zero, M, -m[:, 1:] * M], axis=1),
        ]
    )
    rows = jnp.where(jnp.concatenate([mask, mask])[:, None], rows, 0.0)
    P = smallest_singular_vector(rows).reshape(3, 4)
    P = similarity_inverse(T) @ P @ U
    depth = jnp.sum(jnp.where(mask, points @ P[2, :3] + P[2, 3], 0.0))
    return P * jnp.where(depth < 0, -1.0, 1.0) / jnp.linalg.norm(P)


def project_with_matrix(P: Float[Array, "3 4"], p: Vector3) -> Float[Array, "2"]:
    """Pixel of a point by a projection matrix; finite also on the plane that has none.

    Source: optical tracking document, eq. 4.13.
    """
    m = P[:, :3] @ p + P[:, 3]
    w = jnp.where(jnp.abs(m[2]) > 1e-300, m[2], 1.0)
    return m[:2] / w


def refine_projection(
    P: Float[Array, "3 4"],
    points: Float[Array, "points 3"],
    uv: Float[Array, "points 2"],
    mask: Bool[Array, "points"],
) -> Float[Array, "3 4"]:
    """Projection matrix of the smallest reprojection error, from a linear one.

    Args:
        P: start, as `fit_projection_linear` returns it.
        points: known points.
        uv: their images [px].
        mask: True where both are known.

    Returns:
        P with |P| = 1.
    Source: optical tracking document, algorithm 2 (sum of squared distances by Levenberg-Marquardt).
    """
    T, U = normalising_transform(uv, mask), normalising_transform(points, mask)
    m = uv * T[0, 0] + T[:2, 2][None, :]
    M = points * U[0, 0] + U[:3, 3][None, :]
    start = T @ P @ similarity_inverse(U)
    start = start / jnp.linalg.norm(start)

    def residual(p: Float[Array, "3 4"], args: None) -> tuple[Array, Array]:
        del args
        error = jax.vmap(project_with_matrix, (None, 0))(p, M) - m
        # The scale of P is free: one more residual holds it.
        return jnp.where(mask[:, None], error, 0.0), jnp.sum(p * p) - 1.0

    solver = optx.LevenbergMarquardt(rtol=1e-12, atol=1e-12)
    best = optx.least_squares(residual, solver, start, max_steps=200, throw=False).value
    best = similarity_inverse(T) @ best @ U
    return best / jnp.linalg.norm(best)


def decompose_projection(P: Float[Array, "3 4"]) -> tuple[Matrix3, Matrix3, Vector3]:
    """K, R and camera centre of a projection matrix P = s K R [I | -C], K[2, 2] = 1, det R = +1.

    Args:
        P: projection matrix with a regular left 3x3 block, any scale or sign.

    Returns:
        K with positive diagonal, R (world -> camera), C in world coordinates.
    Source: optical tracking document, eq. 4.26 and 4.4.3.
    """
    M = P[:, :3]
    M = M * jnp.where(determinant(M) < 0, -1.0, 1.0)
    K, R = rq(M)
    return K / K[2, 2], R, -jnp.linalg.solve(P[:, :3], P[:, 3])
