"""Points from the rays on which several cameras see them: as printed, well conditioned, pairwise, and by DLT.

Every function takes a mask of the views that count. Fewer than two, or rays that are all parallel, give
`valid = False` and a finite point that means nothing.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxmocap._arrays import Flag, Scalar, Vector3
from jaxmocap.cameras import Camera, ray_from_pixel, undistort

# Rays whose directions differ by less than this [rad] are parallel: a pixel seen with an error of 1e-6 of the focal
# length (a thousandth of a pixel) would move the point by more than its distance.
_PARALLEL = 1e-6


def rays(
    cameras: Camera, uv: Float[Array, "views 2"], visible: Bool[Array, "views"]
) -> tuple[Float[Array, "views 3"], Float[Array, "views 3"], Bool[Array, "views"]]:
    """Rays of one point in several views, distortion removed.

    Args:
        cameras: stacked over views.
        uv: raw pixels [px].
        visible: True where the point was seen.

    Returns:
        camera centres [scene] and unit directions in the world; True where the ray counts: seen, and inside the
        part of the image that the lens model can invert.
    Source: stop-motion document, eq. 5.1-5.8, with the distortion removed first (its 8.2).
    """
    centre, v, valid = jax.vmap(ray_from_pixel)(cameras, uv)
    use = visible & valid & jnp.all(jnp.isfinite(v), axis=1)
    ahead = jnp.array([0.0, 0.0, 1.0], dtype=v.dtype)
    return centre, jnp.where(use[:, None], v, ahead[None, :]), use


def normals_as_printed(v: Vector3) -> tuple[Vector3, Vector3]:
    """Two unit vectors perpendicular to a direction and to each other.

    v_1 = v x v_L / |v x v_L|, v_2 = v_1 x v / |v_1 x v|; the independent v_L, which the document leaves free, is the
    coordinate axis that v leans to least.

    Args:
        v: direction, of any length but 0.

    Returns:
        v_1, v_2.
    Source: stop-motion document, eq. 5.9-5.10.
    """
    v_L = jnp.eye(3, dtype=v.dtype)[jnp.argmin(jnp.abs(v))]
    v_1 = jnp.cross(v, v_L)
    v_1 = v_1 / jnp.sqrt(jnp.sum(v_1 * v_1))
    v_2 = jnp.cross(v_1, v)
    return v_1, v_2 / jnp.sqrt(jnp.sum(v_2 * v_2))


def _rows(centre: Array, v: Array, use: Array) -> tuple[Array, Array]:
    """A and y of eq. 5.11; rows of views that do not count are zero."""
    v_1, v_2 = jax.vmap(normals_as_printed)(v)
    A = jnp.concatenate([v_1, v_2])
    y = jnp.concatenate([jnp.sum(v_1 * centre, axis=1), jnp.sum(v_2 * centre, axis=1)])
    both = jnp.concatenate([use, use])
    return jnp.where(both[:, None], A, 0.0), jnp.where(both, y, 0.0)


def _determined(v: Array, use: Array) -> Flag:
    """Whether two views or more count and their rays are not all parallel."""
    n = jnp.sum(use)
    first = v[jnp.argmax(use)]
    apart = jnp.sum(jnp.cross(v, jnp.broadcast_to(first, v.shape)) ** 2, axis=1)
    return (n >= 2) & (jnp.max(jnp.where(use, apart, 0.0)) > _PARALLEL**2)


def point_as_printed(
    centre: Float[Array, "views 3"], v: Float[Array, "views 3"], use: Bool[Array, "views"]
) -> tuple[Vector3, Flag]:
    """Point of least squared distances to rays by normal equations, x = (A^T A)^-1 A^T y.

    Args:
        centre: of the cameras [scene].
        v: directions, of any length but 0.
        use: True for the views that count.

    Returns:
        point [scene]; valid.
    Source: stop-motion document, eq. 5.11-5.13.
    """
    A, y = _rows(centre, v, use)
    valid = _determined(v, use)
    AtA = jnp.where(valid, A.T @ A, jnp.eye(3, dtype=A.dtype))
    return jnp.where(valid, jnp.linalg.solve(AtA, A.T @ y), 0.0), valid


def fit_point_linear(
    centre: Float[Array, "views 3"], v: Float[Array, "views 3"], use: Bool[Array, "views"]
) -> tuple[Vector3, Flag]:
    """The same point without squaring the condition: coordinates from the mean centre, QR instead of A^T A.

    Args:
        centre: of the cameras [scene].
        v: directions, of any length but 0.
        use: True for the views that count.

    Returns:
        point [scene]; valid.
    Source: stop-motion document, eq. 5.11, solved by orthogonal factors (Golub and Van Loan, 5.3.2).
    """
    valid = _determined(v, use)
    middle = jnp.sum(jnp.where(use[:, None], centre, 0.0), axis=0) / jnp.maximum(jnp.sum(use.astype(v.dtype)), 1.0)
    A, y = _rows(centre - middle[None, :], v, use)
    # Something regular to factorise where the data are not, so that derivatives stay finite.
    A = jnp.where(valid, A, jnp.eye(*A.shape, dtype=A.dtype))
    Q, R = jnp.linalg.qr(A)
    x = jax.scipy.linalg.solve_triangular(R, Q.T @ jnp.where(valid, y, 0.0))
    return jnp.where(valid, middle + x, 0.0), valid


def midpoint(c_a: Vector3, v_a: Vector3, c_b: Vector3, v_b: Vector3) -> tuple[Vector3, Scalar, Flag]:
    """Middle of the shortest segment between two rays.

    Args:
        c_a: a point of the first ray [scene].
        v_a: its direction, of any length but 0.
        c_b: a point of the second ray.
        v_b: its direction.

    Returns:
        middle [scene]; length of the segment [scene]; False if the rays are parallel.
    Source: Hartley and Zisserman, Multiple View Geometry, 12.2 (the method they warn of, for two views); for two rays
        the same as stop-motion document, eq. 5.13.
    """
    v_a, v_b = v_a / jnp.sqrt(jnp.sum(v_a * v_a)), v_b / jnp.sqrt(jnp.sum(v_b * v_b))
    n = jnp.cross(v_a, v_b)
    s2 = jnp.sum(n * n)
    valid = s2 > _PARALLEL**2
    s2 = jnp.where(valid, s2, 1.0)
    d = c_b - c_a
    p_a = c_a + v_a * (jnp.dot(jnp.cross(d, v_b), n) / s2)
    p_b = c_b + v_b * (jnp.dot(jnp.cross(d, v_a), n) / s2)
    gap = jnp.abs(jnp.dot(d, n)) / jnp.sqrt(s2)
    return jnp.where(valid, 0.5 * (p_a + p_b), 0.0), jnp.where(valid, gap, 0.0), valid


def fit_point_dlt(cameras: Camera, uv: Float[Array, "views 2"], visible: Bool[Array, "views"]) -> tuple[Vector3, Flag]:
    """Point of the direct linear transformation: least algebraic error x P_3 - P_1, y P_3 - P_2 at unit norm.

    Args:
        cameras: stacked over views.
        uv: raw pixels [px]; distortion and K are removed first.
        visible: True where the point was seen.

    Returns:
        point [scene]; valid (False also for a point at infinity).
    Source: Hartley and Zisserman, Multiple View Geometry, 12.2; the linear step of optical tracking document, 4.4.
    """
    xy, inside = jax.vmap(lambda c, p: undistort(c.distortion, c.intrinsics.normalised_from_pixel(p)))(cameras, uv)
    use = visible & inside
    P = jax.vmap(lambda pose: pose.matrix()[:3])(cameras.T_camera_world)
    A = jnp.concatenate([xy[:, :1] * P[:, 2] - P[:, 0], xy[:, 1:] * P[:, 2] - P[:, 1]])
    A = jnp.where(jnp.concatenate([use, use])[:, None], A, 0.0)
    _, v, _ = rays(cameras, uv, visible)
    valid = _determined(v, use)
    A = jnp.where(valid, A, jnp.eye(*A.shape, dtype=A.dtype) * jnp.array([4.0, 3.0, 2.0, 1.0], dtype=A.dtype)[None, :])
    X = jnp.linalg.svd(A, full_matrices=False)[2][-1]
    valid = valid & (jnp.abs(X[3]) > 1e-12)
    return jnp.where(valid, X[:3] / jnp.where(valid, X[3], 1.0), 0.0), valid
