"""What a recording's channels carry: Foxglove's schemas where one exists, ours elsewhere; images in Protocol Buffers,
all else in JSON (docs/decisions/0010-recording-encoding.md)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from armsight.store.recording.protobuf import NS, descriptor_set

RAW_IMAGE = "foxglove.RawImage"
COMPRESSED_IMAGE = "foxglove.CompressedImage"
CALIBRATION = "foxglove.CameraCalibration"
TRANSFORM = "foxglove.FrameTransform"
POSE = "foxglove.PoseInFrame"
ANNOTATIONS = "foxglove.ImageAnnotations"
LOG = "foxglove.Log"
TARGET_POSE = "armsight.TargetPose"
SPOTS = "armsight.Spots"
POINTS = "armsight.Points"
JOINTS = "armsight.JointReading"
COMMAND = "armsight.Command"
EXPOSURE = "armsight.Exposure"

Json = dict[str, Any]

_NUMBER: Json = {"type": "number"}
_INTEGER: Json = {"type": "integer"}
_STRING: Json = {"type": "string"}


def _list(items: Json) -> Json:
    return {"type": "array", "items": items}


def _object(title: str = "", **members: Json) -> Json:
    return {**({"title": title} if title else {}), "type": "object", "properties": members}


_TIME = _object(sec=_INTEGER, nsec=_INTEGER)
_VECTOR = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_COLOUR = _object(r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_MARKS = _object(
    timestamp=_TIME,
    type=_INTEGER,
    points=_list(_object(x=_NUMBER, y=_NUMBER)),
    outline_color=_COLOUR,
    outline_colors=_list(_COLOUR),
    fill_color=_COLOUR,
    thickness=_NUMBER,
)

_MESSAGES: Mapping[str, Json] = {
    CALIBRATION: _object(
        timestamp=_TIME,
        frame_id=_STRING,
        width=_INTEGER,
        height=_INTEGER,
        distortion_model=_STRING,
        D=_list(_NUMBER),
        K=_list(_NUMBER),
        R=_list(_NUMBER),
        P=_list(_NUMBER),
    ),
    TRANSFORM: _object(
        timestamp=_TIME, parent_frame_id=_STRING, child_frame_id=_STRING, translation=_VECTOR, rotation=_QUATERNION
    ),
    POSE: _object(timestamp=_TIME, frame_id=_STRING, pose=_object(position=_VECTOR, orientation=_QUATERNION)),
    ANNOTATIONS: _object(circles=_list(_object()), points=_list(_MARKS), texts=_list(_object())),
    LOG: _object(timestamp=_TIME, level=_INTEGER, message=_STRING, name=_STRING, file=_STRING, line=_INTEGER),
    TARGET_POSE: _object(
        t_s=_NUMBER,
        status=_STRING,
        parent=_STRING,
        spots=_list(_STRING),
        xyz_m=_list(_NUMBER),
        quat_xyzw=_list(_NUMBER),
        covariance=_list(_list(_NUMBER)),
        systematic_covariance=_list(_list(_NUMBER)),
        origin_known={"type": "boolean"},
        residual_px=_list(_NUMBER),
        why=_STRING,
    ),
    SPOTS: _object(
        t_s=_NUMBER,
        camera=_STRING,
        names=_list(_STRING),
        uv_px=_list(_list(_NUMBER)),
        covariance_px2=_list(_list(_list(_NUMBER))),
        peak=_list(_NUMBER),
        size_px=_list(_NUMBER),
        model=_list(_STRING),
        rejected=_list({"type": "array"}),
    ),
    POINTS: _object(
        t_s=_NUMBER, names=_list(_STRING), xyz_m=_list(_list(_NUMBER)), covariance_m2=_list(_list(_list(_NUMBER)))
    ),
    JOINTS: _object(t_s=_NUMBER, sequence=_INTEGER, source=_STRING, q=_list(_NUMBER)),
    COMMAND: _object(t_s=_NUMBER, kind=_STRING, values=_object()),
    EXPOSURE: _object(t_s=_NUMBER, exposure_s=_NUMBER),
}


def schema_of(name: str) -> tuple[str, str, bytes]:
    """Return (message encoding, schema encoding, schema) of a channel that carries this."""
    if name in (RAW_IMAGE, COMPRESSED_IMAGE):
        return "protobuf", "protobuf", descriptor_set(name.removeprefix("foxglove."))
    text = json.dumps({"$schema": "http://json-schema.org/draft-07/schema#", "title": name, **_MESSAGES[name]})
    return "json", "jsonschema", text.encode("utf-8")


def time_json(t_ns: int) -> dict[str, int]:
    """Return a time as Foxglove's JSON has it."""
    return {"sec": t_ns // NS, "nsec": t_ns % NS}


def vector_json(xyz: list[float]) -> dict[str, float]:
    """Return {x, y, z} or {x, y, z, w}."""
    return dict(zip("xyzw", xyz, strict=False))
