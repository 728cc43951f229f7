"""Targets moved to their own middle for a calibration, and the result moved back.

A target whose frame lies far from it (surveyed coordinates) ties its translation to its rotation: turning about the
distant origin by one unit of rounding moves the target as far as a pixel does. About the target's middle the two
are nearly independent, wherever the user's origin is.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._programs import program
from jaxmocap.calibration.boards import TargetViews
from jaxmocap.geometry import Pose, rotation
from jaxmocap.optim import ArrowVariables
from jaxmocap.optim.covariance import ArrowCovariance
from jaxmocap.results import Estimate


def centred(views: TargetViews) -> tuple[TargetViews, Float[np.ndarray, "views 3"]]:
    """The views with each target's frame moved to the middle of the points seen of it.

    Args:
        views: known points and where they were seen.

    Returns:
        views; the middles in the targets' own frames [scene], zero where nothing was seen.
    """
    points, seen = np.asarray(views.points), np.asarray(views.seen.visible).any(axis=1)
    count = np.maximum(seen.sum(axis=1), 1)[:, None]
    # Twice: the first mean of large numbers is rounded, the mean of what is left of them is not.
    middle = np.where(seen[..., None], points, 0.0).sum(axis=1) / count  # pyright: ignore[reportIndexIssue]
    moved = points - middle[:, None]
    rest = np.where(seen[..., None], moved, 0.0).sum(axis=1) / count  # pyright: ignore[reportIndexIssue]
    return replace(views, points=jnp.asarray(moved - rest[:, None])), middle + rest


def moved_back(estimate: Estimate, middle: Float[np.ndarray, "views 3"]) -> Estimate:
    """A result of centred views in the targets' own frames: T_rig_target and its covariance.

    Args:
        estimate: of `refine_targets`, all six numbers of every pose free.
        middle: as `centred` returns it.

    Returns:
        The estimate with t = t_centred - R middle in every pose.
    Source: p_rig = R (p - middle) + t_centred; covariances follow by the chain rule.
    """
    local = _own_frame(estimate.value.local, jnp.asarray(middle))
    value = ArrowVariables(estimate.value.shared, local)
    covariance = estimate.covariance
    if covariance is not None:
        covariance = _covariance_in_own_frame(covariance, local.rotvec, jnp.asarray(middle))
    return replace(estimate, value=value, covariance=covariance)


def _translation(rotvec: Array, middle: Array) -> Array:
    """What moving the frame back adds to a pose's translation."""
    return -rotation.rotate(rotvec, middle)


@program
def _own_frame(T: Pose, middle: Array) -> Pose:
    return Pose(T.rotvec, T.translation + jax.vmap(_translation)(T.rotvec, middle))


@program
def _covariance_in_own_frame(covariance: ArrowCovariance, rotvec: Array, middle: Array) -> ArrowCovariance:
    """The factors for z = A z_centred, A = [[I, 0], [d translation / d rotvec, I]] of each block.

    T becomes A T. H = L L^T becomes A^-T L L^T A^-1; its triangular factor comes from a QR decomposition of
    L^T A^-1, since forming H would square the condition number that a distant origin brings.
    """

    def one(L: Array, T: Array, w: Array, c: Array) -> tuple[Array, Array]:
        J = jax.jacfwd(_translation)(w, c)
        A, back = jnp.eye(6).at[3:, :3].set(J), jnp.eye(6).at[3:, :3].set(-J)
        return jnp.linalg.qr(L.T @ back)[1].T, A @ T

    L, T = jax.vmap(one, (2, 2, 0, 0), 2)(covariance.L, covariance.T, rotvec, middle)
    return replace(covariance, L=L, T=T)
