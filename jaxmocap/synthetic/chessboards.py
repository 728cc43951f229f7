"""Perfect worlds with a chessboard in front of one camera or several, and the noise that measuring adds.

Users and tests share these. Places are drawn by numpy from a seed, once; noise is drawn by JAX from a key, so
that a thousand noisy copies of one world are one `jax.vmap`.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PRNGKeyArray
from scipy.spatial.transform import Rotation

from jaxmocap._errors import InputError, SolveError
from jaxmocap.calibration.boards import Lens, RigParameters, TargetViews, chessboard_points, reproject
from jaxmocap.cameras import BrownDistortion, Intrinsics
from jaxmocap.geometry import Pose
from jaxmocap.observations import PixelObservations
from jaxmocap.optim import ArrowVariables

_TRIES = 2000  # draws per view before giving up; a sensible world needs fewer than ten


class ChessboardWorld(eqx.Module):
    """A rig, where the board was in each view, and the exact corners."""

    truth: ArrowVariables
    """RigParameters and T_rig_board with a leading view axis."""
    views: TargetViews
    """Exact observations, sigma 1."""
    image_sizes: tuple[tuple[int, int], ...] = eqx.field(static=True)
    """(width, height) of each camera [px]."""


def lens_of_numbers(
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    distortion: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0),
    skew: float = 0.0,
) -> Lens:
    """A lens of plain numbers.

    Args:
        fx: focal length in pixel widths [px].
        fy: focal length in pixel heights [px].
        cx: principal point [px].
        cy: principal point [px].
        distortion: k1 k2 p1 p2 k3 [1], as OpenCV orders them; missing ones at the end are zero.
        skew: K[0][1] [px].

    Returns:
        The lens.

    Raises:
        InputError: more than five distortion numbers.
    """
    if len(distortion) > 5:
        raise InputError(f"distortion: expected k1 k2 p1 p2 k3 at most, got {len(distortion)} numbers")
    k = np.zeros(5)
    k[: len(distortion)] = distortion
    K = [jnp.asarray(float(x)) for x in (fx, fy, cx, cy, skew)]
    return Lens(Intrinsics(*K), BrownDistortion.from_vector(jnp.asarray(k)))


def _draw_pose(
    rng: np.random.Generator,
    lens: np.ndarray,
    size: tuple[int, int],
    board: np.ndarray,
    tilt: float,
    fill: tuple[float, float],
) -> np.ndarray:
    """Rotation vector and translation of a board (its points) anywhere in the picture; `lens` is K."""
    centre, extent = board.mean(axis=0), np.ptp(board[:, 0])
    depth = lens[0, 0] * extent / (size[0] * rng.uniform(*fill))
    middle = np.append(rng.uniform(0.15, 0.85, 2) * size, 1.0)
    about = rng.uniform(0.0, 2.0 * np.pi)
    # Uniform in the angle: nearly frontal boards tell little of the focal length, but people show them, too.
    lean = rng.uniform(0.0, tilt) * np.array([np.cos(about), np.sin(about), 0.0])
    R = Rotation.from_rotvec(lean) * Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    return np.concatenate([R.as_rotvec(), depth * np.linalg.solve(lens, middle) - R.apply(centre)])


@jax.jit
def _exact(rig: RigParameters, T: Pose, points: Array) -> tuple[Array, Array]:
    """Pixels (cameras, points, 2) and depths (cameras, points) of a board in the rig's frame."""
    p_rig = jax.vmap(T.act)(points)
    p = [p_rig, *[jax.vmap(pose.act)(p_rig) for pose in rig.T_camera_rig]]
    inside = []
    for k, lens in enumerate(rig.lenses):
        r2 = jnp.sum((p[k][:, :2] / p[k][:, 2:]) ** 2, axis=1)
        # Well inside the radius where the lens folds back, so that a refinement cannot cross it.
        inside.append(jnp.where(r2 < 0.8 * lens.distortion.valid_radius_squared(), p[k][:, 2], -1.0))
    return jnp.stack(reproject(rig, T, points)), jnp.stack(inside)


