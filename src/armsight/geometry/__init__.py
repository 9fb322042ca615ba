"""Rotations, poses, their uncertainty, and alignment, on scipy's Rotation and RigidTransform."""

from armsight.geometry.poses import Alignment as Alignment
from armsight.geometry.poses import align_points as align_points
from armsight.geometry.poses import compose_covariance as compose_covariance
from armsight.geometry.poses import euler_rad as euler_rad
from armsight.geometry.poses import inverse_covariance as inverse_covariance
from armsight.geometry.poses import is_close as is_close
from armsight.geometry.poses import moved_parent_covariance as moved_parent_covariance
from armsight.geometry.poses import pose_difference as pose_difference
from armsight.geometry.poses import pose_from_euler as pose_from_euler
from armsight.geometry.poses import pose_from_matrix as pose_from_matrix
from armsight.geometry.poses import pose_from_quat as pose_from_quat
from armsight.geometry.poses import pose_from_rotvec as pose_from_rotvec
from armsight.geometry.poses import quat_of_matrix as quat_of_matrix
from armsight.geometry.poses import xyz_quat as xyz_quat
