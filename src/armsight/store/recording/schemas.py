"""What a recording's channels carry, live viewers alike: Foxglove's schemas where one exists, ours elsewhere.

Images are in Protocol Buffers, all else in JSON (docs/decisions/0010-recording-encoding.md). Of Protocol Buffers
here is what two Foxglove images need: their heads written and read back, their schema. The pixels stand last and are
never copied: a message is its head followed by the image's own memory.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from armsight.geometry import xyz_quat
from armsight.records import JointReading, PoseStatus, TargetPose

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
"""Wire types."""

DOUBLE, INT64, INT32, STRING, MESSAGE, BYTES_FIELD, FIXED32_FIELD = 1, 3, 5, 9, 11, 12, 7
"""Types of a field in descriptor.proto."""

Value = int | memoryview
NS = 1_000_000_000
MAX_VARINT = 10


def varint(value: int) -> bytes:
    """Return a number >= 0 in base 128, lowest digits first."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def field(number: int, value: bytes | str) -> bytes:
    """Return a field of text, bytes or an embedded message."""
    data = value.encode("utf-8") if isinstance(value, str) else value
    return varint(number << 3 | BYTES) + varint(len(data)) + data


def number_field(number: int, value: int) -> bytes:
    """Return a field of a whole number >= 0."""
    return varint(number << 3 | VARINT) + varint(value)


def fixed32(number: int, value: int) -> bytes:
    """Return a field of four bytes."""
    return varint(number << 3 | FIXED32) + struct.pack("<I", value)


def fields(data: memoryview) -> dict[int, Value]:
    """Return the last value of each field of a message by number. Raises ValueError where it is none."""
    out: dict[int, Value] = {}
    at = 0
    while at < len(data):
        key, at = _read_varint(data, at)
        wire = key & 7
        if wire == VARINT:
            out[key >> 3], at = _read_varint(data, at)
            continue
        if wire == BYTES:
            size, at = _read_varint(data, at)
        elif wire in (FIXED32, FIXED64):
            size = 4 if wire == FIXED32 else 8
        else:
            raise ValueError(f"wire type {wire} at byte {at}")
        if at + size > len(data):
            raise ValueError(f"a field of {size} bytes at byte {at} of {len(data)}")
        part = data[at : at + size]
        out[key >> 3] = part if wire == BYTES else int.from_bytes(part, "little")
        at += size
    return out


def _read_varint(data: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(MAX_VARINT):
        if at >= len(data):
            raise ValueError("cut off within a number")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << 7 * shift
        if byte < 0x80:
            return value, at
    raise ValueError(f"a number of more than {MAX_VARINT} bytes at byte {at}")


def stamp(t_ns: int) -> bytes:
    """Return google.protobuf.Timestamp of nanoseconds >= 0."""
    return number_field(1, t_ns // NS) + number_field(2, t_ns % NS)


def raw_image_head(t_ns: int, frame_id: str, shape: tuple[int, ...], encoding: str) -> bytes:
    """Return foxglove.RawImage up to its pixels, which follow row by row; shape as numpy gives it."""
    height, width = shape[:2]
    step = width * (shape[2] if len(shape) == 3 else 1)
    head = field(1, stamp(t_ns)) + fixed32(2, width) + fixed32(3, height) + field(4, encoding) + fixed32(5, step)
    return head + field(7, frame_id) + varint(6 << 3 | BYTES) + varint(step * height)


def compressed_image_head(t_ns: int, frame_id: str, kind: str, size: int) -> bytes:
    """Return foxglove.CompressedImage up to its data of size bytes; kind: png or jpeg."""
    head = field(1, stamp(t_ns)) + field(3, kind) + field(4, frame_id)
    return head + varint(2 << 3 | BYTES) + varint(size)


def _file(name: str, package: str, message: str, members: Iterable[tuple[str, int, int, str]], needs: str) -> bytes:
    """Return a FileDescriptorProto of one message; members: (name, number, type, type's name)."""
    body = field(1, message)
    for label, number, kind, type_name in members:
        member = field(1, label) + number_field(3, number) + number_field(4, 1) + number_field(5, kind)
        body += field(2, member + (field(6, type_name) if type_name else b""))
    out = field(1, name) + field(2, package) + (field(3, needs) if needs else b"")
    return out + field(4, body) + field(12, "proto3")


_TIME_FILE = "google/protobuf/timestamp.proto"
_TIME_FIELD = ("timestamp", 1, MESSAGE, ".google.protobuf.Timestamp")
_MEMBERS: Mapping[str, tuple[tuple[str, int, int, str], ...]] = {
    "RawImage": (
        _TIME_FIELD,
        ("width", 2, FIXED32_FIELD, ""),
        ("height", 3, FIXED32_FIELD, ""),
        ("encoding", 4, STRING, ""),
        ("step", 5, FIXED32_FIELD, ""),
        ("data", 6, BYTES_FIELD, ""),
        ("frame_id", 7, STRING, ""),
    ),
    "CompressedImage": (
        _TIME_FIELD,
        ("data", 2, BYTES_FIELD, ""),
        ("format", 3, STRING, ""),
        ("frame_id", 4, STRING, ""),
    ),
}


def descriptor_set(message: str) -> bytes:
    """Return the FileDescriptorSet of foxglove.RawImage or foxglove.CompressedImage, with what it needs."""
    time = _file(_TIME_FILE, "google.protobuf", "Timestamp", [("seconds", 1, INT64, ""), ("nanos", 2, INT32, "")], "")
    own = _file(f"foxglove/{message}.proto", "foxglove", message, _MEMBERS[message], _TIME_FILE)
    return field(1, time) + field(1, own)


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
JOINT_READING = "armsight.JointReading"
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
    JOINT_READING: _object(t_s=_NUMBER, sequence=_INTEGER, source=_STRING, q=_list(_NUMBER)),
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


LEVELS = ("unknown", "debug", "info", "warning", "error", "fatal")
"""foxglove.Log's levels in the order of their numbers."""

MEASURED, SHOWN, JOINTS, EVENTS = "/target/measured", "/target/pose", "/robot/joints", "/events"
"""Channels."""
SCHEMA_OF = {MEASURED: TARGET_POSE, SHOWN: POSE, JOINTS: JOINT_READING, EVENTS: LOG}


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