def chessboard_world(
    views: int,
    lenses: Sequence[Lens],
    image_sizes: Sequence[tuple[int, int]],
    *,
    T_camera_rig: Sequence[Pose] = (),
    board: tuple[int, int] = (9, 6),
    square: float = 30.0,
    tilt: float = 0.7,
    fill: tuple[float, float] = (0.3, 0.7),
    seed: int = 0,
) -> ChessboardWorld:
    """Boards spread over the picture of the first camera, every corner of each inside it.

    Distance, place, tilt and roll are drawn uniformly and drawn again until the whole board is in the first
    camera's picture; the other cameras see the corners that fall into theirs.

    Args:
        views: number of views.
        lenses: one per camera.
        image_sizes: (width, height) of each camera [px].
        T_camera_rig: pose of each camera after the first, rig (= first camera) -> camera.
        board: inner corners, columns and rows.
        square: side of a square [scene].
        tilt: largest angle between the board's normal and the viewing axis [rad].
        fill: range of (board width) / (picture width) when seen frontally.
        seed: of the random numbers.

    Returns:
        The world.

    Raises:
        InputError: lists of unequal length.
        SolveError: if no board fits into the picture.
    """
    if not len(lenses) == len(image_sizes) == len(T_camera_rig) + 1:
        raise InputError(
            f"expected as many image_sizes as lenses ({len(lenses)}) and one T_camera_rig less, "
            f"got {len(image_sizes)} and {len(T_camera_rig)}"
        )
    rng = np.random.default_rng(seed)
    points = chessboard_points(*board, square)
    rig = RigParameters(tuple(lenses), tuple(T_camera_rig))
    K = np.asarray(lenses[0].intrinsics.matrix())
    limits = np.array(image_sizes, dtype=float)[:, None, :] - 1.0
    poses, uvs, seen = [], [], []
    for _ in range(_TRIES * views):
        z = _draw_pose(rng, K, image_sizes[0], points, tilt, fill)
        uv, depth = (np.asarray(x) for x in _exact(rig, Pose(jnp.asarray(z[:3]), jnp.asarray(z[3:])), points))
        visible = (uv >= 0).all(axis=2) & (uv <= limits).all(axis=2) & (depth > 0)
        if visible[0].all():
            poses.append(z)
            uvs.append(uv)
            seen.append(visible)
        if len(poses) == views:
            break
    else:
        raise SolveError(f"No {board[0]}x{board[1]} board fits into a picture of {image_sizes[0]}: lower fill.")
    local = jnp.asarray(np.stack(poses))
    observed = PixelObservations.of(jnp.asarray(np.stack(uvs)), jnp.asarray(np.stack(seen)))
    return ChessboardWorld(
        ArrowVariables(rig, Pose(local[:, :3], local[:, 3:])),
        TargetViews(jnp.asarray(np.tile(points, (views, 1, 1))), observed),
        tuple((int(w), int(h)) for w, h in image_sizes),
    )


def _moved(views: TargetViews, delta: Array) -> TargetViews:
    uv = jnp.where(views.seen.visible[..., None], views.seen.uv + delta, views.seen.uv)
    return eqx.tree_at(lambda v: v.seen.uv, views, uv)


def add_noise(views: TargetViews, sigma: float, key: PRNGKeyArray) -> TargetViews:
    """Independent Gaussian noise on every coordinate that was seen.

    Args:
        views: observations.
        sigma: standard deviation per coordinate [px].
        key: of the random numbers.

    Returns:
        Noisy observations; their stated sigma is left as it was.
    """
    return _moved(views, sigma * jax.random.normal(key, views.seen.uv.shape, views.seen.uv.dtype))


def add_view_noise(views: TargetViews, shift: float, affine: float, key: PRNGKeyArray) -> TargetViews:
    """Errors that the corners of one picture have in common: a shift and an affine distortion.

    Blur, lighting and a board that is not flat move the corners of a photo together. Here each picture gets a
    Gaussian shift and a Gaussian 2x2 matrix that acts on the corner's offset from the board's middle, scaled
    so that `affine` is the standard deviation of the displacement at the RMS distance from the middle.

    Args:
        views: observations.
        shift: standard deviation of the common shift per coordinate [px].
        affine: standard deviation of the affine displacement per coordinate [px].
        key: of the random numbers.

    Returns:
        Observations with the errors added.
    """
    uv, seen = views.seen.uv, views.seen.visible[..., None]
    count = jnp.maximum(jnp.sum(seen, axis=-2, keepdims=True, dtype=uv.dtype), 1.0)
    middle = jnp.sum(jnp.where(seen, uv, 0.0), axis=-2, keepdims=True) / count
    offset = jnp.where(seen, uv - middle, 0.0)
    square = jnp.sum(offset * offset, axis=(-2, -1), keepdims=True) / count
    unit = offset / jnp.sqrt(jnp.where(square > 0, square, 1.0))
    key_shift, key_affine = jax.random.split(key)
    move = shift * jax.random.normal(key_shift, middle.shape, uv.dtype)
    matrix = affine * jax.random.normal(key_affine, (*uv.shape[:-2], 2, 2), uv.dtype)
    return _moved(views, move + jnp.einsum("...ij,...pj->...pi", matrix, unit))
