"""Rotations, poses, their uncertainty, and alignment, on scipy's Rotation and RigidTransform."""

from armsight.geometry.poses import (
    Alignment,
    align_points,
    compose_covariance,
    euler_rad,
    inverse_covariance,
    is_close,
    moved_parent_covariance,
    pose_difference,
    pose_from_euler,
    pose_from_matrix,
    pose_from_quat,
    pose_from_rotvec,
    quat_of_matrix,
    xyz_quat,
)

__all__ = [
    "Alignment",
    "align_points",
    "compose_covariance",
    "euler_rad",
    "inverse_covariance",
    "is_close",
    "moved_parent_covariance",
    "pose_difference",
    "pose_from_euler",
    "pose_from_matrix",
    "pose_from_quat",
    "pose_from_rotvec",
    "quat_of_matrix",
    "xyz_quat",
]
