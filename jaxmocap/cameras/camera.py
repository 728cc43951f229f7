"""The camera: intrinsics, lens, pose; from points to pixels and from pixels to rays."""

import equinox as eqx
import jax.numpy as jnp

from jaxmocap._arrays import Flag, Vector2, Vector3
from jaxmocap.cameras.distortion import BrownDistortion, undistort
from jaxmocap.cameras.intrinsics import Intrinsics
from jaxmocap.geometry import Pose, rotation


class Camera(eqx.Module):
    """One camera; a rig is the same module with a leading camera axis on every array.

    Source: optical tracking document, 4.2-4.3; stop-motion document, 4.
    """

    intrinsics: Intrinsics
    """K [px]."""
    distortion: BrownDistortion
    """Lens [1]."""
    T_camera_world: Pose
    """World coordinates -> camera coordinates (x right, y down, z forward)."""
    image_size: tuple[int, int] = eqx.field(static=True)
    """(width, height) [px]."""


def pixel_of_point(intrinsics: Intrinsics, lens: BrownDistortion, p_camera: Vector3) -> Vector2:
    r"""Pixel of a point given in camera coordinates, without asking whether it can be seen.

    uv = K [d(x/z, y/z), 1].

    Args:
        intrinsics: K [px].
        lens: distortion [1].
        p_camera: point, z forward [scene].

    Returns:
        uv [px]; finite and differentiable everywhere.
    Source: optical tracking document, eq. 4.10, 4.16-4.18; stop-motion document, eq. 4.8-4.9.
    """
    z = p_camera[2]
    # A point behind is projected from the mirrored side: finite, and pointing a solver back to the front.
    depth = jnp.where(z > 0, z, jnp.where(z < 0, -z, 1.0))
    return intrinsics.pixel_from_normalised(lens.distort(jnp.stack([p_camera[0] / depth, p_camera[1] / depth])))


def project_from_camera(intrinsics: Intrinsics, lens: BrownDistortion, p_camera: Vector3) -> tuple[Vector2, Flag]:
    r"""Pixel of a point given in camera coordinates, and whether the camera can see it.

    Args:
        intrinsics: K [px].
        lens: distortion [1].
        p_camera: point, z forward [scene].

    Returns:
        uv [px]; finite and differentiable everywhere.
        valid: False behind the camera or beyond the radius where the lens model can be inverted.
    Source: as `pixel_of_point`.
    """
    x, y, z = p_camera[0], p_camera[1], p_camera[2]
    inside = x * x + y * y < lens.valid_radius_squared() * z * z
    return pixel_of_point(intrinsics, lens, p_camera), (z > 0) & inside


def project(camera: Camera, p_world: Vector3) -> tuple[Vector2, Flag]:
    r"""Pixel at which a camera sees a point.

    uv = K [d(x/z, y/z), 1],   (x, y, z) = T_camera_world p_world

    Args:
        camera: intrinsics [px], lens [1], pose [rad, scene].
        p_world: point in world coordinates [scene].

    Returns:
        uv [px], (0, 0) at the centre of the top-left pixel; finite and differentiable everywhere.
        valid: False behind the camera or beyond the invertible radius; uv is then meaningless, mask it.
    Source: stop-motion document, eq. 4.8-4.18; optical tracking document, eq. 4.14-4.18.
    """
    return project_from_camera(camera.intrinsics, camera.distortion, camera.T_camera_world.act(p_world))


def ray_from_pixel(camera: Camera, uv: Vector2) -> tuple[Vector3, Vector3, Flag]:
    r"""Ray on which everything lies that a camera sees at a pixel.

    Args:
        camera: as in `project`.
        uv: pixel [px], raw (distorted).

    Returns:
        centre: camera centre in world coordinates [scene].
        v_world: direction, of length 1, in world coordinates.
        valid: False where the lens folds back and no point inside the invertible radius is seen at uv.
    Source: optical tracking document, 4.3 and eq. 4.11; stop-motion document, eq. 5.1-5.8 with the distortion
        removed first, as its 8.2 asks for.
    """
    xy, valid = undistort(camera.distortion, camera.intrinsics.normalised_from_pixel(uv))
    v_camera = jnp.stack([xy[0], xy[1], jnp.ones_like(xy[0])])
    v_camera = v_camera / jnp.sqrt(jnp.sum(v_camera * v_camera))
    back = -camera.T_camera_world.rotvec
    return -rotation.rotate(back, camera.T_camera_world.translation), rotation.rotate(back, v_camera), valid
