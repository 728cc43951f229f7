"""Start values for calibrations from targets, without any help from the user.

Host code: it decides between methods by looking at numbers. Per camera: homographies (flat targets) or projection
matrices (others) give intrinsics and poses; every candidate, and the mirrored pose of every flat view, is tried
and the one with the smallest reprojection error kept.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._errors import SolveError
from jaxmocap.calibration.boards import Lens, RigParameters, TargetViews
from jaxmocap.calibration.dlt import decompose_projection, fit_projection_linear
from jaxmocap.calibration.homography import fit_homography_linear
from jaxmocap.calibration.zhang import (
    fit_distortion_linear,
    fit_focal_linear,
    fit_intrinsics_linear,
    mirrored_pose,
    pose_from_homography,
)
from jaxmocap.cameras import BrownDistortion, Intrinsics, project_from_camera
from jaxmocap.geometry import Pose, rotation
from jaxmocap.optim import ArrowVariables

# Points whose spread across their best plane is below this fraction of their spread within it count as flat: the
# homography of a plane that thick is wrong by a fraction of a pixel, a projection matrix from it by everything.
_FLAT = 1e-3


def _plane_frames(points: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each view the pose (4x4) of its best plane in the target's frame, and whether its points are flat."""
    frames = np.tile(np.eye(4), (len(points), 1, 1))
    flat = np.zeros(len(points), bool)
    for i, (p, m) in enumerate(zip(points, seen)):
        if m.sum() < 4:
            continue
        centre = p[m].mean(axis=0)
        _, s, Vt = np.linalg.svd(p[m] - centre, full_matrices=False)
        flat[i] = s[2] <= _FLAT * s[1]
        if np.allclose(p[m][:, 2], 0.0):
            continue  # already its own plane: keep the user's axes, whose z points away from the camera
        R = Vt.T * np.array([1.0, 1.0, np.sign(np.linalg.det(Vt))])
        frames[i, :3, :3], frames[i, :3, 3] = R, centre
    return frames, flat


@jax.jit
def _homographies(xy: Array, uv: Array, seen: Array) -> Array:
    return jax.vmap(fit_homography_linear)(xy, uv, seen)


@partial(jax.jit, static_argnames=("image_size",))
def _intrinsics_candidates(H: Array, use: Array, image_size: tuple[int, int]) -> tuple[Array, Array]:
    """K of Zhang's method, K of one focal length, and K of plausible fields of view; with a flag each."""
    zhang, zhang_real = fit_intrinsics_linear(H, use, image_size)
    focal, focal_real = fit_focal_linear(H, use, image_size)
    width, height = image_size
    guesses = [
        Intrinsics(jnp.array(f), jnp.array(f), jnp.array(0.5 * (width - 1)), jnp.array(0.5 * (height - 1)), jnp.array(0.0))
        for f in (0.6 * width, 1.2 * width, 3.0 * width)  # 80, 45 and 19 degrees across
    ]
    K = jnp.stack([k.matrix() for k in (zhang, focal, *guesses)])
    inside = (K[:, 0, 2] > -width) & (K[:, 0, 2] < 2 * width) & (K[:, 1, 2] > -height) & (K[:, 1, 2] < 2 * height)
    real = jnp.stack([zhang_real, focal_real, *[jnp.array(True)] * 3]) & inside & jnp.all(jnp.isfinite(K), axis=(1, 2))
    return K, real


def _pose_steps(lens: Lens, T: Pose, points: Array, uv: Array, seen: Array, steps: int) -> tuple[Pose, Array]:
    """A few damped Gauss-Newton steps on one pose, and the sum of squared residuals it ends with."""

    def residual(z: Array) -> Array:
        pose = Pose(z[:3], z[3:])
        predicted = jax.vmap(lambda p: project_from_camera(lens.intrinsics, lens.distortion, pose.act(p))[0])(points)
        return jnp.where(seen[:, None], predicted - uv, 0.0).reshape(-1)

    def body(carry: tuple[Array, Array, Array], _: None):
        z, cost, damping = carry
        r, J = residual(z), jax.jacfwd(residual)(z)
        A = J.T @ J
        D = jnp.diag(jnp.where(jnp.diagonal(A) > 0, jnp.diagonal(A), 1.0))
        new = z - jnp.linalg.solve(A + damping * D, J.T @ r)
        new_cost = jnp.sum(residual(new) ** 2)
        better = new_cost < cost
        return (
            jnp.where(better, new, z),
            jnp.where(better, new_cost, cost),
            damping * jnp.where(better, 0.2, 10.0),
        ), None

    z0 = jnp.concatenate([rotation.canonical(T.rotvec), T.translation])
    start = (z0, jnp.sum(residual(z0) ** 2), jnp.asarray(1e-3))
    (z, cost, _), _ = jax.lax.scan(body, start, None, length=steps)
    return Pose(z[:3], z[3:]), cost


