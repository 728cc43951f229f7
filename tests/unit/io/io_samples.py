"""Cameras for the tests of files, and their texts."""

import jax.numpy as jnp
import numpy as np

from jaxmocap.cameras import BrownDistortion, Camera, Intrinsics
from jaxmocap.geometry import Pose
from jaxmocap.io import NamedCamera

# One camera as a user would type it. Tests replace parts of it.
CAMERA = """\
[cam_left]
name = "left"
size = [640, 480]
matrix = [[800.0, 0.0, 320.0], [0.0, 810.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.1, -0.2, 0.001, 0.002, 0.05]
rotation = [0.1, 0.2, 0.3]
translation = [1.0, 2.0, 3.0]
"""
METADATA = '[metadata]\nunit = "mm"\n'

YAML = """\
%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 800., 0., 320., 0., 810., 240.,
       0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 1.0e-01, -2.0e-01, 0.001, 0.002, 5.0e-02 ]
"""


def numbers_of(camera: Camera) -> list[float]:
    """All numbers of a camera, field by field."""
    i, lens, pose = camera.intrinsics, camera.distortion, camera.T_camera_world
    leaves = [i.fx, i.fy, i.cx, i.cy, i.skew, lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]
    return [float(x) for x in leaves] + np.asarray(pose.rotvec).tolist() + np.asarray(pose.translation).tolist()


def camera_of_numbers(numbers: list[float], size: tuple[int, int] = (640, 480)) -> Camera:
    """The inverse of `numbers_of`."""
    scalars = [jnp.asarray(x) for x in numbers[:10]]
    pose = Pose(jnp.asarray(numbers[10:13]), jnp.asarray(numbers[13:16]))
    return Camera(Intrinsics(*scalars[:5]), BrownDistortion(*scalars[5:]), pose, size)


def simple(name: str, x: float = 0.0, skew: float = 0.0) -> NamedCamera:
    """A camera of a side-by-side rig."""
    numbers = [800.0, 810.0, 320.0, 240.0, skew, 0.1, -0.2, 1e-3, 2e-3, 0.05, 0.1, -0.2, 0.3, x, 0.5, 2.0]
    return NamedCamera(name, camera_of_numbers(numbers))
