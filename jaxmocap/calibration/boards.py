"""Cameras calibrated from known targets: one residual and one refinement for chessboards, stereo and loose points.

Shared: every camera's K, lens, and pose in the rig. Local: the target's pose in each view. The first camera is
the rig's frame, which fixes the gauge; the target's size fixes the scale.
"""

from collections.abc import Callable
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap._arrays import require_x64
from jaxmocap._errors import InputError
from jaxmocap._programs import program
from jaxmocap.cameras import BrownDistortion, Intrinsics, pixel_of_point
from jaxmocap.geometry import Pose
from jaxmocap.observations import PixelObservations
from jaxmocap.optim import ArrowProblem, ArrowVariables, least_squares
from jaxmocap.optim.robust import TUNING, Loss, robustify, scale_from_data, variance_factors
from jaxmocap.results import Estimate

DistortionModel = Literal["none", "k1k2", "k1k2k3", "k1k2p1p2k3"]
MODELS: dict[str, tuple[str, ...]] = {
    "none": (),
    "k1k2": ("k1", "k2"),
    "k1k2k3": ("k1", "k2", "k3"),
    "k1k2p1p2k3": ("k1", "k2", "p1", "p2", "k3"),
}

LENS_NAMES = ("fx", "fy", "cx", "cy", "skew", "k1", "k2", "p1", "p2", "k3")
"""Numbers of a camera, in the order of its leaves."""
POSE_NAMES = ("rx", "ry", "rz", "tx", "ty", "tz")
"""Numbers of a pose, in the order of its leaves: rotation vector [rad], translation [scene]."""


class Lens(eqx.Module):
    """What a calibration finds of one camera, apart from its place."""

    intrinsics: Intrinsics
    distortion: BrownDistortion


class RigParameters(eqx.Module):
    """Shared unknowns: all cameras of a rig. The rig's frame is the first camera."""

    lenses: tuple[Lens, ...]
    T_camera_rig: tuple[Pose, ...]
    """One pose for every camera after the first."""


class TargetViews(eqx.Module):
    """What is known of each view: where the target's points are on the target, and where each camera saw them."""

    points: Float[Array, "views points 3"]
    """Points in the target's frame [scene]; any finite numbers where no camera sees them."""
    seen: PixelObservations
    """Arrays (views, cameras, points)."""

    @property
    def observations(self) -> int:
        """Number of points seen, counted once per camera and view."""
        return int(np.sum(np.asarray(self.seen.visible)))


def reproject(rig: RigParameters, T_rig_target: Pose, points: Float[Array, "points 3"]) -> list[Array]:
    """Pixels of a target's points, one (points, 2) array per camera."""
    p_rig = jax.vmap(T_rig_target.act)(points)
    out = []
    for k, lens in enumerate(rig.lenses):
        p_camera = p_rig if k == 0 else jax.vmap(rig.T_camera_rig[k - 1].act)(p_rig)
        out.append(jax.vmap(lambda p, m=lens: pixel_of_point(m.intrinsics, m.distortion, p))(p_camera))
    return out


def view_residuals(rig: RigParameters, T_rig_target: Pose, view: TargetViews, common: Any) -> Array:
    """Residuals of one view in units of sigma, (cameras * points, 2); zero where nothing was seen.

    Source: optical tracking document, algorithm 3 (its sum over points of one view).
    """
    del common
    predicted = jnp.concatenate(reproject(rig, T_rig_target, view.points))
    uv, visible, sigma = view.seen.uv, view.seen.visible, view.seen.sigma
    r = (predicted - uv.reshape(-1, 2)) / sigma.reshape(-1)[:, None]
    return jnp.where(visible.reshape(-1)[:, None], r, 0.0)


TARGET_PROBLEM = ArrowProblem(view_residuals)


