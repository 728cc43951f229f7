"""Bodies: trees of joints, the puppet as data, and motions of either."""

from jaxmocap.bodies import puppet as puppet
from jaxmocap.bodies.motion import SkeletonMotion as SkeletonMotion
from jaxmocap.bodies.tree import KinematicTree as KinematicTree
from jaxmocap.bodies.tree import chain as chain
from jaxmocap.bodies.tree import forward_kinematics as forward_kinematics
from jaxmocap.bodies.tree import joint_matrices as joint_matrices
