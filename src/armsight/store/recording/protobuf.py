"""The little of Protocol Buffers that two Foxglove images need: writing their heads, reading them back, their schema.

The pixels stand last and are never copied: a message is its head followed by the image's own memory.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping

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
_TIME = ("timestamp", 1, MESSAGE, ".google.protobuf.Timestamp")
_MEMBERS: Mapping[str, tuple[tuple[str, int, int, str], ...]] = {
    "RawImage": (
        _TIME,
        ("width", 2, FIXED32_FIELD, ""),
        ("height", 3, FIXED32_FIELD, ""),
        ("encoding", 4, STRING, ""),
        ("step", 5, FIXED32_FIELD, ""),
        ("data", 6, BYTES_FIELD, ""),
        ("frame_id", 7, STRING, ""),
    ),
    "CompressedImage": (
        _TIME,
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