def free_parameters(
    cameras: int, model: DistortionModel, skew: bool, frozen: tuple[tuple[str, ...], ...] | None = None
) -> ArrowVariables:
    """Which parameters are free, in the tree of the variables.

    Args:
        cameras: number of cameras.
        model: which coefficients of the lens are sought.
        skew: whether K[0][1] is sought.
        frozen: for each camera the names that are held all the same.

    Returns:
        ArrowVariables of bools.

    Raises:
        InputError: if the model has no such name.
    """
    if model not in MODELS:
        raise InputError(f"distortion: expected one of {', '.join(MODELS)}, got {model!r}")
    zero, three = jnp.zeros(()), jnp.zeros(3)
    lens_tree = jax.tree.structure(Lens(Intrinsics(*[zero] * 5), BrownDistortion(*[zero] * 5)))
    pose = jax.tree.map(lambda _: True, Pose(three, three))
    lenses = []
    for k in range(cameras):
        names = {"fx", "fy", "cx", "cy", *MODELS[model]} | ({"skew"} if skew else set())
        names -= set(frozen[k] if frozen else ())
        lenses.append(jax.tree.unflatten(lens_tree, [n in names for n in LENS_NAMES]))
    return ArrowVariables(RigParameters(tuple(lenses), (pose,) * (cameras - 1)), pose)


def parameter_names(free: ArrowVariables) -> tuple[tuple[int, str], ...]:
    """(camera, name) of every free shared number, in the order of the covariance."""
    names: list[tuple[int, str]] = []
    for k, lens in enumerate(free.shared.lenses):
        names += [(k, n) for n, is_free in zip(LENS_NAMES, jax.tree.leaves(lens)) if is_free]
    for k in range(len(free.shared.T_camera_rig)):
        names += [(k + 1, n) for n in POSE_NAMES]
    return tuple(names)


@program
def _prepare(poses: Pose, visible: Bool[Array, "views cameras points"]) -> tuple[Pose, Array, Array]:
    """Poses with short rotation vectors, number of points seen, and which views count: one compilation, not ten."""
    return (
        jax.vmap(Pose.canonical)(poses),
        jnp.sum(visible.astype(float)),
        jnp.any(visible, axis=(1, 2)).astype(float),
    )


def refine_targets(
    start: ArrowVariables,
    views: TargetViews,
    free: ArrowVariables,
    *,
    loss: Loss | None = None,
    max_steps: int = 100,
    covariance: bool = True,
    progress: Callable[[Any, Any, Any], None] | None = None,
) -> Estimate:
    """Cameras, rig and target poses of the smallest reprojection error.

    Args:
        start: RigParameters and the poses T_rig_target (leading view axis).
        views: known points and where they were seen; may be batched by `jax.vmap`.
        free: as `free_parameters` makes it.
        loss: None for plain least squares, "huber" or "cauchy" for a robust one whose width follows from the data.
        max_steps: largest number of solver steps.
        covariance: whether the covariance is wanted.
        progress: called with (step, cost, damping).

    Returns:
        Estimate; `stats["rms_px"]` is the root of the mean squared residual LENGTH per point in units of sigma
        (pixels when sigma is 1), `stats["observations"]` the number of points.

    Raises:
        InputError: JAX in 32-bit mode.
    Source: optical tracking document, algorithm 3; for two cameras its 4.5.
    """
    require_x64("refine_targets")
    poses, points_seen, weight = _prepare(start.local, views.seen.visible)
    start = ArrowVariables(start.shared, poses)
    options: dict[str, Any] = dict(
        free=free,
        weight=weight,
        count=2.0 * points_seen,
        max_steps=max_steps,
        covariance=covariance,
        by_block=covariance,
        progress=progress,
    )
    if loss is None:
        estimate = least_squares(TARGET_PROBLEM, start, views, **options)
    else:
        estimate = _refine_robust(start, views, loss, options)
    rms = jnp.sqrt(2.0 * estimate.stats["cost"] / jnp.maximum(points_seen, 1.0))
    return eqx.tree_at(lambda e: e.stats, estimate, {**estimate.stats, "rms_px": rms, "observations": points_seen})


