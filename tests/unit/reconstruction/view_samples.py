"""Cameras around a small scene, as plain numbers (projection by OpenCV), and as our stacked Camera."""

import cv2
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.cameras import BrownDistortion, Camera, Intrinsics, stack_cameras
from jaxmocap.geometry import Pose

VIEWS = 6
K = np.array([[859.0, 0, 337.3], [0, 860.2, 288.2], [0, 0, 1]])
LENS = np.array([-0.12, 0.03, 0.001, -0.002, 0.0])


def poses(views: int = VIEWS) -> tuple[np.ndarray, np.ndarray]:
    """Rotation vectors and translations, world to camera: a half circle of radius 400 around the origin."""
    angles = np.linspace(0, 150, views)
    R = Rotation.from_euler("x", 180, degrees=True) * Rotation.from_euler("y", angles[:, None], degrees=True)
    R = Rotation.from_rotvec(np.random.default_rng(5).normal(0, 0.03, (views, 3))) * R
    return R.as_rotvec(), np.tile([0.0, 10.0, 400.0], (views, 1))


def rig(views: int = VIEWS) -> Camera:
    """The same cameras, stacked."""
    intrinsics = Intrinsics.from_matrix(jnp.asarray(K))
    lens = BrownDistortion.from_vector(jnp.asarray(LENS))
    return stack_cameras(
        [Camera(intrinsics, lens, Pose(jnp.asarray(r), jnp.asarray(t)), (704, 576)) for r, t in zip(*poses(views))]
    )


def pixels(points: np.ndarray, views: int = VIEWS) -> np.ndarray:
    """(points, views, 2) exact pixels by OpenCV."""
    out = [cv2.projectPoints(points, r, t, K, LENS)[0][:, 0] for r, t in zip(*poses(views))]
    return np.stack(out, axis=1)
