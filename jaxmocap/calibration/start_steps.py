"""The compiled steps of `calibration.start`: candidates for a lens, tried at once; poses for a lens."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxmocap._programs import program
from jaxmocap.calibration.boards import Lens
from jaxmocap.calibration.dlt import decompose_projection, fit_projection_linear
from jaxmocap.calibration.homography import fit_homography_linear
from jaxmocap.calibration.zhang import (
    fit_distortion_linear,
    fit_focal_linear,
    fit_intrinsics_linear,
    mirrored_pose,
    pose_from_homography,
)
from jaxmocap.cameras import BrownDistortion, Intrinsics, pixel_of_point
from jaxmocap.geometry import Pose, rotation

_STEPS = 6


def pose_steps(
    lens: Lens, T: Pose, points: Array, uv: Array, seen: Array, steps: int = _STEPS
) -> tuple[Pose, Float[Array, ""]]:
    """A few damped Gauss-Newton steps on one pose, and the sum of squared residuals [px^2] it ends with."""

    def residual(z: Array) -> Array:
        pose = Pose(z[:3], z[3:])
        predicted = jax.vmap(lambda p: pixel_of_point(lens.intrinsics, lens.distortion, pose.act(p)))(points)
        return jnp.where(seen[:, None], predicted - uv, 0.0).reshape(-1)

    def body(carry: tuple[Array, Array, Array, Array], _: None):
        z, trial, cost, damping = carry
        # One evaluation serves the test of the last trial and the linearisation at it.
        J, r = jax.jacfwd(lambda z: (residual(z),) * 2, has_aux=True)(trial)
        better = jnp.sum(r * r) < cost
        z, cost = jnp.where(better, trial, z), jnp.where(better, jnp.sum(r * r), cost)
        damping = damping * jnp.where(better, 0.2, 20.0)
        A = J.T @ J
        D = jnp.diag(jnp.where(jnp.diagonal(A) > 0, jnp.diagonal(A), 1.0))
        step = jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(A + damping * D), True), J.T @ r)
        return (z, jnp.where(better, z - step, 0.5 * (z + trial)), cost, damping), None

    z0 = jnp.concatenate([rotation.canonical(T.rotvec), T.translation])
    (z, _, cost, _), _ = jax.lax.scan(body, (z0, z0, jnp.asarray(jnp.inf), jnp.asarray(1e-3)), None, length=steps)
    return Pose(z[:3], z[3:]), cost


def _both_poses(K: Array, H: Array, T_plane_target: Array, centre: Array) -> Pose:
    """The two mirrored poses of one flat view, stacked."""
    first = pose_from_homography(K, H).compose(Pose.from_matrix(T_plane_target))
    return jax.tree.map(lambda a, b: jnp.stack([a, b]), first, mirrored_pose(first, centre))


def _on_plane(T_plane_target: Array, points: Array) -> Array:
    return jnp.sum(T_plane_target[None, :2, :3] * points[:, None, :], axis=2) + T_plane_target[None, :2, 3]


def _centres(points: Array, seen: Array) -> Array:
    count = jnp.maximum(jnp.sum(seen.astype(points.dtype), axis=1), 1.0)
    return jnp.sum(jnp.where(seen[..., None], points, 0.0), axis=1) / count[:, None]


def _candidates(H: Array, use: Array, width: Array, height: Array) -> tuple[Array, Array]:
    """K of Zhang's method, K of one focal length, and K of plausible fields of view; with a flag each."""
    zhang, zhang_real = fit_intrinsics_linear(H, use, (width, height))
    focal, focal_real = fit_focal_linear(H, use, (width, height))
    cx, cy, zero = 0.5 * (width - 1), 0.5 * (height - 1), jnp.zeros(())
    guesses = [Intrinsics(f * width, f * width, cx, cy, zero) for f in (0.6, 1.2, 3.0)]  # 80, 45 and 19 degrees
    K = jnp.stack([k.matrix() for k in (zhang, focal, *guesses)])
    near = (jnp.abs(K[:, 0, 2] - cx) < width) & (jnp.abs(K[:, 1, 2] - cy) < height)
    real = jnp.stack([zhang_real, focal_real, *[jnp.array(True)] * 3])
    return K, real & near & jnp.all(jnp.isfinite(K), axis=(1, 2))


@program
def homographies(
    points: Float[Array, "views points 3"],
    uv: Float[Array, "views points 2"],
    seen: Bool[Array, "views points"],
    T_plane_target: Float[Array, "views 4 4"],
) -> Float[Array, "views 3 3"]:
    """Homography of each flat view, from its own plane to the image. Source: eq. 4.30-4.31."""
    return jax.vmap(fit_homography_linear)(jax.vmap(_on_plane)(T_plane_target, points), uv, seen)


