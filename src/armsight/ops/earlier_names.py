"""Names of earlier versions, for each of which another one stands now."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

from armsight.calibrate.identify import Identification
from armsight.ops.calibrate_hand_eye import calibrate_hand_eye
from armsight.ops.identify import identify_arm

if TYPE_CHECKING:
    from armsight.calibrate.handeye import HandEyeResult


def calibrate_hand_eye_from_images(
    images: Any, T_base_flange: Any, camera: Any, board: Any, **more: Any
) -> HandEyeResult:
    """Do as calibrate_hand_eye(images=images, robot=T_base_flange, camera=camera, board=board)."""
    _warn("calibrate_hand_eye(images=..., robot=T_base_flange, camera=..., board=...)")
    return calibrate_hand_eye(images=images, robot=T_base_flange, camera=camera, board=board, **more)


def calibrate_hand_eye_from_streams(robot_stream: Any, camera_stream: Any, **more: Any) -> HandEyeResult:
    """Do as calibrate_hand_eye(robot_stream=robot_stream, camera_stream=camera_stream)."""
    _warn("calibrate_hand_eye(robot_stream=..., camera_stream=...)")
    return calibrate_hand_eye(robot_stream=robot_stream, camera_stream=camera_stream, **more)


def identify_arm_from_frames(rig: Any, target: Any, left: Any, right: Any, joints: Any, **more: Any) -> Identification:
    """Do as identify_arm(rig=rig, target=target, left=left, right=right, joints=joints)."""
    _warn("identify_arm(rig=..., target=..., left=..., right=..., joints=...)")
    return identify_arm(rig=rig, target=target, left=left, right=right, joints=joints, **more)


def __getattr__(name: str) -> Any:
    """Return what identify_arm and identify_arm_live return, by the names that it had."""
    if name not in ("ArmIdentification", "LiveIdentification"):
        raise AttributeError(name)
    _warn("Identification", 4)
    return Identification


def _warn(now: str, level: int = 3) -> None:
    warnings.warn(f"use {now}", DeprecationWarning, stacklevel=level)
