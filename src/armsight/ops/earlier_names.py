"""Functions of earlier versions, each of which another name does now."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

from armsight.ops.calibrate_hand_eye import calibrate_hand_eye

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


def _warn(now: str) -> None:
    warnings.warn(f"use {now}", DeprecationWarning, stacklevel=3)
