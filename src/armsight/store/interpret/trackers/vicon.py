"""Vicon Nexus and Tracker, CSV: sections of Segments or Objects (bodies) and Trajectories (markers).

A section: its name; frames a second; bodies or markers; Frame, Sub Frame, RX, RY, RZ[, RW], TX, TY, TZ or X, Y, Z;
units. Without RW the three are a rotation vector (`Helical`, what Tracker sets at first) or Euler angles, which the
file does not say: a length beyond 180 degrees is no rotation vector, an RY beyond 90 degrees no Euler angle x, y, z
(AG6GR/Vicon_CSV, README, for Tracker 3.5; trajectories by a file of Nexus in pyomeca). A lost frame is empty, or zeros.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.errors import Ambiguous, BadFile, Inconsistent
from armsight.store.interpret.rotations import ROTVEC, EulerOrder
from armsight.store.interpret.table_format import UNITS, TableFormat
from armsight.store.interpret.trackers.grid import Row, check_times, lost_where_zero, numbers, rows_of
from armsight.store.interpret.trackers.tracks import Track, Tracks, length_of

BODIES, MARKERS = ("segments", "objects"), ("trajectories",)
SECTIONS = (*BODIES, *MARKERS, "joints", "model outputs", "devices", "events")
HALF_ROTATION, QUARTER = np.pi * 1.001, np.pi / 2 * 1.001
FIRST = "frame", "sub frame"


def is_vicon(head: str) -> bool:
    """Whether a file begins with a section of Vicon's, or with its table."""
    first = head.lstrip("\ufeff").lstrip().splitlines()[0].lower() if head.strip() else ""
    words = [word.strip() for word in first.replace(";", ",").replace("\t", ",").split(",")]
    return (words[0] in SECTIONS and not any(words[1:])) or tuple(words[:2]) == FIRST


def read_vicon(data: bytes, where: str, format_: TableFormat) -> Tracks:
    """Return the bodies and markers of a Vicon CSV. Raises BadFile, UsageError, Inconsistent, Ambiguous."""
    rows = rows_of(data, where, "Sub Frame")
    if rows and tuple(cell.lower() for cell in rows[0].cells[:2]) == FIRST:
        raise BadFile(
            f"{where}: a table of Vicon without the lines above it, which say bodies and frames a second",
            consequence="Nothing can be read from it",
            cure="Export it anew, and leave the file as it is",
        )
    bodies: list[Track] = []
    markers: list[Track] = []
    frames: tuple[list[int], Array] | None = None
    for name, section in _sections(rows):
        if name not in (*BODIES, *MARKERS):
            continue
        lines, t_s, tracks = _section(section, name in BODIES, where, format_)
        if frames is not None and (len(frames[1]) != len(t_s) or np.abs(frames[1] - t_s).max() > 1e-9):
            raise Inconsistent(f"{where}: its sections have other frames each", cure="Export one of them")
        frames = lines, t_s
        (bodies if name in BODIES else markers).extend(tracks)
    if frames is None:
        raise BadFile(
            f"{where}: no section Segments, Objects or Trajectories with a frame", cure="Export these, or one of them"
        )
    return Tracks(
        where=where, how="Vicon CSV", lines=frames[0], t_s=frames[1], bodies=tuple(bodies), markers=tuple(markers)
    )


def _sections(rows: Sequence[Row]) -> Iterator[tuple[str, list[Row]]]:
    """Yield each section's name and rows, as far as its first empty line behind its table."""
    starts = [k for k, row in enumerate(rows) if row.cells[:1] and _lone(row) in SECTIONS]
    for k, end in zip(starts, [*starts[1:], len(rows)], strict=True):
        inside = [row for row in rows[k + 1 : end] if any(row.cells)]
        if inside:
            yield _lone(rows[k]), inside


def _lone(row: Row) -> str:
    return row.cells[0].lower() if not any(row.cells[1:]) else ""


