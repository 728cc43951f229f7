"""Rotations, poses and projective algebra. Knows no camera."""

from jaxmocap.geometry import projective as projective
from jaxmocap.geometry import rotation as rotation
from jaxmocap.geometry.pose import Pose as Pose
