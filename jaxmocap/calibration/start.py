"""Start values for calibrations from targets, without any help from the user.

Per camera: homographies (flat targets) or projection matrices (others) give intrinsics and poses; every candidate,
and the mirrored pose of every flat view, is tried and the one with the smallest reprojection error kept. The arrays
of each step are brought to one size, so that a step is compiled once for every board and every number of photos.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxmocap._errors import SolveError
from jaxmocap.calibration import start_steps as steps
from jaxmocap.calibration.boards import Lens, RigParameters, TargetViews
from jaxmocap.geometry import Pose
from jaxmocap.optim import ArrowVariables

# Points whose spread across their best plane is below this fraction of their spread within it count as flat: the
# homography of a plane that thick is wrong by a fraction of a pixel, a projection matrix from it by everything.
_FLAT = 1e-3
# Up to this fraction both starts are tried, the plane's and the solid's, and the better one kept: a tenth of the
# size out of the plane moves pixels by a few per cent of the target's image, which a start may be wrong by, while
# a projection matrix has errors of the noise divided by the thickness.
_NEARLY_FLAT = 0.1
# Spread out of the plane, relative to the size, that is not rounding of the coordinates given.
_THIN = 1e-6
# Images that leave their best line by less than the noise of a good corner are a line: a target seen edge-on, or
# one and the same pixel repeated. Such a view has no pose.
_LINE_PX = 0.5
# A start needs no more: 48 points fix a homography to a fraction of their noise, 16 views a calibration matrix.
_POINTS, _VIEWS = 48, 16


class CameraStart(NamedTuple):
    """What `start_camera` finds of one camera."""

    lens: Lens
    T: np.ndarray
    """T_camera_target (views, 4, 4); identity for views that were not used."""
    used: np.ndarray
    """(views,)."""
    variance: float
    """Mean square of the residuals left, per coordinate and degree of freedom [px^2]."""


def plane_frames(points: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Best planes of targets.

    Args:
        points: (views, points, 3) in the target's frame [scene].
        seen: (views, points), True where a point counts.

    Returns:
        Pose of each view's plane in the target's frame, (views, 4, 4), and whether its points are flat, (views,).
    """
    frames, thickness = _best_planes(points, seen)
    return frames, thickness <= _FLAT


def _best_planes(points: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose of each view's best plane, and the spread across it relative to that within; infinite for a line."""
    frames = np.tile(np.eye(4), (len(points), 1, 1))
    thickness = np.full(len(points), np.inf)
    for i, (p, m) in enumerate(zip(points, seen)):
        if m.sum() < 4:
            continue
        centre = p[m].mean(axis=0)
        _, s, Vt = np.linalg.svd(p[m] - centre, full_matrices=False)
        if s[1] > _FLAT * s[0]:
            thickness[i] = s[2] / s[1]
        if np.all(np.abs(p[m][:, 2]) <= _THIN * s[0]):
            continue  # already its own plane: keep the user's axes, whose z points away from the camera
        R = Vt.T * np.array([1.0, 1.0, np.sign(np.linalg.det(Vt))])
        frames[i, :3, :3], frames[i, :3, 3] = R, centre
    return frames, thickness


def _spread_in_image(uv: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Whether the seen points of each view spread over more than a line of pixels in the image."""
    out = np.zeros(len(uv), bool)
    for i, (p, m) in enumerate(zip(uv, seen)):
        if m.sum() >= 4:
            s = np.linalg.svd(p[m] - p[m].mean(axis=0), compute_uv=False)
            out[i] = s[1] > _LINE_PX * np.sqrt(m.sum())
    return out


def _subset(points: np.ndarray, uv: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evenly chosen visible points of each view, padded with unseen ones to one number."""
    views = len(points)
    out = np.zeros((views, _POINTS, 3)), np.zeros((views, _POINTS, 2)), np.zeros((views, _POINTS), bool)
    for i in range(views):
        there = np.flatnonzero(seen[i])
        if len(there) > _POINTS:
            there = there[np.linspace(0, len(there) - 1, _POINTS).round().astype(int)]
        n = len(there)
        out[0][i, :n], out[1][i, :n], out[2][i, :n] = points[i, there], uv[i, there], True
    return out


def _take_views(arrays: tuple[np.ndarray, ...], index: np.ndarray, size: int) -> tuple[np.ndarray, ...]:
    """The views of an index, padded with zeros to a number."""
    return tuple(np.concatenate([a[index], np.zeros((size - len(index), *a.shape[1:]), a.dtype)]) for a in arrays)


def start_camera(
    points: Float[np.ndarray, "views points 3"],
    uv: Float[np.ndarray, "views points 2"],
    seen: np.ndarray,
    image_size: tuple[int, int],
) -> CameraStart:
    """Start values of one camera.

    Args:
        points: in the target's frame [scene].
        uv: where they were seen [px].
        seen: (views, points), True where seen.
        image_size: (width, height) [px].

    Returns:
        CameraStart.

    Raises:
        SolveError: if no view shows enough points.
    Source: optical tracking document, algorithms 1-3.
    """
    few, flat, solid, use = _prepared(points, uv, seen)
    if not use.any():
        raise SolveError(
            "No view shows enough points for a start: 4 points of a flat target or 6 of one with depth are needed "
            "in at least one view, not on one line."
        )
    chosen = np.flatnonzero(use)
    chosen = chosen[np.linspace(0, len(chosen) - 1, min(_VIEWS, len(chosen))).round().astype(int)]
    sample = _take_views(few, chosen, _VIEWS)
    candidates: list[Lens] = []
    if flat[use].any():
        width, height = (jnp.asarray(float(n)) for n in image_size)
        many, real = steps.candidate_lenses(steps.homographies(*sample[:4]), *sample[:5], width, height)
        candidates += [jax.tree.map(lambda x, k=k: x[k], many) for k in np.flatnonzero(real)]
    if solid.any():
        candidates.append(steps.solid_start(*_take_views(few[:3], np.flatnonzero(solid)[:_VIEWS], _VIEWS))[0])
    costs = [float(np.sum(np.where(sample[2].any(axis=1), _poses(lens, *sample)[1], 0.0))) for lens in candidates]
    if not np.isfinite(costs).any():
        raise SolveError("No start could be found: the points do not look like images of the target given.")
    lens = candidates[int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))]
    T, cost = _poses_of_all(lens, few, use)
    freedom = 2 * int(few[2][use].sum()) - 6 * int(use.sum())
    return CameraStart(lens, T, use, float(cost[use].sum()) / max(freedom, 1))