@program
def candidate_lenses(
    H: Float[Array, "views 3 3"],
    points: Float[Array, "views points 3"],
    uv: Float[Array, "views points 2"],
    seen: Bool[Array, "views points"],
    T_plane_target: Float[Array, "views 4 4"],
    flat: Bool[Array, "views"],
    width: Float[Array, ""],
    height: Float[Array, ""],
) -> tuple[Lens, Bool[Array, "candidates"]]:
    """Lenses that flat views may have been taken with, each without and with distortion; and which are real.

    Returns:
        lenses with a leading axis of ten candidates; flags.
    Source: optical tracking document, algorithm 3, its linear part.
    """
    use = flat & (jnp.sum(seen, axis=1) >= 4)
    mask = seen & use[:, None]
    K, real = _candidates(H, use, width, height)
    zero = jnp.zeros(())

    def of(K: Array) -> tuple[Lens, Lens]:
        intrinsics, ideal = Intrinsics.from_matrix(K), BrownDistortion(zero, zero, zero, zero, zero)

        def see(h: Array, t: Array, p: Array) -> Array:
            pose = pose_from_homography(K, h)
            on_plane = jnp.concatenate([_on_plane(t, p), jnp.zeros_like(p[:, :1])], axis=1)
            return jax.vmap(lambda q: pixel_of_point(intrinsics, ideal, pose.act(q)))(on_plane)

        ideal_uv = jnp.where(mask[..., None], jax.vmap(see)(H, T_plane_target, points), 0.0).reshape(-1, 2)
        k1, k2 = fit_distortion_linear(ideal_uv, uv.reshape(-1, 2), mask.reshape(-1), K)
        return Lens(intrinsics, ideal), Lens(intrinsics, BrownDistortion(k1, k2, zero, zero, zero))

    pairs = jax.vmap(of)(K)
    lenses = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), *pairs)
    return lenses, jnp.concatenate([real, real]) & jnp.any(use)


def _projection_pose(points: Array, uv: Array, seen: Array) -> tuple[Array, Pose]:
    """K and pose of one view with points in all three dimensions."""
    K, R, centre = decompose_projection(fit_projection_linear(points, uv, seen))
    return K, Pose(rotation.log(R), -R @ centre)


@program
def solid_start(
    points: Float[Array, "views points 3"], uv: Float[Array, "views points 2"], seen: Bool[Array, "views points"]
) -> tuple[Lens, Float[Array, "views 3"], Float[Array, "views 3"]]:
    """Lens (median of the projection matrices' K, no distortion) and poses of views with depth.

    Source: optical tracking document, algorithms 1-2 and 4.4.3.
    """
    use = jnp.sum(seen, axis=1) >= 6
    K, T = jax.vmap(_projection_pose)(points, uv, seen)
    use = use & jnp.all(jnp.isfinite(K), axis=(1, 2))
    middle = jnp.nanmedian(jnp.where(use[:, None, None], K, jnp.nan), axis=0)
    lens = Lens(
        Intrinsics(middle[0, 0], middle[1, 1], middle[0, 2], middle[1, 2], jnp.zeros(())), BrownDistortion.none()
    )
    return lens, T.rotvec, T.translation


@program
def flat_poses(
    lens: Lens,
    H: Float[Array, "views 3 3"],
    points: Float[Array, "views points 3"],
    seen: Bool[Array, "views points"],
    T_plane_target: Float[Array, "views 4 4"],
) -> Pose:
    """Poses T_camera_target of flat views from their homographies: the two mirrored ones, axes (views, 2).

    Source: optical tracking document, end of 4.4.5; Schweighofer and Pinz 2006.
    """
    K = lens.intrinsics.matrix()
    return jax.vmap(_both_poses, (None, 0, 0, 0))(K, H, T_plane_target, _centres(points, seen))


@program
def refined_poses(
    lens: Lens,
    starts: Pose,
    points: Float[Array, "views points 3"],
    uv: Float[Array, "views points 2"],
    seen: Bool[Array, "views points"],
) -> tuple[Pose, Float[Array, "views"]]:
    """The best of several starts (axes views, starts) of each view after a few steps, and its sum of squares [px^2]."""
    views, count = starts.rotvec.shape[:2]
    # One axis for views and starts: tracing two nested ones takes half as long again.
    each = Pose(starts.rotvec.reshape(-1, 3), starts.translation.reshape(-1, 3))
    many = (jnp.repeat(x, count, axis=0) for x in (points, uv, seen))
    refined, cost = jax.vmap(lambda T, p, u, m: pose_steps(lens, T, p, u, m))(each, *many)
    cost = jnp.where(jnp.isfinite(cost), cost, jnp.inf).reshape(views, count)
    best = count * jnp.arange(views) + jnp.argmin(cost, axis=1)
    return jax.tree.map(lambda x: x[best], refined), jnp.min(cost, axis=1)
