"""Cameras from what they saw: linear start values, joint refinement, what speaks against the result."""

from jaxmocap.calibration.boards import TargetViews as TargetViews
from jaxmocap.calibration.boards import chessboard_points as chessboard_points
from jaxmocap.calibration.boards import free_parameters as free_parameters
from jaxmocap.calibration.boards import refine_targets as refine_targets
from jaxmocap.calibration.dlt import decompose_projection as decompose_projection
from jaxmocap.calibration.dlt import fit_projection_linear as fit_projection_linear
from jaxmocap.calibration.dlt import refine_projection as refine_projection
from jaxmocap.calibration.homography import fit_homography_linear as fit_homography_linear
from jaxmocap.calibration.homography import refine_homography as refine_homography
from jaxmocap.calibration.start import start_camera as start_camera
from jaxmocap.calibration.start import start_rig as start_rig
from jaxmocap.calibration.turntable import TurntableEstimate as TurntableEstimate
from jaxmocap.calibration.turntable import bead_prior as bead_prior
from jaxmocap.calibration.turntable import solve_beads as solve_beads
from jaxmocap.calibration.turntable import solve_board as solve_board
from jaxmocap.calibration.turntable_start import start_beads as start_beads
from jaxmocap.calibration.turntable_start import start_board as start_board
from jaxmocap.calibration.weakness import find_weaknesses as find_weaknesses
from jaxmocap.calibration.zhang import fit_distortion_linear as fit_distortion_linear
from jaxmocap.calibration.zhang import fit_focal_linear as fit_focal_linear
from jaxmocap.calibration.zhang import fit_intrinsics_linear as fit_intrinsics_linear
from jaxmocap.calibration.zhang import mirrored_pose as mirrored_pose
from jaxmocap.calibration.zhang import pose_from_homography as pose_from_homography
