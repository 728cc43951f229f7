"""Points in space and the puppet's skeleton from what cameras saw."""

from jaxmocap.reconstruction.skeleton import SkeletonPose as SkeletonPose
from jaxmocap.reconstruction.skeleton import bone_directions as bone_directions
from jaxmocap.reconstruction.skeleton import bone_translations as bone_translations
from jaxmocap.reconstruction.skeleton import motion_from_poses as motion_from_poses
from jaxmocap.reconstruction.skeleton import skeleton_from_markers as skeleton_from_markers
