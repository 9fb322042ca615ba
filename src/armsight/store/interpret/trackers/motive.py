"""OptiTrack Motive, CSV of format versions 1.2 to 1.25.

First line: keys and values. Then, a column each: type, name, ID, [parent,] Rotation or Position, and Frame, Time, X, Y,
Z, W. Quaternions are X, Y, Z, W; a blank cell is a lost frame; unit and kind of rotation stand in the first line
(docs.optitrack.com, Data Export: CSV; files of versions 1.21 and 1.25). `Rigid Body Marker` is where a marker should
be, not where it was.
"""

from __future__ import annotations

from itertools import groupby

import numpy as np

from armsight.arrays import Array
from armsight.errors import BadFile, UsageError
from armsight.store.interpret.table_format import TableFormat
from armsight.store.interpret.trackers.grid import check_count, check_times, filled_rows, numbers, rows_of
from armsight.store.interpret.trackers.tracks import Track, Tracks, length_of

BODIES, MARKERS = ("rigid body",), ("marker",)
POSE = [("rotation", axis) for axis in "xyzw"] + [("position", axis) for axis in "xyz"]


def is_motive(head: str) -> bool:
    """Whether a file begins as those of Motive do, with its first line or without."""
    first = head.lstrip("\ufeff").lstrip().splitlines()[0].lower() if head.strip() else ""
    return first.startswith(("format version,", "frame,time (seconds),")) or (
        first.startswith("format version;") or ",rigid body,rigid body" in first
    )


def read_motive(data: bytes, where: str, format_: TableFormat) -> Tracks:
    """Return the rigid bodies and markers of a Motive CSV. Raises BadFile, UsageError, Inconsistent."""
    rows = filled_rows(rows_of(data, where))
    at = next((k for k, row in enumerate(rows) if row.cells[0].lower() == "frame"), 0)
    said = dict(zip(rows[0].cells[::2], rows[0].cells[1::2], strict=False)) if rows else {}
    if at < 4 or "Format Version" not in said:
        raise BadFile(
            f"{where}: a table of Motive without the lines above it, which say unit, bodies and what each column is",
            consequence="Nothing can be read from it",
            cure="Export it anew with the header",
        )
    _check(said, where)
    scale = length_of(said.get("Length Units", ""), where, format_, "the header")
    head = rows[at].cells
    kinds, names, ids, what = (_padded(rows[k].cells, len(head)) for k in (1, 2, 3, at - 1))
    body = rows[at + 1 :]
    check_count(body, said.get("Total Exported Frames", ""), where)
    table = numbers(body, len(head), where)
    check_times(table[:, 1], body, where)
    bodies, markers = [], []
    for (kind, name, _), group in groupby(range(2, len(head)), key=lambda k: (kinds[k].lower(), names[k], ids[k])):
        columns = {(what[k].lower(), head[k].lower()): k for k in group}
        if kind in BODIES:
            bodies.append(_body(table, columns, name, scale, where))
        elif kind in MARKERS and not name.lower().startswith("unlabeled"):
            markers.append(Track(name=name, xyz_m=scale * table[:, _those(columns, POSE[4:], name, where)]))
    return Tracks(
        where=where,
        how=f"OptiTrack Motive, format {said['Format Version']}",
        lines=[row.line for row in body],
        t_s=table[:, 1],
        bodies=tuple(bodies),
        markers=tuple(markers),
    )


def _check(said: dict[str, str], where: str) -> None:
    rotation, space = said.get("Rotation Type", "Quaternion"), said.get("Coordinate Space", "Global")
    if rotation.lower() != "quaternion":
        raise UsageError(
            f"{where}: rotations are written as {rotation!r}",
            consequence="The file does not say whether the axes rotate with the angles",
            cure="Export it with Rotation Type: Quaternion",
        )
    if space.lower() != "global":
        raise UsageError(
            f"{where}: coordinates are {space!r}: each in the axes of another body",
            consequence="They are not where the bodies are",
            cure="Export it with Coordinate Space: Global",
        )


def _padded(cells: list[str], width: int) -> list[str]:
    return [*cells, *[""] * (width - len(cells))]


def _those(columns: dict[tuple[str, str], int], wanted: list[tuple[str, str]], name: str, where: str) -> list[int]:
    missing = [f"{what} {axis.upper()}" for what, axis in wanted if (what, axis) not in columns]
    if missing:
        raise BadFile(f"{where}: of {name!r} there is no {', '.join(missing)}", cure="Export it anew, with all columns")
    return [columns[key] for key in wanted]


def _body(table: Array, columns: dict[tuple[str, str], int], name: str, scale: float, where: str) -> Track:
    values = table[:, _those(columns, POSE, name, where)]
    values = np.where(np.asarray(np.isfinite(values).all(axis=1))[:, None], values, np.nan)
    return Track(name=name, xyz_m=scale * values[:, 4:], quat_xyzw=values[:, :4])