@jax.jit
def _try_intrinsics(K: Array, H: Array, T_plane_target: Array, points: Array, uv: Array, seen: Array):
    """Lens, poses and error of one K: both mirrored poses refined, distortion estimated, the better pose kept."""
    intrinsics = Intrinsics.from_matrix(K)
    centres = jnp.sum(jnp.where(seen[..., None], points, 0.0), axis=1) / jnp.maximum(jnp.sum(seen, axis=1), 1)[:, None]

    def ideal(T: Pose, p: Array) -> Array:
        return project_from_camera(intrinsics, BrownDistortion.none(), T.act(p))[0]

    first = jax.vmap(lambda h, t: pose_from_homography(K, h).compose(Pose.from_matrix(t)))(H, T_plane_target)
    other = jax.vmap(mirrored_pose)(first, centres)
    ideal_uv = jax.vmap(lambda T, p: jax.vmap(ideal, (None, 0))(T, p))(first, points)
    k1, k2 = fit_distortion_linear(ideal_uv.reshape(-1, 2), uv.reshape(-1, 2), seen.reshape(-1), K)
    zero = jnp.zeros(())
    fitted = BrownDistortion(k1, k2, zero, zero, zero)
    out = []
    for lens in (Lens(intrinsics, BrownDistortion.none()), Lens(intrinsics, fitted)):
        steps = jax.vmap(lambda T, p, u, m, g=lens: _pose_steps(g, T, p, u, m, 6))
        (a, cost_a), (b, cost_b) = steps(first, points, uv, seen), steps(other, points, uv, seen)
        take = cost_b < cost_a
        pose = jax.tree.map(lambda x, y, t=take: jnp.where(t[:, None], y, x), a, b)
        out.append((lens, pose, jnp.sum(jnp.minimum(cost_a, cost_b))))
    return out


@jax.jit
def _projection_start(points: Array, uv: Array, seen: Array) -> tuple[Array, Array, Array]:
    """K, R and centre of each view with points in all three dimensions."""
    P = jax.vmap(fit_projection_linear)(points, uv, seen)
    return jax.vmap(decompose_projection)(P)


def start_camera(
    points: Float[np.ndarray, "views points 3"],
    uv: Float[np.ndarray, "views points 2"],
    seen: np.ndarray,
    image_size: tuple[int, int],
) -> tuple[Lens, Pose, np.ndarray]:
    """Start values of one camera.

    Args:
        points: in the target's frame [scene].
        uv: where they were seen [px].
        seen: (views, points), True where seen.
        image_size: (width, height) [px].

    Returns:
        lens; T_camera_target with a leading view axis (meaningless for unused views); which views were used.

    Raises:
        SolveError: if no view shows enough points.
    Source: optical tracking document, algorithms 1-3.
    """
    frames, flat = _plane_frames(points, seen)
    solid = ~flat & (seen.sum(axis=1) >= 6)
    use = (flat & (seen.sum(axis=1) >= 4)) | solid
    if not use.any():
        raise SolveError(
            "No view shows enough points for a start: 4 points of a flat target or 6 of one with depth are needed "
            "in at least one view."
        )
    T_plane_target = np.linalg.inv(frames)
    on_plane = np.einsum("vij,vpj->vpi", T_plane_target[:, :3, :3], points) + T_plane_target[:, None, :3, 3]
    seen_flat = seen & flat[:, None]
    H = _homographies(on_plane[..., :2], uv, seen_flat)
    K, real = _intrinsics_candidates(H, jnp.asarray(flat & use), image_size)
    K, real = np.asarray(K), np.array(real)
    solid_K = None
    if solid.any():
        Ks, Rs, Cs = (np.asarray(x) for x in _projection_start(points, uv, seen & solid[:, None]))
        solid_K = np.median(Ks[solid], axis=0) * np.array([[1, 0, 1], [0, 1, 1], [0, 0, 1]])
        K, real = np.concatenate([K, solid_K[None]]), np.append(real, np.isfinite(solid_K).all())
    best = None
    for k in np.flatnonzero(real):
        for lens, pose, cost in _try_intrinsics(K[k], H, T_plane_target, points, uv, seen & use[:, None]):
            if solid_K is not None:
                pose, cost = _solid_poses(lens, pose, solid, Rs, Cs, points, uv, seen & use[:, None])
            if np.isfinite(cost) and (best is None or float(cost) < best[0]):
                best = (float(cost), lens, pose)
    if best is None:
        raise SolveError("No start could be found: the points do not look like images of the target given.")
    return best[1], best[2], use