def _refine_robust(start: ArrowVariables, views: TargetViews, loss: Loss, options: dict[str, Any]) -> Estimate:
    """Robust solve twice: a width from the start's residuals, then one from the solution's."""
    problem = ArrowProblem(robustify(view_residuals, loss))
    estimate = None
    for final in (False, True):
        at = start if estimate is None else estimate.value
        r = jax.vmap(view_residuals, (None, 0, 0, None))(at.shared, at.local, views, None)
        sigma = scale_from_data(r.reshape(-1, 2), views.seen.visible.reshape(-1))
        width = TUNING[loss] * jnp.maximum(sigma, 1e-6)
        chosen = {**options, "covariance": final, "by_block": final and options["by_block"]}
        estimate = least_squares(problem, at, views, (width, None), **chosen)
    assert estimate is not None
    estimate = eqx.tree_at(lambda e: e.stats, estimate, {**estimate.stats, "loss_width": width})
    if not options["covariance"]:
        return estimate
    r = jax.vmap(view_residuals, (None, 0, 0, None))(estimate.value.shared, estimate.value.local, views, None)
    return robust_covariance(estimate, r.reshape(-1, 2), views.seen.visible.reshape(-1), loss, width)


def robust_covariance(
    estimate: Estimate, r: Float[Array, "groups 2"], seen: Bool[Array, "groups"], loss: Loss, width: Float[Array, ""]
) -> Estimate:
    """The estimate with the asymptotic covariance of its loss in place of that of the changed residuals.

    Args:
        estimate: of a robustified problem.
        r: plain residuals at the solution [sigma].
        seen: True where a residual counts.
        loss: which was used.
        width: of the loss [sigma].

    Returns:
        The estimate with another variance and design effect.
    Source: as `optim.robust.variance_factors`.
    """
    count = seen.astype(float)
    variance, move = variance_factors(loss, jnp.sum(r**2, axis=1), count, width, 2)
    # The mean over points knows nothing of the parameters that were fitted to them.
    freedom = estimate.stats["degrees_of_freedom"]
    variance = variance * jnp.sum(2.0 * count) / jnp.maximum(freedom, 1.0)
    old = estimate.covariance
    effect = old.design_effect * old.variance * move**2 / variance
    changed = eqx.tree_at(lambda c: (c.variance, c.design_effect), old, (variance, effect))
    if old.leave_one_out is not None:
        changed = eqx.tree_at(lambda c: c.leave_one_out, changed, old.leave_one_out * move**2)
    return eqx.tree_at(lambda e: e.covariance, estimate, changed)


def residual_pixels(value: ArrowVariables, views: TargetViews) -> Float[Array, "views cameras points 2"]:
    """Measured minus predicted pixels; zero where nothing was seen."""

    def one(T: Pose, view: TargetViews) -> Array:
        predicted = jnp.stack(reproject(value.shared, T, view.points))
        return jnp.where(view.seen.visible[..., None], view.seen.uv - predicted, 0.0)

    return jax.vmap(one)(value.local, views)


def chessboard_points(columns: int, rows: int, square: float) -> np.ndarray:
    """Inner corners of a chessboard in its own frame, row by row, x along the columns, y along the rows, z = 0.

    Args:
        columns: inner corners along x.
        rows: inner corners along y.
        square: side of a square [scene].

    Returns:
        (columns * rows, 3).

    Raises:
        InputError: fewer than 2 x 2 corners (3 x 3 squares), or a side that is not a positive number.
    """
    if columns < 2 or rows < 2:
        raise InputError(f"board: expected at least 2x2 inner corners, got {columns}x{rows}")
    if not (np.isfinite(square) and square > 0):
        raise InputError(f"square: expected a positive length, got {square}")
    y, x = np.mgrid[0:rows, 0:columns]
    return np.stack([x.ravel() * square, y.ravel() * square, np.zeros(columns * rows)], axis=1).astype(float)


def visible_views(visible: Bool[Array, "views cameras points"] | np.ndarray) -> np.ndarray:
    """Number of views in which each camera sees anything."""
    return np.asarray(visible).any(axis=2).sum(axis=0)
