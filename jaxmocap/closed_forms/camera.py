"""Derivatives of projection in closed form, by the chain rule: pixel, lens, perspective, rotation."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxmocap._arrays import Vector2, Vector3
from jaxmocap.cameras import Camera
from jaxmocap.closed_forms.distortion import J_distorted_ideal
from jaxmocap.closed_forms.rotation import J_rotated_rotvec
from jaxmocap.geometry import rotation

Jacobian23 = Float[Array, "2 3"]


def J_uv_point(camera: Camera, p_world: Vector3) -> Jacobian23:
    r"""Derivative of the pixel by the world point: [[fx, skew], [0, fy]] J_lens J_perspective R.

    Args:
        camera: as in `cameras.project`.
        p_world: point in front of the camera [scene].

    Returns:
        J [px per scene unit].
    Source: stop-motion document, eq. 4.8-4.18; optical tracking document, eq. 4.14-4.18, differentiated.
    """
    return _J_uv_camera(camera, camera.T_camera_world.act(p_world)) @ rotation.exp(camera.T_camera_world.rotvec)


def J_uv_rotvec(camera: Camera, p_world: Vector3) -> Jacobian23:
    r"""Derivative of the pixel by the rotation vector of the camera.

    Args:
        camera: as in `cameras.project`.
        p_world: point in front of the camera [scene].

    Returns:
        J [px per rad].
    Source: optical tracking document, eq. 4.14-4.18 and the derivative of W P below eq. 5.42.
    """
    J = J_rotated_rotvec(camera.T_camera_world.rotvec, p_world)
    return _J_uv_camera(camera, camera.T_camera_world.act(p_world)) @ J


def _J_uv_camera(camera: Camera, p_camera: Vector3) -> Jacobian23:
    """Derivative of the pixel by the point in camera coordinates."""
    x, y, z = p_camera[0], p_camera[1], p_camera[2]
    xy: Vector2 = jnp.stack([x / z, y / z])
    zero = jnp.zeros_like(z)
    J_perspective = jnp.stack([jnp.stack([1.0 / z, zero, -x / z**2]), jnp.stack([zero, 1.0 / z, -y / z**2])])
    return camera.intrinsics.matrix()[:2, :2] @ J_distorted_ideal(camera.distortion, xy) @ J_perspective
