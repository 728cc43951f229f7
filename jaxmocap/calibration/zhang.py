"""Intrinsics and poses from homographies of a plane (Zhang), and the first estimate of the lens.

Everything here is algebra for start values; `calibration.boards` refines.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxmocap._arrays import Flag, Matrix3
from jaxmocap.cameras import Intrinsics
from jaxmocap.geometry import Pose, rotation
from jaxmocap.geometry.projective import determinant, similarity_inverse, smallest_singular_vector


def conic_rows(H: Matrix3) -> Float[Array, "2 6"]:
    """The two linear equations that a homography gives for the image of the absolute conic.

    Unknowns (b11, b12, b22, b13, b23, b33) of B = K^-T K^-1; rows h1' B h2 = 0 and h1' B h1 - h2' B h2 = 0.

    Source: optical tracking document, eq. 4.37-4.40 (the fourth entry of its printed second row has a misprint).
    """

    def v(i: int, j: int) -> Float[Array, "6"]:
        a, b = H[:, i], H[:, j]
        return jnp.stack(
            [
                a[0] * b[0],
                a[0] * b[1] + a[1] * b[0],
                a[1] * b[1],
                a[2] * b[0] + a[0] * b[2],
                a[2] * b[1] + a[1] * b[2],
                a[2] * b[2],
            ]
        )

    return jnp.stack([v(0, 1), v(0, 0) - v(1, 1)])


def intrinsics_from_conic(b: Float[Array, "6"]) -> tuple[Intrinsics, Flag]:
    """Calibration matrix of the image of the absolute conic.

    Args:
        b: (b11, b12, b22, b13, b23, b33) up to scale.

    Returns:
        intrinsics [px], and False if the conic is not positive definite (no real camera), in which case the
        numbers mean nothing but are finite.
    Source: optical tracking document, eq. 4.32; Zhang, PAMI 22(11), 2000, appendix B.
    """
    b = b * jnp.where(b[0] < 0, -1.0, 1.0)
    B = jnp.stack([jnp.stack([b[0], b[1], b[3]]), jnp.stack([b[1], b[2], b[4]]), jnp.stack([b[3], b[4], b[5]])])
    minor = b[0] * b[2] - b[1] * b[1]
    real = (b[0] > 0) & (minor > 0) & (determinant(B) > 0)
    det = jnp.where(real, minor, 1.0)
    b11 = jnp.where(real, b[0], 1.0)
    cy = (b[1] * b[3] - b[0] * b[4]) / det
    scale = b[5] - (b[3] * b[3] + cy * (b[1] * b[3] - b[0] * b[4])) / b11
    scale = jnp.where(real, scale, 1.0)
    fx = jnp.sqrt(jnp.abs(scale / b11))
    fy = jnp.sqrt(jnp.abs(scale * b11 / det))
    skew = -b[1] * fx * fx * fy / scale
    cx = skew * cy / fy - b[3] * fx * fx / scale
    return Intrinsics(fx=fx, fy=fy, cx=cx, cy=cy, skew=skew), real & jnp.isfinite(fx) & jnp.isfinite(fy)


def fit_intrinsics_linear(
    homographies: Float[Array, "views 3 3"],
    mask: Bool[Array, "views"],
    image_size: tuple[Float[Array, ""] | float | int, Float[Array, ""] | float | int],
    skew: bool = False,
) -> tuple[Intrinsics, Flag]:
    r"""Calibration matrix from the homographies of a plane.

    Pixels are first brought to the order of 1 (origin at the image centre, unit = image width), so that the six
    unknowns have one size. Without skew the equation b12 = 0 is appended, which is what makes two views enough.

    Args:
        homographies: plane -> image [px], any scale.
        mask: True for the views that count; at least 2 without skew, 3 with.
        image_size: (width, height) [px].
        skew: whether K[0][1] is sought.

    Returns:
        intrinsics [px], and whether they belong to a real camera.
    Source: optical tracking document, eq. 4.32-4.40; Zhang 2000, section 3.1.
    """
    width, height = image_size
    cx, cy = 0.5 * (width - 1) / width, 0.5 * (height - 1) / width
    N = jnp.array([[1.0 / width, 0.0, -cx], [0.0, 1.0 / width, -cy], [0.0, 0.0, 1.0]])

    def rows(H: Matrix3) -> Float[Array, "2 6"]:
        G = N @ H
        # Comparable rows whatever the unit of the board: the first two columns carry its scale.
        return conic_rows(G / jnp.sqrt(jnp.linalg.norm(G[:, 0]) * jnp.linalg.norm(G[:, 1])))

    V = jnp.where(mask[:, None, None], jax.vmap(rows)(homographies), 0.0).reshape(-1, 6)
    if not skew:
        no_skew = jnp.zeros((1, 6)).at[0, 1].set(jnp.maximum(1.0, jnp.linalg.norm(V)))
        V = jnp.concatenate([V, no_skew])
    b = smallest_singular_vector(V)
    found, real = intrinsics_from_conic(b)
    K = similarity_inverse(N) @ found.matrix()
    result = Intrinsics.from_matrix(K)
    if not skew:
        result = Intrinsics(result.fx, result.fy, result.cx, result.cy, jnp.zeros_like(result.fx))
    return result, real


def fit_focal_linear(
    homographies: Float[Array, "views 3 3"],
    mask: Bool[Array, "views"],
    image_size: tuple[Float[Array, ""] | float | int, Float[Array, ""] | float | int],
) -> tuple[Intrinsics, Flag]:
    """One focal length with the principal point in the image centre: what two nearly parallel views still give.

    With K = diag(f, f, 1) about the centre, both equations of `conic_rows` are linear in 1/f^2.

    Args:
        homographies: plane -> image [px].
        mask: True for the views that count; at least 1.
        image_size: (width, height) [px].

    Returns:
        intrinsics [px] with fx = fy, and whether 1/f^2 came out positive.
    Source: optical tracking document, eq. 4.35-4.38 with the unknowns reduced.
    """
    width, height = image_size
    centre = 0.5 * jnp.array([width - 1.0, height - 1.0])

    def rows(H: Matrix3) -> tuple[Array, Array]:
        G = jnp.concatenate([H[:2] - centre[:, None] * H[2:], H[2:]])
        G = G / jnp.sqrt(jnp.linalg.norm(G[:, 0]) * jnp.linalg.norm(G[:, 1]))
        a, b = G[:, 0], G[:, 1]
        left = jnp.stack([a[0] * b[0] + a[1] * b[1], a[0] ** 2 + a[1] ** 2 - b[0] ** 2 - b[1] ** 2])
        right = -jnp.stack([a[2] * b[2], a[2] ** 2 - b[2] ** 2])
        return left, right

    left, right = jax.vmap(rows)(homographies)
    left = jnp.where(mask[:, None], left, 0.0)
    top, bottom = jnp.sum(left * jnp.where(mask[:, None], right, 0.0)), jnp.sum(left * left)
    w = top / jnp.where(bottom > 0, bottom, 1.0)
    real = (bottom > 0) & (w > 0)
    f = 1.0 / jnp.sqrt(jnp.where(real, w, 1.0 / width**2))
    return Intrinsics(f, f, centre[0], centre[1], jnp.zeros_like(f)), real


def pose_from_homography(K: Matrix3, H: Matrix3) -> Pose:
    """Pose T_camera_board of a plane from its homography, with the nearest rotation.

    Args:
        K: calibration matrix [px].
        H: board plane (z = 0) -> image [px], points in front.

    Returns:
        T_camera_board; the board is in front of the camera.
    Source: optical tracking document, eq. 4.33 and the end of 4.4.5.
    """
    # K^-1 H in closed form: K is upper triangular.
    y = (H[1] - K[1, 2] * H[2]) / K[1, 1]
    G = jnp.stack([(H[0] - K[0, 2] * H[2] - K[0, 1] * y) / K[0, 0], y, H[2]])
    G = G * jnp.where(G[2, 2] < 0, -1.0, 1.0)
    scale = 2.0 / (jnp.linalg.norm(G[:, 0]) + jnp.linalg.norm(G[:, 1]))
    G = G * scale
    R = rotation.nearest_rotation(jnp.stack([G[:, 0], G[:, 1], jnp.cross(G[:, 0], G[:, 1])], axis=1))
    return Pose(rotation.log(R), G[:, 2])


def mirrored_pose(T_camera_board: Pose, centre_board: Float[Array, "3"]) -> Pose:
    """The other pose that a small or distant plane could have: tilted the other way about its viewing ray.

    The normal n is reflected in the viewing direction v of the board's centre (n' = 2 (n.v) v - n), turning the
    board by pi about v and by pi in its own plane; the centre keeps its place.

    Args:
        T_camera_board: one pose.
        centre_board: centre of the seen points in the board's frame [scene].

    Returns:
        T_camera_board of the mirrored pose.
    Source: Schweighofer and Pinz, PAMI 28(12), 2006 (two minima of a planar pose).
    """
    R = rotation.exp(T_camera_board.rotvec)
    centre = T_camera_board.act(centre_board)
    v = centre / jnp.linalg.norm(centre)
    about_ray = 2.0 * v[:, None] * v[None, :] - jnp.eye(3)
    in_plane = jnp.array([[-1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0]])
    R_mirrored = about_ray @ R @ in_plane
    return Pose(rotation.log(R_mirrored), centre - R_mirrored @ centre_board)


def fit_distortion_linear(
    ideal_uv: Float[Array, "points 2"],
    seen_uv: Float[Array, "points 2"],
    mask: Bool[Array, "points"],
    K: Matrix3,
) -> tuple[Array, Array]:
    r"""kappa1 and kappa2 from where points would be imaged without a lens and where they are.

    (u_d - u_u) = (u_u - u_0) (k1 r^2 + k2 r^4), v alike: linear in both, r in normalised coordinates.

    Args:
        ideal_uv: projections without distortion [px].
        seen_uv: measured pixels.
        mask: True where both are known.
        K: calibration matrix.

    Returns:
        kappa1, kappa2 [1].
    Source: optical tracking document, eq. 4.41-4.45, with r^2, r^4 where 4.43 prints r, r^2.
    """
    offset = ideal_uv - K[:2, 2][None, :]
    y = offset[:, 1] / K[1, 1]
    x = (offset[:, 0] - K[0, 1] * y) / K[0, 0]
    r2 = x * x + y * y
    D = jnp.stack([(offset * r2[:, None]).reshape(-1), (offset * (r2 * r2)[:, None]).reshape(-1)], axis=1)
    d = (seen_uv - ideal_uv).reshape(-1)
    keep = jnp.repeat(mask, 2)
    D, d = jnp.where(keep[:, None], D, 0.0), jnp.where(keep, d, 0.0)
    # Two unknowns: the normal equations of unit columns, by Cramer's rule; no distortion where they are singular.
    size = jnp.sqrt(jnp.sum(D * D, axis=0))
    size = jnp.where(size > 0, size, 1.0)
    D = D / size[None, :]
    mixed, right = jnp.sum(D[:, 0] * D[:, 1]), jnp.sum(D * d[:, None], axis=0)
    determined = 1.0 - mixed * mixed > 1e-12
    divisor = jnp.where(determined, 1.0 - mixed * mixed, 1.0)
    k1, k2 = (right[0] - mixed * right[1]) / divisor, (right[1] - mixed * right[0]) / divisor
    return jnp.where(determined, k1 / size[0], 0.0), jnp.where(determined, k2 / size[1], 0.0)
