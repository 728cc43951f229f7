"""Homogeneous coordinates: normalising transforms, RQ decomposition, null vectors."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxmocap._arrays import Matrix3


def homogeneous(p: Float[Array, "d"]) -> Float[Array, "d1"]:
    """The point with a 1 appended."""
    return jnp.concatenate([p, jnp.ones_like(p[:1])])


def normalising_transform(points: Float[Array, "points d"], mask: Bool[Array, "points"]) -> Float[Array, "d1 d1"]:
    r"""Similarity that brings the centroid to the origin and the RMS distance from it to sqrt(d).

    Without it the columns of a linear system for P, H or F differ by factors of a million and the smallest
    singular vector is mostly rounding.

    Args:
        points: image points (d = 2) or space points (d = 3).
        mask: True where the point counts.

    Returns:
        Homogeneous transform T; points that all coincide are only moved.
    Source: optical tracking document, 4.4.2.
    """
    d = points.shape[1]
    weight = mask.astype(points.dtype)
    count = jnp.maximum(jnp.sum(weight), 1.0)
    kept = jnp.where(mask[:, None], points, 0.0)
    centroid = jnp.sum(kept, axis=0) / count
    spread = jnp.sum(weight[:, None] * (kept - centroid[None, :]) ** 2) / count
    scale = jnp.where(spread > 0, jnp.sqrt(d / jnp.where(spread > 0, spread, 1.0)), 1.0)
    top = jnp.concatenate([scale * jnp.eye(d, dtype=points.dtype), -scale * centroid[:, None]], axis=1)
    return jnp.concatenate([top, jnp.zeros((1, d + 1), points.dtype).at[0, d].set(1.0)])


def similarity_inverse(T: Float[Array, "d1 d1"]) -> Float[Array, "d1 d1"]:
    """Inverse of a scaling and a shift, as `normalising_transform` makes them, in closed form."""
    d = T.shape[0] - 1
    scale = 1.0 / T[0, 0]
    top = jnp.concatenate([scale * jnp.eye(d, dtype=T.dtype), -scale * T[:d, d:]], axis=1)
    return jnp.concatenate([top, jnp.zeros((1, d + 1), T.dtype).at[0, d].set(1.0)])


def determinant(M: Matrix3) -> Float[Array, ""]:
    """Determinant of a 3x3 matrix, written out: a factorisation takes long to compile and is no more accurate."""
    return jnp.sum(M[0] * jnp.cross(M[1], M[2]))


def smallest_singular_vector(A: Float[Array, "rows columns"]) -> Float[Array, "columns"]:
    """Unit vector x that minimises |A x|.

    Source: optical tracking document, algorithm 1.
    """
    return jnp.linalg.svd(A, full_matrices=False)[2][-1] if A.shape[0] >= A.shape[1] else _wide_null(A)


def _wide_null(A: Float[Array, "rows columns"]) -> Float[Array, "columns"]:
    return jnp.linalg.svd(A, full_matrices=True)[2][-1]


def rq(M: Matrix3) -> tuple[Matrix3, Matrix3]:
    """M = K R with K upper triangular of positive diagonal and R orthonormal (det R has the sign of det M).

    Args:
        M: regular 3x3 matrix.

    Returns:
        K, R.
    Source: optical tracking document, 4.4.3 (RQ decomposition of the left 3x3 block of P).
    """
    # QR of the matrix with rows reversed and transposed gives RQ after undoing both.
    flip = jnp.eye(3, dtype=M.dtype)[::-1]
    Q, U = jnp.linalg.qr((flip @ M).T)
    K, R = flip @ U.T @ flip, flip @ Q.T
    sign = jnp.where(jnp.diagonal(K) < 0, -1.0, 1.0)
    return K * sign[None, :], sign[:, None] * R
