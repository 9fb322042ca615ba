"""What an image file's head says of its size, before a decoder takes the memory for it.

A few kilobytes of PNG unpack to any size, and OpenCV itself stops at a gigapixel only. Heads of other formats than
those of SUFFIXES are not known here, so that none of OpenCV's other decoders ever sees a foreign file.
"""

from __future__ import annotations

import re
import struct

LARGEST_PX = 1 << 27
"""Pixels of an image: 134 million, more than any camera of machine vision has; in colour they take 0.4 GB."""

_PNM = re.compile(rb"P[1-6]\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s+(?:#[^\n]*\n\s*)*(\d{1,9})\s")
_NO_FRAME = (0xC4, 0xC8, 0xCC)
"""Markers of a JPEG between 0xC0 and 0xCF that begin no frame."""
_TIFF_SIZES = {3: "H", 4: "I"}
_WIDTH, _HEIGHT = 256, 257


def said_size(data: bytes) -> tuple[int, int] | None:
    """Return (width, height) in px as the head says, None where it is of no known kind or breaks off."""
    try:
        return _said_size(data)
    except (struct.error, IndexError):
        return None


def _said_size(data: bytes) -> tuple[int, int] | None:
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return _two(">II", data, 16)
    if data.startswith(b"\xff\xd8"):
        return _jpeg(data)
    if data.startswith(b"BM"):
        width, height = _two("<ii", data, 18)
        return abs(width), abs(height)
    if data[:4] in (b"II*\0", b"MM\0*"):
        return _tiff(data, "<" if data[:1] == b"I" else ">")
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return _webp(data)
    found = _PNM.match(data)
    return (int(found[1]), int(found[2])) if found else None


def _two(form: str, data: bytes, at: int) -> tuple[int, int]:
    first, second = struct.unpack_from(form, data, at)
    return first, second


def _jpeg(data: bytes) -> tuple[int, int] | None:
    """Return the size of the first frame: segments are gone through up to it."""
    at = 2
    while data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # filling
            at += 1
        elif 0xC0 <= marker <= 0xCF and marker not in _NO_FRAME:
            height, width = _two(">HH", data, at + 5)
            return width, height
        else:
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]
    return None


def _tiff(data: bytes, order: str) -> tuple[int, int] | None:
    """Return the size that the first directory's tags say."""
    (start,) = struct.unpack_from(order + "I", data, 4)
    (count,) = struct.unpack_from(order + "H", data, start)
    found = {}
    for at in range(start + 2, start + 2 + 12 * count, 12):
        tag, kind = _two(order + "HH", data, at)
        if tag in (_WIDTH, _HEIGHT) and kind in _TIFF_SIZES:
            (found[tag],) = struct.unpack_from(order + _TIFF_SIZES[kind], data, at + 8)
    return (found[_WIDTH], found[_HEIGHT]) if len(found) == 2 else None


def _webp(data: bytes) -> tuple[int, int] | None:
    kind = data[12:16]
    if kind == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    if kind == b"VP8 ":
        width, height = _two("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    return None
