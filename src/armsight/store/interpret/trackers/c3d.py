"""C3D: markers of any motion capture program, in binary (c3d.org, The C3D File Format User Guide).

Blocks of 512 bytes; numbers of an Intel, DEC or MIPS processor; points as integers with a scale or, where the scale is
negative, as floating point. Of the fourth number of a point the lower byte is its residual in units of the scale, the
upper one the cameras that saw it; below zero the point is lost, whatever stands before it. Read here: of two public
readers one takes the cameras for the residual, and one gives a lost point as its file has it, where it was last.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from armsight.arrays import Array
from armsight.errors import BadFile, Inconsistent
from armsight.store.interpret.table_format import TableFormat
from armsight.store.interpret.trackers.tracks import Track, Tracks, length_of

BLOCK, KEY = 512, 0x50
INTEL, DEC, MIPS = 84, 85, 86
MOST_POINTS = 10_000


def is_c3d(data: bytes) -> bool:
    """Whether bytes begin as a C3D does."""
    return len(data) > 2 and data[1] == KEY and 0 < data[0] < 128 and b"\x00" in data[:BLOCK]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Numbers:
    """How a processor writes numbers."""

    order: str
    dec: bool

    def integers(self, data: bytes, *, signed: bool = True) -> Array:
        return np.frombuffer(data, f"{self.order}{'i' if signed else 'u'}2").astype(float)

    def floats(self, data: bytes) -> Array:
        if not self.dec:
            return np.frombuffer(data, f"{self.order}f4").astype(float)
        halves = np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1]  # the two halves exchanged, and four times as large
        return np.ascontiguousarray(halves).view("<f4").ravel().astype(float) / 4.0


def read_c3d(data: bytes, where: str, format_: TableFormat) -> Tracks:
    """Return the markers of a C3D. Raises BadFile, UsageError, Inconsistent."""
    try:
        numbers, groups = _parameters(data)
        return _tracks(data, where, format_, numbers, groups)
    except (IndexError, KeyError, struct.error, ValueError, OverflowError) as error:
        raise BadFile(
            f"{where}: a C3D whose parameters cannot be read ({' '.join(str(error).split())[:80]})",
            cure="It may be cut off or damaged: export it anew",
        ) from error


def _parameters(data: bytes) -> tuple[_Numbers, Mapping[str, Any]]:
    """Return the numbers' form, and parameters by 'GROUP:NAME': arrays, or lists of words."""
    start = BLOCK * (data[0] - 1)
    processor = data[start + 3]
    if processor not in (INTEL, DEC, MIPS):
        raise ValueError(f"processor {processor}")
    numbers = _Numbers(order=">" if processor == MIPS else "<", dec=processor == DEC)
    names: dict[int, str] = {}
    found: list[tuple[int, str, Any]] = []
    at = start + 4
    while True:
        length, group = struct.unpack_from("bb", data, at)
        if length == 0 or group == 0:
            break
        name = data[at + 2 : at + 2 + abs(length)].decode("latin-1").strip().upper()
        here = at + 2 + abs(length)
        (step,) = struct.unpack_from(f"{numbers.order}H", data, here)
        if group < 0:
            names[-group] = name
        else:
            found.append((group, name, _value(data, here + 2, numbers)))
        if step == 0:
            break
        at = here + step
    return numbers, {f"{names.get(group, '')}:{name}": value for group, name, value in found}


def _value(data: bytes, at: int, numbers: _Numbers) -> Any:
    kind, n = struct.unpack_from("bB", data, at)
    shape = list(data[at + 2 : at + 2 + n])
    size = int(np.prod(shape)) if shape else 1
    raw = data[at + 2 + n : at + 2 + n + size * abs(kind)]
    if len(raw) < size * abs(kind):
        raise ValueError("a parameter is cut off")
    if kind == -1:
        wide = shape[0] if shape else 1
        words = [raw[k : k + wide].decode("utf-8", errors="replace") for k in range(0, size, wide)] if wide else []
        return [word.strip(" \x00") for word in words]
    if kind == 1:
        return np.frombuffer(raw, np.uint8).astype(float)
    return numbers.integers(raw, signed=False) if kind == 2 else numbers.floats(raw)


def _tracks(data: bytes, where: str, format_: TableFormat, numbers: _Numbers, said: Mapping[str, Any]) -> Tracks:
    head = numbers.integers(data[:24], signed=False)
    n_points, n_analog = int(said["POINT:USED"][0]), int(head[2])
    if not 0 < n_points <= MOST_POINTS:
        raise BadFile(f"{where}: a C3D with {n_points} markers", cure="Export it with the markers")
    scale, rate = float(said["POINT:SCALE"][0]), float(said["POINT:RATE"][0])
    first, n_frames = _frames(said, head)
    start = BLOCK * (int(said["POINT:DATA_START"][0]) - 1)
    wide = 2 if scale > 0.0 else 4
    per_frame = (4 * n_points + n_analog) * wide
    held = data[start : start + n_frames * per_frame]
    if len(held) < n_frames * per_frame:
        raise Inconsistent(
            f"{where}: the header says {n_frames} frames, {len(held) // per_frame} are there",
            consequence="A part of the recording is missing",
            cure="It may be cut off: export it anew",
        )
    values = (numbers.integers(held) if wide == 2 else numbers.floats(held)).reshape(n_frames, -1)
    points = values[:, : 4 * n_points].reshape(n_frames, n_points, 4)
    xyz = points[..., :3] * (scale if wide == 2 else 1.0)
    lost = (points[..., 3] < 0.0) | ~np.isfinite(points).all(axis=2) | (xyz == 0.0).all(axis=2)
    unit = length_of((said.get("POINT:UNITS") or [""])[0], where, format_, "POINT:UNITS")
    xyz = np.where(lost[..., None], np.nan, unit * xyz)
    if not rate > 0.0:
        raise BadFile(f"{where}: a C3D of {rate:g} frames a second")
    labels = [name for key in ("", *range(2, 100)) for name in said.get(f"POINT:LABELS{key}", [])]
    if len(labels) < n_points:
        raise BadFile(f"{where}: {n_points} markers, {len(labels)} names", cure="Export it anew")
    markers = [
        Track(name=name, xyz_m=xyz[:, k]) for k, name in enumerate(labels[:n_points]) if not name.startswith("*")
    ]
    return Tracks(
        where=where,
        how="C3D",
        lines=range(first, first + n_frames),
        t_s=(first - 1 + np.arange(n_frames)) / rate,
        markers=tuple(markers),
    )


def _frames(said: Mapping[str, Any], head: Array) -> tuple[int, int]:
    """Return the first frame's number and how many there are, beyond 65535 by the parameters of TRIAL."""
    ends = [said.get(f"TRIAL:ACTUAL_{end}_FIELD") for end in ("START", "END")]
    if all(end is not None and len(end) >= 2 for end in ends):
        first, last = (int(end[0]) + 65536 * int(end[1]) for end in ends if end is not None)
    else:
        first, last = int(head[3]), int(head[4])
    if last < first:
        raise ValueError(f"frames {first} to {last}")
    return first, last - first + 1