def _section(
    rows: Sequence[Row], bodies: bool, where: str, format_: TableFormat
) -> tuple[list[int], Array, list[Track]]:
    if len(rows) < 5 or not _lone(rows[0]).replace(".", "", 1).isdecimal():
        raise BadFile(
            f"{where}: a section without frames a second, names, columns, units and a frame", cure="Export anew"
        )
    rate, names, columns, units, body = float(rows[0].cells[0]), rows[1].cells, rows[2].cells, rows[3].cells, rows[4:]
    if rate <= 0.0 or tuple(cell.lower() for cell in columns[:2]) != FIRST:
        raise BadFile(f"{where}, line {rows[2].line}: not Frame, Sub Frame, ... at some frames a second")
    width = max((k for k, cell in enumerate(columns) if cell), default=-1) + 1
    table = numbers(body, width, where)
    t_s = (table[:, 0] - 1.0) / rate
    check_times(t_s, body, where)
    starts = [k for k in range(2, min(len(names), width)) if names[k]]
    found = []
    for k, end in zip(starts, [*starts[1:], width], strict=True):
        there = {columns[j].lower(): j for j in range(k, end)}
        name = names[k].removeprefix("Global Angle ").strip()
        take = _Block(name=name, there=there, units=[*units, *[""] * width], table=table, where=where, format_=format_)
        found.append(take.body() if bodies else Track(name=name, xyz_m=take.lengths("x", "y", "z")))
    return [row.line for row in body], t_s, found


class _Block:
    """The columns of one body or marker."""

    def __init__(
        self, *, name: str, there: dict[str, int], units: Sequence[str], table: Array, where: str, format_: TableFormat
    ) -> None:
        subject, _, segment = name.partition(":")
        self.name = subject if subject == segment else name
        self.there, self.units, self.table, self.where, self.format = there, units, table, where, format_

    def _columns(self, names: Sequence[str]) -> list[int]:
        missing = [name.upper() for name in names if name not in self.there]
        if missing:
            raise BadFile(f"{self.where}: of {self.name!r} there is no {', '.join(missing)}", cure="Export it anew")
        columns = [self.there[name] for name in names]
        if len({self.units[k] for k in columns if names[0] != "rx"}) > 1:
            raise Inconsistent(f"{self.where}: {self.name!r} has X, Y and Z in different units")
        return columns

    def lengths(self, *names: str) -> Array:
        """Return columns of lengths (n, 3) in m."""
        columns = self._columns(names)
        scale = length_of(self.units[columns[0]], self.where, self.format, f"of {self.name!r} the line of units")
        return scale * lost_where_zero(self.table[:, columns])

    def body(self) -> Track:
        """Return a body with its rotations."""
        xyz = self.lengths("tx", "ty", "tz")
        turned = ("rx", "ry", "rz", "rw") if "rw" in self.there else ("rx", "ry", "rz")
        values = self.table[:, self._columns(turned)]
        there = np.asarray(np.isfinite(values).all(axis=1) & np.isfinite(xyz).all(axis=1))
        quat = np.full((len(xyz), 4), np.nan)
        if len(turned) == 4:
            quat[there] = values[there]
        elif there.any():
            quat[there] = self._rotation(values[there]).as_quat()
        return Track(name=self.name, xyz_m=np.where(there[:, None], xyz, np.nan), quat_xyzw=quat)

    def _rotation(self, values: Array) -> Rotation:
        unit = self.units[self.there["rx"]].strip().lower()
        quantity, scale = UNITS.get(unit, ("", 0.0))
        if quantity != "angle":
            raise Inconsistent(f"{self.where}: {self.name!r} has angles in {unit or 'no unit'}", cure="Export it anew")
        angles = scale * values
        order = self.format.order
        if order is not None:
            return order.rotation(angles[:, order.sequence("xyz")])
        euler = np.linalg.norm(angles, axis=1).max() > HALF_ROTATION
        vector = np.abs(angles[:, 1]).max() > QUARTER
        if vector and not euler:
            return EulerOrder(axes=ROTVEC).rotation(angles)
        raise Ambiguous(
            f"{self.where}: RX, RY, RZ of {self.name!r} "
            + ("are Euler angles" if euler else "may be a rotation vector (Helical) or Euler angles"),
            consequence="The file does not say in which order" if euler else "The file does not say which",
            cure="See the export's setting Angle: --euler rotvec for Helical, --euler xyz or as it is for others",
        )
