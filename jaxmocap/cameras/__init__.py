"""Differentiable camera models."""

from jaxmocap.cameras.camera import Camera as Camera
from jaxmocap.cameras.camera import pixel_of_point as pixel_of_point
from jaxmocap.cameras.camera import project as project
from jaxmocap.cameras.camera import project_from_camera as project_from_camera
from jaxmocap.cameras.camera import ray_from_pixel as ray_from_pixel
from jaxmocap.cameras.distortion import AbstractDistortion as AbstractDistortion
from jaxmocap.cameras.distortion import BrownDistortion as BrownDistortion
from jaxmocap.cameras.distortion import undistort as undistort
from jaxmocap.cameras.intrinsics import Intrinsics as Intrinsics
from jaxmocap.cameras.rig import camera_of as camera_of
from jaxmocap.cameras.rig import stack_cameras as stack_cameras
from jaxmocap.cameras.turntable import DOCUMENT_TABLE as DOCUMENT_TABLE
from jaxmocap.cameras.turntable import Turntable as Turntable
from jaxmocap.cameras.turntable import turntable_from_axis as turntable_from_axis
