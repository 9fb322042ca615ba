"""Just enough of protobuf's wire format by hand: a twin shares no protocol code with the driver it tests.

Wire types: 0 varint, 1 eight bytes, 2 length and bytes, 5 four bytes (protobuf.dev, "Encoding").
"""

from __future__ import annotations

import struct

VARINT, EIGHT, BYTES, FOUR = 0, 1, 2, 5


class BadWire(ValueError):
    """Bytes that are no protobuf message."""


def varint(value: int) -> bytes:
    """Return a number >= 0, seven bits to a byte, the lowest first."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def whole(number: int, value: int) -> bytes:
    """Return field `number` with a number >= 0."""
    return varint(number << 3 | VARINT) + varint(value)


def real(number: int, value: float) -> bytes:
    """Return field `number` with a double."""
    return varint(number << 3 | EIGHT) + struct.pack("<d", value)


def message(number: int, *parts: bytes) -> bytes:
    """Return field `number` with a message of parts."""
    data = b"".join(parts)
    return varint(number << 3 | BYTES) + varint(len(data)) + data


def fields(data: bytes) -> dict[int, list[int | float | bytes]]:
    """Return the values of a message by field number: whole numbers, doubles, or bytes. Raises BadWire."""
    found: dict[int, list[int | float | bytes]] = {}
    offset = 0
    while offset < len(data):
        key, offset = _varint(data, offset)
        kind = key & 7
        value: int | float | bytes
        if kind == VARINT:
            value, offset = _varint(data, offset)
        elif kind == EIGHT:
            value, offset = struct.unpack("<d", _cut(data, offset, 8))[0], offset + 8
        elif kind == BYTES:
            length, offset = _varint(data, offset)
            value, offset = _cut(data, offset, length), offset + length
        elif kind == FOUR:
            value, offset = _cut(data, offset, 4), offset + 4
        else:
            raise BadWire(f"wire type {kind}")
        found.setdefault(key >> 3, []).append(value)
    return found


def doubles(values: list[int | float | bytes]) -> list[float]:
    """Return the numbers of a repeated double, packed or one by one. Raises BadWire."""
    numbers: list[float] = []
    for value in values:
        if isinstance(value, float):
            numbers.append(value)
        elif isinstance(value, bytes) and len(value) % 8 == 0:
            numbers += struct.unpack(f"<{len(value) // 8}d", value)
        else:
            raise BadWire("a double is something else")
    return numbers


def _varint(data: bytes, offset: int) -> tuple[int, int]:
    value = 0
    for i in range(10):
        if offset + i >= len(data):
            break
        value |= (data[offset + i] & 0x7F) << (7 * i)
        if data[offset + i] < 0x80:
            return value, offset + i + 1
    raise BadWire("a number does not end")


def _cut(data: bytes, offset: int, length: int) -> bytes:
    if offset + length > len(data):
        raise BadWire("a field is longer than its message")
    return data[offset : offset + length]
