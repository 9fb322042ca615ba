"""TRC, Track Row Column: markers, as Motive, Cortex, Nexus and OpenSim write it, by tabs; by commas from a spreadsheet.

Line 1 the axes (X/Y/Z), 2 and 3 keys and values with Units, 4 Frame#, Time and markers, 5 X1, Y1, Z1, ..., then frames;
a lost marker is blank (OpenSim's documentation, Marker (.trc) Files; a file in pyomeca). Line 1 may be apart by blanks
(opensim-models, Rajagopal).
"""

from __future__ import annotations

from armsight.errors import BadFile
from armsight.store.interpret.table_format import TableFormat
from armsight.store.interpret.trackers.grid import (
    check_count,
    check_times,
    filled_rows,
    lost_where_zero,
    numbers,
    rows_of,
)
from armsight.store.interpret.trackers.tracks import Track, Tracks, length_of


def is_trc(head: str) -> bool:
    """Whether a file begins as a TRC does."""
    return head.lstrip("\ufeff").lstrip().startswith("PathFileType")


def read_trc(data: bytes, where: str, format_: TableFormat) -> Tracks:
    """Return the markers of a TRC. Raises BadFile, UsageError, Inconsistent."""
    rows = filled_rows(rows_of(data, where, "Frame#"))
    if len(rows) < 6 or rows[3].cells[0].lower() != "frame#" or "(X/Y/Z)" not in " ".join(rows[0].cells):
        raise BadFile(
            f"{where}: no TRC with (X/Y/Z), keys, values, Frame#, Time, markers and a frame", cure="Export anew"
        )
    said = dict(zip(rows[1].cells, rows[2].cells, strict=False))
    scale = length_of(said.get("Units", ""), where, format_, "the header")
    names = [name for name in rows[3].cells[2:] if name]
    axes = [cell for cell in rows[4].cells if cell]
    if axes != [f"{axis}{k}" for k in range(1, len(names) + 1) for axis in "XYZ"]:
        raise BadFile(
            f"{where}, line {rows[4].line}: {len(names)} markers, and not X1, Y1, Z1, X2, ... of as many",
            cure="Export it anew",
        )
    body = rows[5:]
    check_count(body, said.get("NumFrames", ""), where)
    check_count(names, said.get("NumMarkers", ""), where, "markers")
    table = numbers(body, 2 + 3 * len(names), where)
    check_times(table[:, 1], body, where)
    return Tracks(
        where=where,
        how="TRC",
        lines=[row.line for row in body],
        t_s=table[:, 1],
        markers=tuple(
            Track(name=name, xyz_m=scale * lost_where_zero(table[:, 2 + 3 * k : 5 + 3 * k]))
            for k, name in enumerate(names)
        ),
    )
