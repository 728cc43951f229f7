"""Everything a report shows of a solved rig, computed in one compiled step and handed over as plain arrays."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap._programs import program
from jaxmocap.calibration.boards import RigParameters, TargetViews, residual_pixels
from jaxmocap.geometry import Pose, rotation
from jaxmocap.optim import ArrowVariables


class RigDescription(NamedTuple):
    """Plain arrays about a solved rig."""

    residual: np.ndarray
    """(views, cameras, points, 2) measured minus predicted [px]; zero where nothing was seen."""
    R_camera_target: np.ndarray
    """(views, cameras, 3, 3)."""
    t_camera_target: np.ndarray
    """(views, cameras, 3) [scene]."""
    rotvec_camera_rig: np.ndarray
    """(cameras, 3) [rad], at most pi long."""
    t_camera_rig: np.ndarray
    """(cameras, 3) [scene]."""
    K: np.ndarray
    """(cameras, 3, 3) [px]."""
    distortion: np.ndarray
    """(cameras, 5) k1 k2 p1 p2 k3 [1]."""
    ideal_limit: np.ndarray
    """(cameras,) ideal normalised radius at which the lens folds back; infinite where it never does."""


@program
def _describe(value: ArrowVariables, views: TargetViews) -> tuple[jax.Array, ...]:
    """The fields of RigDescription, in its order."""
    rig: RigParameters = value.shared
    to_camera = [Pose.identity(), *(pose.canonical() for pose in rig.T_camera_rig)]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *to_camera)

    def stand(T_rig_target: Pose, T_camera_rig: Pose) -> tuple[jax.Array, jax.Array]:
        R = rotation.exp(T_camera_rig.rotvec) @ rotation.exp(T_rig_target.rotvec)
        return R, T_camera_rig.act(T_rig_target.translation)

    R, t = jax.vmap(jax.vmap(stand, (None, 0)), (0, None))(value.local, stacked)
    return (
        residual_pixels(value, views),
        R,
        t,
        stacked.rotvec,
        stacked.translation,
        jnp.stack([lens.intrinsics.matrix() for lens in rig.lenses]),
        jnp.stack([lens.distortion.vector() for lens in rig.lenses]),
        jnp.sqrt(jnp.stack([lens.distortion.valid_radius_squared() for lens in rig.lenses])),
    )


def describe(value: ArrowVariables, views: TargetViews) -> RigDescription:
    """Plain arrays about a solved rig.

    Args:
        value: of `refine_targets`.
        views: what was seen.

    Returns:
        RigDescription of numpy arrays.

    Source: optical tracking document, eq. 4.10-4.18 (the models that are evaluated).
    """
    return RigDescription(*(np.asarray(x) for x in _describe(value, views)))