@jax.jit
def _refined_poses(lens: Lens, pose: Pose, points: Array, uv: Array, seen: Array) -> tuple[Pose, Array]:
    return jax.vmap(lambda T, p, u, m: _pose_steps(lens, T, p, u, m, 8))(pose, points, uv, seen)


def _solid_poses(lens: Lens, pose: Pose, solid: np.ndarray, R: np.ndarray, C: np.ndarray, points, uv, seen):
    """Poses of views with depth come from their projection matrices."""
    rotvec = jax.vmap(rotation.log)(jnp.asarray(R))
    translation = -jnp.einsum("vij,vj->vi", jnp.asarray(R), jnp.asarray(C))
    pick = jnp.asarray(solid)[:, None]
    mixed = Pose(jnp.where(pick, rotvec, pose.rotvec), jnp.where(pick, translation, pose.translation))
    refined, cost = _refined_poses(lens, mixed, points, uv, seen)
    return refined, jnp.sum(cost)


def _relative_poses(poses: list[Pose], used: np.ndarray, a: int, b: int) -> Pose:
    """T_b_a from all views both cameras used: mean rotation (chordal), median translation."""
    both = np.flatnonzero(used[a] & used[b])
    pick = lambda pose: jax.tree.map(lambda x: x[both], pose)  # noqa: E731
    T = jax.vmap(lambda x, y: y.compose(x.inverse()))(pick(poses[a]), pick(poses[b]))
    R = jax.vmap(rotation.exp)(T.rotvec)
    mean = rotation.nearest_rotation(jnp.mean(R, axis=0))
    return Pose(rotation.log(mean), jnp.median(T.translation, axis=0))


def start_rig(views: TargetViews, image_sizes: list[tuple[int, int]], names: list[str]) -> tuple[ArrowVariables, np.ndarray]:
    """Start values of a rig: each camera alone, then chained through the views they share.

    Args:
        views: what all cameras saw.
        image_sizes: (width, height) of each camera [px].
        names: of the cameras, for messages.

    Returns:
        variables (rig and T_rig_target), and which views each camera used, (cameras, views).

    Raises:
        SolveError: a camera without a usable view, or groups of cameras that share no view.
    """
    points, uv, seen = (np.asarray(x) for x in (views.points, views.seen.uv, views.seen.visible))
    lenses, poses, used = [], [], []
    for k, size in enumerate(image_sizes):
        try:
            lens, pose, use = start_camera(points, uv[:, k], seen[:, k], size)
        except SolveError as error:
            raise SolveError(f"camera {names[k]}: {error}") from None
        lenses.append(lens)
        poses.append(pose)
        used.append(use)
    used_by = np.stack(used)
    T_camera_rig = _chain(poses, used_by, names)
    local = poses[0]
    for k in range(1, len(poses)):
        # Views that the first camera missed take their pose from the one that saw them.
        missing = jnp.asarray(~used_by[:k].any(axis=0) & used_by[k])[:, None]
        back = T_camera_rig[k].inverse()
        via = jax.vmap(back.compose)(poses[k])
        local = jax.tree.map(lambda x, y, m=missing: jnp.where(m, y, x), local, via)
    none = jnp.asarray(~used_by.any(axis=0))[:, None]
    local = jax.tree.map(lambda x: jnp.where(none | ~jnp.isfinite(x), 1.0, x), local)
    return ArrowVariables(RigParameters(tuple(lenses), tuple(T_camera_rig[1:])), local), used_by


def _chain(poses: list[Pose], used: np.ndarray, names: list[str]) -> list[Pose]:
    """T_camera_rig of every camera, each reached over the pair with the most common views."""
    count = len(poses)
    found: dict[int, Pose] = {0: Pose.identity()}
    while len(found) < count:
        pairs = [(int((used[a] & used[b]).sum()), a, b) for a in found for b in range(count) if b not in found]
        common, a, b = max(pairs, key=lambda pair: (pair[0], -pair[1], -pair[2]))
        if common == 0:
            apart = ", ".join(names[b] for b in range(count) if b not in found)
            joined = ", ".join(names[a] for a in sorted(found))
            raise SolveError(
                f"The cameras fall into groups that share no view: {joined} | {apart}. "
                "Record the target where cameras of both groups see it at once."
            )
        found[b] = _relative_poses(poses, used, a, b).compose(found[a])
    return [found[k] for k in range(count)]