def _prepared(
    points: np.ndarray, uv: np.ndarray, seen: np.ndarray
) -> tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray, np.ndarray]:
    """Arrays that `_poses` takes, of one number of points; which views are flat, have depth, can be used."""
    frames, thickness = _best_planes(points, seen)
    flat, count = thickness <= _NEARLY_FLAT, seen.sum(axis=1)
    solid = (thickness > _THIN) & np.isfinite(thickness) & (count >= 6)
    use = ((flat & (count >= 4)) | solid) & _spread_in_image(uv, seen)
    return (*_subset(points, uv, seen), np.linalg.inv(frames), flat, solid), flat, solid, use


def _poses_of_all(lens: Lens, few: tuple[np.ndarray, ...], use: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`_poses` of any number of views, the identity where a view is not used."""
    T, cost = np.tile(np.eye(4), (len(use), 1, 1)), np.zeros(len(use))
    for first in range(0, len(use), _VIEWS):
        index = np.arange(first, min(first + _VIEWS, len(use)))
        some, squares = _poses(lens, *_take_views(few, index, _VIEWS))
        T[index], cost[index] = some[: len(index)], squares[: len(index)]
    T[~use] = np.eye(4)
    return T, cost


def start_poses(
    lens: Lens, points: np.ndarray, uv: np.ndarray, seen: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses of targets before a camera that is known.

    Args:
        lens: K [px] and distortion [1].
        points: (views, points, 3) in the target's frame [scene].
        uv: (views, points, 2), where they were seen [px].
        seen: (views, points), True where seen.

    Returns:
        T_camera_target as (views, 4, 4) matrices, the identity where a view cannot be used; RMS length of the
        residuals of each view [px]; which views could be used.
    Source: optical tracking document, end of 4.4.5.
    """
    few, _, _, use = _prepared(points, uv, seen)
    T, cost = _poses_of_all(lens, few, use)
    return T, np.sqrt(cost / np.maximum(few[2].sum(axis=1), 1)), use


def _poses(
    lens: Lens,
    points: np.ndarray,
    uv: np.ndarray,
    seen: np.ndarray,
    T_plane_target: np.ndarray,
    flat: np.ndarray,
    solid: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """T_camera_target of each view as 4x4 matrices, and the sums of squared residuals [px^2]."""
    H = steps.homographies(points, uv, seen, T_plane_target)
    starts = steps.flat_poses(lens, H, points, seen, T_plane_target)
    if solid.any():
        _, rotvec, translation = steps.solid_start(points, uv, seen)
        # A third start where points leave their plane, and the only one where they leave it far.
        starts = Pose(
            *(_with_solid(a, b, flat, solid) for a, b in ((starts.rotvec, rotvec), (starts.translation, translation)))
        )
    refined, cost = steps.refined_poses(lens, starts, points, uv, seen)
    T = np.tile(np.eye(4), (len(points), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(_finite(refined.rotvec)).as_matrix()
    T[:, :3, 3] = _finite(refined.translation)
    return T, np.asarray(cost)


def _with_solid(of_planes: jax.Array, of_solids: jax.Array, flat: np.ndarray, solid: np.ndarray) -> jax.Array:
    """Starts (views, 3, 3): the two of a plane and that of a solid, each replaced where it does not apply."""
    planes, solids = np.asarray(of_planes), np.asarray(of_solids)[:, None]
    solids = np.where((solid & np.isfinite(solids).all(axis=(1, 2)))[:, None, None], solids, planes[:, :1])
    return jnp.asarray(np.concatenate([np.where(flat[:, None, None], planes, solids), solids], axis=1))


def _finite(x: object) -> np.ndarray:
    return np.nan_to_num(np.asarray(x), nan=0.0, posinf=0.0, neginf=0.0)


def _relative_pose(T_a: np.ndarray, T_b: np.ndarray, both: np.ndarray) -> np.ndarray:
    """T_b_a from the views both cameras used: mean rotation, median translation."""
    T = T_b[both] @ np.linalg.inv(T_a[both])
    out = np.eye(4)
    out[:3, :3] = Rotation.from_matrix(T[:, :3, :3]).mean().as_matrix()
    out[:3, 3] = np.median(T[:, :3, 3], axis=0)
    return out


def _as_pose(T: np.ndarray) -> Pose:
    return Pose(jnp.asarray(Rotation.from_matrix(T[..., :3, :3]).as_rotvec()), jnp.asarray(T[..., :3, 3]))


def start_rig(
    views: TargetViews, image_sizes: list[tuple[int, int]], names: list[str]
) -> tuple[ArrowVariables, np.ndarray]:
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
    return join_cameras(start_each(views, image_sizes, names), names)


def start_each(views: TargetViews, image_sizes: list[tuple[int, int]], names: list[str]) -> list[CameraStart]:
    """Start values of each camera of a rig on its own; arguments and errors as `start_rig`."""
    points, uv, seen = (np.asarray(x) for x in (views.points, views.seen.uv, views.seen.visible))
    found = []
    for k, size in enumerate(image_sizes):
        try:
            found.append(start_camera(points, uv[:, k], seen[:, k], size))
        except SolveError as error:
            raise SolveError(f"camera {names[k]}: {error}") from None
    return found


def join_cameras(cameras: list[CameraStart], names: list[str]) -> tuple[ArrowVariables, np.ndarray]:
    """Start values of a rig from those of its cameras; results and errors as `start_rig`."""
    poses, used_by = [c.T for c in cameras], np.stack([c.used for c in cameras])
    T_camera_rig = _chain(poses, used_by, names)
    local = poses[0].copy()
    for k in range(1, len(poses)):
        # Views that the first camera missed take their pose from the one that saw them.
        missing = ~used_by[:k].any(axis=0) & used_by[k]
        local[missing] = np.linalg.inv(T_camera_rig[k]) @ poses[k][missing]
    seen_by_none = ~used_by.any(axis=0)
    local[seen_by_none, :3, 3] = [0.0, 0.0, 1.0]  # in front, so that nothing divides by zero
    rig = RigParameters(tuple(c.lens for c in cameras), tuple(_as_pose(T) for T in T_camera_rig[1:]))
    return ArrowVariables(rig, _as_pose(local)), used_by


def _chain(poses: list[np.ndarray], used: np.ndarray, names: list[str]) -> list[np.ndarray]:
    """T_camera_rig of every camera, each reached over the pair with the most common views."""
    count = len(poses)
    found: dict[int, np.ndarray] = {0: np.eye(4)}
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
        found[b] = _relative_pose(poses[a], poses[b], used[a] & used[b]) @ found[a]
    return [found[k] for k in range(count)]
