"""One camera before a turntable is many cameras around what stands on it: the document's table, and a real build.

World: y the turning axis, upwards; z horizontal, towards the camera at angle 0; x to the right in the picture; it
turns with the table. At angle a the camera stands at (-D sin a, h, D cos a). A real build is not the document's:
the axis leans and the camera is turned, which together is one rotation of the camera at angle 0 (three numbers);
distance and height make five. The height only says where on the axis the origin lies.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._arrays import Matrix3, Scalar, Vector2, Vector3
from jaxmocap.geometry import Pose, rotation

DOCUMENT_DISTANCE, DOCUMENT_HEIGHT = 400.0, 80.0
"""Camera centre to axis, and lens above the platform [mm]. Source: stop-motion document, 2.1 and 4.2."""

TABLE_COLUMNS = ("angle", "r_x", "r_y", "r_z", "t_x", "t_y", "t_z")
"""Columns of `DOCUMENT_TABLE`: degrees and millimetres."""

DOCUMENT_TABLE = np.array(
    [
        (0, 180, 0, 0, 0, 80, 400),
        (30, 180, -30, 0, -200, 80, 346),
        (60, 180, -60, 0, -346, 80, 200),
        (90, 180, -90, 0, -400, 80, 0),
        (120, 180, -120, 0, -346, 80, -200),
        (150, 180, -150, 0, -200, 80, -346),
        (180, 180, 180, 0, 0, 80, -400),
        (210, 180, 150, 0, 200, 80, -346),
        (240, 180, 120, 0, 346, 80, -200),
        (270, 180, 90, 0, 400, 80, 0),
        (300, 180, 60, 0, 346, 80, 200),
        (330, 180, 30, 0, 200, 80, 346),
    ],
    dtype=float,
)
"""The twelve virtual cameras as printed. Source: stop-motion document, table of 4.2.2."""


class Turntable(eqx.Module):
    r"""A camera before a turntable: p_camera = R0 (Ry(a) p_world - (0, h, D)), R0 = exp(rotvec).

    Source: stop-motion document, eq. 4.14-4.17; R0 = Rx(180 degrees) is its perfect build.
    """

    rotvec: Float[Array, "*batch 3"]
    """Rotation world -> camera at angle 0 [rad]; (pi, 0, 0) for a perfect build."""
    distance: Float[Array, "*batch"]
    """D, camera centre to axis [scene]."""
    height: Float[Array, "*batch"]
    """h, height above the origin of the point of the axis nearest the camera centre [scene]."""

    @classmethod
    def nominal(cls, distance: float = DOCUMENT_DISTANCE, height: float = DOCUMENT_HEIGHT) -> "Turntable":
        """The perfect build: axis upright in the picture, camera pointing at it."""
        return cls(jnp.array([jnp.pi, 0.0, 0.0]), jnp.asarray(float(distance)), jnp.asarray(float(height)))

    def act(self, angle: Scalar, p_world: Vector3) -> Vector3:
        """Camera coordinates [scene] of a point of the turning world at an angle [rad]; no `log`, so smooth at pi."""
        c, s = jnp.cos(angle), jnp.sin(angle)
        x, y, z = p_world[0], p_world[1], p_world[2]
        turned = jnp.stack([c * x + s * z, y - self.height, c * z - s * x - self.distance])
        return rotation.rotate(self.rotvec, turned)

    def pose(self, angle: Scalar) -> Pose:
        """T_camera_world at an angle [rad]."""
        R = rotation.exp(self.rotvec) @ turn(angle)
        zero = jnp.zeros_like(self.distance)
        offset = jnp.stack([zero, self.height, self.distance])
        return Pose(rotation.log(R), -rotation.rotate(self.rotvec, offset))

    def axis(self) -> tuple[Vector3, Vector3]:
        """The axis in the camera frame at angle 0 (it is the same line at every angle).

        Returns:
            point of the axis nearest the camera centre [scene]; unit direction, upwards.
        """
        zero = jnp.zeros_like(self.distance)
        point = rotation.rotate(self.rotvec, jnp.stack([zero, zero, -self.distance]))
        return point, rotation.rotate(self.rotvec, jnp.array([0.0, 1.0, 0.0], dtype=point.dtype))

    def deviation(self) -> Vector3:
        """By how much the camera at angle 0 is turned away from the perfect build.

        Returns:
            rotation vector in the camera frame [rad]: about x (axis leans in depth; positive: its top towards the
            camera), about y (camera turned aside from the axis; positive: the axis lies right of the image centre),
            about z (axis leans in the picture; positive: its top to the right).
        """
        return rotation.log(rotation.exp(self.rotvec) @ jnp.diag(jnp.array([1.0, -1.0, -1.0])))


def turn(angle: Scalar) -> Matrix3:
    """Ry(angle): rotation about the axis. Source: stop-motion document, eq. 4.16."""
    zero = jnp.zeros_like(angle)
    return rotation.exp(jnp.stack([zero, angle, zero]))


def turntable_from_axis(point: Vector3, direction: Vector3, height: Scalar) -> Turntable:
    """The turntable whose axis is a given line of the camera frame at angle 0.

    Args:
        point: any point of the axis, in the camera frame [scene]; the axis must not meet the camera centre.
        direction: along the axis, upwards, of any length but 0.
        height: of the point nearest the camera centre above the origin [scene].

    Returns:
        Turntable; its rotation vector has a positive x, so that small changes of the axis are small changes of it.
    Source: stop-motion document, 4.2 (its world; z of the world points from the axis to the camera).
    """
    y = direction / jnp.sqrt(jnp.sum(direction * direction))
    nearest = point - y * jnp.sum(point * y)
    distance = jnp.sqrt(jnp.sum(nearest * nearest))
    z = -nearest / distance
    rotvec = rotation.log(jnp.stack([jnp.cross(y, z), y, z], axis=1))
    # A perfect build turns by pi about x, where w and w - 2 pi w / |w| are one rotation: take the one near (pi, 0, 0).
    length = jnp.sqrt(jnp.sum(rotvec * rotvec))
    rotvec = jnp.where(rotvec[0] < 0, rotvec * (1.0 - 2.0 * jnp.pi / length), rotvec)
    return Turntable(rotvec, distance, height)


def document_translation(
    angle: Scalar, distance: float = DOCUMENT_DISTANCE, height: float = DOCUMENT_HEIGHT
) -> Vector3:
    """Camera centre in the turning world [mm] at an angle [rad]. Source: stop-motion document, eq. 4.14-4.15."""
    return jnp.stack([-distance * jnp.sin(angle), jnp.full_like(angle, height), distance * jnp.cos(angle)])


def document_T_world_camera(
    angle: Scalar, distance: float = DOCUMENT_DISTANCE, height: float = DOCUMENT_HEIGHT
) -> Float[Array, "4 4"]:
    """M_W^C = T Ry(-a) Rx(180 degrees): camera coordinates to world coordinates.

    Args:
        angle: a [rad].
        distance: of the camera centre from the axis [mm].
        height: of the camera centre above the platform [mm].

    Returns:
        Homogeneous 4x4 matrix, composed as printed; `Turntable.nominal` is the same camera.
    Source: stop-motion document, eq. 4.16.
    """
    R = turn(-angle) @ jnp.diag(jnp.array([1.0, -1.0, -1.0]))
    top = jnp.concatenate([R, document_translation(angle, distance, height)[:, None]], axis=1)
    return jnp.concatenate([top, jnp.array([[0.0, 0.0, 0.0, 1.0]])])


def document_T_camera_world(
    angle: Scalar, distance: float = DOCUMENT_DISTANCE, height: float = DOCUMENT_HEIGHT
) -> Float[Array, "4 4"]:
    """M_C^W = Rx(180 degrees) Ry(a) T(D sin a, -h, -D cos a): world coordinates to camera coordinates.

    Args:
        angle: a [rad].
        distance: of the camera centre from the axis [mm].
        height: of the camera centre above the platform [mm].

    Returns:
        Homogeneous 4x4 matrix, composed as printed.
    Source: stop-motion document, eq. 4.17.
    """
    R = jnp.diag(jnp.array([1.0, -1.0, -1.0])) @ turn(angle)
    t = R @ -document_translation(angle, distance, height)
    return jnp.concatenate([jnp.concatenate([R, t[:, None]], axis=1), jnp.array([[0.0, 0.0, 0.0, 1.0]])])


def document_pixel(P_pro: Float[Array, "3 4"], angle: Scalar, p_world: Vector3) -> Vector2:
    """Pixel of a world point in the picture taken at an angle, p_B = P_pro M_C^W(a) p_W (ideal lens).

    Args:
        P_pro: projection of the document's eq. 4.12 [px].
        angle: a [rad].
        p_world: point in front of the camera [mm].

    Returns:
        uv [px].
    Source: stop-motion document, eq. 4.18.
    """
    p = P_pro @ document_T_camera_world(angle) @ jnp.concatenate([p_world, jnp.ones_like(p_world[:1])])
    return p[:2] / p[2]
