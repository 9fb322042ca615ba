"""Joints <-> pose: chains, forward and inverse kinematics, Jacobians."""

from armsight.kinematics.arm import Arm, Joint, JointType, dh_arm
from armsight.kinematics.convention import Convention
from armsight.kinematics.forward import forward, forward_jacobian, in_convention, jacobian, link_frames, pose

__all__ = [
    "Arm",
    "Convention",
    "Joint",
    "JointType",
    "dh_arm",
    "forward",
    "forward_jacobian",
    "in_convention",
    "jacobian",
    "link_frames",
    "pose",
]
