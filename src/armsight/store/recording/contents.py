"""What a message on a channel says, of recordings and of live viewers alike: records as JSON, by their schemas."""

from __future__ import annotations

from typing import Any

import numpy as np

from armsight.geometry import xyz_quat
from armsight.records import JointReading, PoseStatus, TargetPose
from armsight.store.recording import schemas
from armsight.store.recording.schemas import time_json, vector_json

LEVELS = ("unknown", "debug", "info", "warning", "error", "fatal")
"""foxglove.Log's levels in the order of their numbers."""

MEASURED, SHOWN, JOINTS, EVENTS = "/target/measured", "/target/pose", "/robot/joints", "/events"
"""Channels."""
SCHEMA_OF = {MEASURED: schemas.TARGET_POSE, SHOWN: schemas.POSE, JOINTS: schemas.JOINTS, EVENTS: schemas.LOG}


def pose_contents(pose: TargetPose, t_ns: int) -> dict[str, dict[str, Any]]:
    """Return a pose by channel, with all that is known of it; a whole one also in Foxglove's form."""
    xyz, quat = xyz_quat(pose.pose) if pose.pose is not None else (np.empty(0), np.empty(0))
    found: dict[str, dict[str, Any]] = {}
    found[MEASURED] = {
        "t_s": pose.t_s,
        "status": pose.status.value,
        "parent": pose.parent,
        "spots": list(pose.spots),
        "xyz_m": xyz,
        "quat_xyzw": quat,
        "covariance": pose.covariance if pose.covariance is not None else [],
        "systematic_covariance": pose.systematic_covariance if pose.systematic_covariance is not None else [],
        "origin_known": pose.origin_known,
        "residual_px": pose.residual_px,
        "why": pose.why,
    }
    if pose.status is PoseStatus.OK:
        shown = {"position": vector_json(xyz.tolist()), "orientation": vector_json(quat.tolist())}
        found[SHOWN] = {"timestamp": time_json(t_ns), "frame_id": pose.parent, "pose": shown}
    return found


def joints_content(reading: JointReading) -> dict[str, Any]:
    """Return what the robot says its joints are."""
    return {"t_s": reading.t_s, "sequence": reading.sequence, "source": reading.source, "q": reading.q}


def event_content(t_ns: int, message: str, level: str, name: str) -> dict[str, Any]:
    """Return something that happened; level: one of LEVELS."""
    return {
        "timestamp": time_json(t_ns),
        "level": LEVELS.index(level),
        "message": message,
        "name": name,
        "file": "",
        "line": 0,
    }
