"""Points in space and the puppet's skeleton from what cameras saw."""

from jaxmocap.reconstruction.bone_directions import bone_directions as bone_directions
from jaxmocap.reconstruction.pose_from_pixels import joint_angles as joint_angles
from jaxmocap.reconstruction.pose_from_pixels import pose_from_pixels as pose_from_pixels
from jaxmocap.reconstruction.refinement import RefinedPoint as RefinedPoint
from jaxmocap.reconstruction.refinement import ViewVerdict as ViewVerdict
from jaxmocap.reconstruction.refinement import name_wrong_views as name_wrong_views
from jaxmocap.reconstruction.refinement import refine_point as refine_point
from jaxmocap.reconstruction.skeleton import SkeletonPose as SkeletonPose
from jaxmocap.reconstruction.skeleton import bone_translations as bone_translations
from jaxmocap.reconstruction.skeleton import motion_from_poses as motion_from_poses
from jaxmocap.reconstruction.skeleton import skeleton_from_markers as skeleton_from_markers
from jaxmocap.reconstruction.skeleton_fit import SkeletonFit as SkeletonFit
from jaxmocap.reconstruction.skeleton_fit import fit_skeleton_to_pixels as fit_skeleton_to_pixels
from jaxmocap.reconstruction.skeleton_fit import fit_skeleton_to_points as fit_skeleton_to_points
from jaxmocap.reconstruction.triangulation import fit_point_dlt as fit_point_dlt
from jaxmocap.reconstruction.triangulation import fit_point_linear as fit_point_linear
from jaxmocap.reconstruction.triangulation import midpoint as midpoint
from jaxmocap.reconstruction.triangulation import point_as_printed as point_as_printed
from jaxmocap.reconstruction.triangulation import rays as rays
