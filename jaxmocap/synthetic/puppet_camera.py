"""The camera and the turntable of drawn puppet photos, in numpy of their own.

Written apart from `jaxmocap.cameras` on purpose: what is tested against these pictures must not have drawn them.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

Array = np.ndarray
Number = np.ndarray | np.floating


@dataclass(frozen=True)
class PuppetCamera:
    """Lens and size of the picture; the defaults are the stop-motion document's webcam with its lens errors."""

    fx: float = 859.0
    fy: float = 860.2
    cx: float = 337.3
    cy: float = 288.2
    k1: float = -0.12
    k2: float = 0.03
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    width: int = 704
    height: int = 576

    def matrix(self) -> Array:
        """K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def distortions(self) -> Array:
        """k1 k2 p1 p2 k3."""
        return np.array([self.k1, self.k2, self.p1, self.p2, self.k3])


def distort(camera: PuppetCamera, x: Number, y: Number) -> tuple[Number, Number]:
    """Normalised coordinates that the lens makes of ideal ones."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (camera.k1 + r2 * (camera.k2 + r2 * camera.k3))
    return (
        x * radial + 2.0 * camera.p1 * x * y + camera.p2 * (r2 + 2.0 * x * x),
        y * radial + camera.p1 * (r2 + 2.0 * y * y) + 2.0 * camera.p2 * x * y,
    )


def pixels(camera: PuppetCamera, p_camera: Array) -> Array:
    """Pixels (..., 2) of points (..., 3) in front of the camera."""
    x, y = distort(camera, p_camera[..., 0] / p_camera[..., 2], p_camera[..., 1] / p_camera[..., 2])
    return np.stack([camera.fx * x + camera.cx, camera.fy * y + camera.cy], axis=-1)


def ideal(camera: PuppetCamera, u: Array, v: Array) -> tuple[Array, Array]:
    """Ideal normalised coordinates seen at pixels, by fixed-point iteration to 1e-12.

    Raises:
        ValueError: the lens folds back inside the picture.
    """
    goal_x, goal_y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    x, y = goal_x.copy(), goal_y.copy()
    for _ in range(100):
        is_x, is_y = distort(camera, x, y)
        x += goal_x - is_x
        y += goal_y - is_y
        if max(np.abs(is_x - goal_x).max(), np.abs(is_y - goal_y).max()) < 1e-12:
            return x, y
    raise ValueError("the lens model cannot be inverted inside the picture")


def _between(grid: Array, n: int) -> Array:
    """Rows of a grid with a margin of one at both ends, linearly at n places of every pixel."""
    out = np.empty(((len(grid) - 2) * n, *grid.shape[1:]), dtype=np.float32)
    for k in range(n):
        f = (k + 0.5) / n - 0.5
        low = -1 if f < 0 else 0
        w = f - low
        out[k::n] = (1 - w) * grid[1 + low : len(grid) - 1 + low] + w * grid[2 + low : len(grid) + low or None]
    return out


@lru_cache(maxsize=4)
def ray_grid(camera: PuppetCamera, samples: int) -> tuple[Array, Array]:
    """Ideal coordinates x, y (height * samples, width * samples) of every sub-pixel; float32.

    Exact at pixel centres, linear between them: the lens bends by less than 1e-4 px within a pixel.
    """
    v, u = np.mgrid[-1 : camera.height + 1, -1 : camera.width + 1].astype(float)
    x, y = (_between(_between(g, samples).T, samples).T.copy() for g in ideal(camera, u, v))
    for g in (x, y):
        g.setflags(write=False)
    return x, y


@dataclass(frozen=True)
class Build:
    """How the turntable stands before the camera; the defaults are the perfect build of the document."""

    distance: float = 400.0
    """Camera centre to axis [mm]."""
    height: float = 80.0
    """Of the camera centre above the origin, along the axis [mm]."""
    tilt: float = 0.0
    """Angle between the axis and the camera's vertical [rad]."""
    tilt_towards: float = 0.0
    """Where the axis leans, in the camera's horizontal plane: 0 to the right, pi/2 away [rad]."""
    turned: float = 0.0
    """The camera is turned about its own vertical: the axis moves to the left in the picture if > 0 [rad]."""

    def rotation(self) -> Array:
        """R_camera_world at angle 0."""
        lean = np.array([np.sin(self.tilt_towards), 0.0, -np.cos(self.tilt_towards)])
        tilted = Rotation.from_rotvec(-self.tilt * lean) * Rotation.from_rotvec([np.pi, 0.0, 0.0])
        return (Rotation.from_rotvec([0.0, -self.turned, 0.0]) * tilted).as_matrix()

    def world_to_camera(self, angle: float) -> Array:
        """(4, 4) at a turntable angle [rad]."""
        T = np.eye(4)
        T[:3, :3] = self.rotation() @ Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix()
        T[:3, 3] = -self.rotation() @ np.array([0.0, self.height, self.distance])
        return T

    def axis(self) -> tuple[Array, Array]:
        """The axis in the camera frame: the point nearest the camera centre and the direction upwards."""
        R = self.rotation()
        return R @ np.array([0.0, 0.0, -self.distance]), R @ np.array([0.0, 1.0, 0.0])
