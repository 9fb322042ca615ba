"""Qualisys Track Manager, TSV: bodies (`_6D.tsv`) and markers (3D). Lengths are mm, angles degrees, always.

Keys and values, one a line, then the table. Of a body X, Y, Z, three angles, Residual, Rot[0] .. Rot[8]: the matrix
column by column. The angles turn in the order of their columns: Roll, Pitch, Yaw are R = Rx(roll) Ry(pitch) Rz(yaw),
and Yaw, Pitch, Roll are R = Rz(yaw) Ry(pitch) Rx(roll); the options can set others, so the matrix is taken where it is
there. A lost frame is empty or zeros. Older files have neither frame nor time, name the columns once for all bodies,
and leave a column empty between two (docs.qualisys.com: Motion data, 6DOF data (.tsv); files of 22,245 and 24,578
frames hold both forms in the one and in the other order, equal to 2e-5).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.errors import BadFile, Inconsistent
from armsight.store.interpret.rotations import EulerOrder
from armsight.store.interpret.table_format import TableFormat
from armsight.store.interpret.trackers.grid import (
    Row,
    check_count,
    check_times,
    filled_rows,
    lost_where_zero,
    numbers,
    rows_of,
)
from armsight.store.interpret.trackers.tracks import Track, Tracks
from armsight.units import DEG, MM

ORDERS: Mapping[tuple[str, ...], EulerOrder] = {
    ("roll", "pitch", "yaw"): EulerOrder(axes="xyz"),
    ("yaw", "pitch", "roll"): EulerOrder(axes="zyx"),
}
"""Rotations by the names of their columns, of those seen beside their matrix."""
ORTHOGONAL, AGREE_RAD = 2e-3, 1e-3
"""Of matrices with five decimals, and of angles with five decimals of a degree; near pitch 90 degrees less."""
KEYS = ("NO_OF_FRAMES", "FILE_VERSION")


def is_qtm(head: str) -> bool:
    """Whether a file begins as an export of QTM does, with its keys or without."""
    first = head.lstrip("\ufeff").lstrip().splitlines()[0] if head.strip() else ""
    named = first.lower().split("\t")
    return first.startswith(KEYS) or (named[:2] == ["frame", "time"] and {"roll", "pitch", "yaw"} <= set(named))


def read_qtm(data: bytes, where: str, format_: TableFormat) -> Tracks:
    """Return the bodies or the markers of a TSV of QTM. Raises BadFile, Inconsistent."""
    rows = filled_rows(rows_of(data, where, "\t"))
    at = next((k for k, row in enumerate(rows) if _opens(row)), len(rows))
    said = {row.cells[0]: row.cells[1:] for row in rows[:at]}
    if at == len(rows):
        raise BadFile(f"{where}: keys of QTM without a frame", cure="Export it anew")
    head = [cell.strip().lower() for cell in rows[at].cells]
    named = not _is_number(head[0])
    body = rows[at + named :]
    check_count(body, (said.get("NO_OF_FRAMES") or [""])[0], where)
    if "MARKER_NAMES" in said:
        return _markers(body, [name for name in said["MARKER_NAMES"] if name], said, where)
    if not named:
        raise BadFile(
            f"{where}: no line names the columns",
            consequence="It is open what they are",
            cure="Export column names too",
        )
    lead, names = 2, rows[at].cells
    if head[0] == "x":
        lead, names = 0, _for_each_body(names, [name for name in said.get("BODY_NAMES", []) if name], where)
        head = [cell.strip().lower() for cell in names]
    width = max((k for k, cell in enumerate(head) if cell), default=-1) + 1
    table = numbers(body, width, where)
    _require_gaps(table, head[:width], body, where)
    t_s = _times(table, lead, said, body, where)
    found = [k for k in range(lead, width - 5) if head[k].endswith(" x") and head[k + 1 : k + 3] == ["y", "z"]]
    if not found:
        raise BadFile(f"{where}: no body's X, Y, Z stand in {', '.join(names)[:200]}", cure="Export 6D data of bodies")
    return Tracks(
        where=where,
        how="Qualisys QTM, 6D",
        lines=[row.line for row in body],
        t_s=t_s,
        bodies=tuple(_body(table, head, k, names[k][:-2].strip(), where, format_.order) for k in found),
    )


def _opens(row: Row) -> bool:
    """Whether the table begins here: with its names, or with numbers."""
    return row.cells[0].strip().lower() in ("frame", "x") or _is_number(row.cells[0])


def _for_each_body(names: Sequence[str], bodies: Sequence[str], where: str) -> list[str]:
    """Return the columns of all bodies, an empty one between two, where the file names those of one. Raises BadFile."""
    own = [cell.strip() for cell in names if cell.strip()]
    if not bodies:
        raise BadFile(f"{where}: no BODY_NAMES above the columns", cure="Export it anew")
    return [cell for name in bodies for cell in (f"{name} {own[0]}", *own[1:], "")][:-1]


def _require_gaps(table: Array, head: Sequence[str], body: Sequence[Row], where: str) -> None:
    """Raise BadFile where a number stands in a column without a name."""
    odd = np.argwhere(np.isfinite(table) & np.array([not cell for cell in head]))
    if odd.size:
        raise BadFile(
            f"{where}, line {body[odd[0, 0]].line}: a number in column {odd[0, 1] + 1}, which has no name",
            consequence="Which column is which is open",
            cure="Export it anew",
        )


def _times(table: Array, lead: int, said: Mapping[str, list[str]], body: Sequence[Row], where: str) -> Array | None:
    """Return the times of the rows: from their second column, else by the rate that is said. Raises Inconsistent."""
    said_rate = (said.get("FREQUENCY") or [""])[0]
    rate = float(said_rate) if _is_number(said_rate) else 0.0
    t_s = table[:, 1] if lead else np.arange(len(body)) / rate if rate > 0.0 else None
    if t_s is not None:
        check_times(t_s, body, where)
    return t_s


def _is_number(cell: str) -> bool:
    return cell.lstrip("+-").replace(".", "", 1).replace(",", "", 1).isdecimal()


def _body(table: Array, head: Sequence[str], k: int, name: str, where: str, order: EulerOrder | None) -> Track:
    """Return a body whose X stands in column k: by its matrix, else by its angles."""
    xyz = table[:, k : k + 3]
    angles = tuple(head[k + 3 : k + 6])
    named = ORDERS.get(angles)
    matrix = next((j for j in range(k + 6, len(head) - 8) if head[j] == "rot[0]"), None)
    after = next((j for j in range(k + 3, len(head)) if head[j].endswith(" x")), len(head))
    if matrix is not None and matrix < after:
        if list(head[matrix : matrix + 9]) != [f"rot[{i}]" for i in range(9)]:
            raise BadFile(f"{where}: of {name!r} the columns Rot[0] .. Rot[8] are not all there, in order")
        cells = lost_where_zero(table[:, matrix : matrix + 9])
        there = np.asarray(np.isfinite(cells).all(axis=1) & np.isfinite(xyz).all(axis=1))
        R = np.full((len(table), 3, 3), np.nan)
        R[there] = cells[there].reshape(-1, 3, 3).transpose(0, 2, 1)  # column by column
        _check_rotations(R[there], name, where)
        if named is not None:
            _check_angles(R, table[:, k + 3 : k + 6], named, name, where)
    elif (turn := order or named) is not None and len(angles) == 3:
        values = lost_where_zero(table[:, k : k + 6])
        there = np.asarray(np.isfinite(values).all(axis=1))
        R = np.full((len(table), 3, 3), np.nan)
        R[there] = turn.rotation(DEG * values[there, 3:]).as_matrix()
    else:
        raise BadFile(
            f"{where}: of {name!r} the angles are called {', '.join(angles)}, and there is no matrix",
            consequence="Their axes are open",
            cure="Export the rotation matrix too, or give --euler with their order",
        )
    quat = np.full((len(table), 4), np.nan)
    quat[there] = Rotation.from_matrix(R[there]).as_quat()
    return Track(name=name, xyz_m=np.where(there[:, None], MM * xyz, np.nan), quat_xyzw=quat)


def _check_rotations(R: Array, name: str, where: str) -> None:
    off = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(initial=0.0)
    if off > ORTHOGONAL or (np.linalg.det(R) < 0.0).any():
        raise Inconsistent(f"{where}: Rot[0] .. Rot[8] of {name!r} are no rotations", cure="Export it anew")


def _check_angles(R: Array, degrees: Array, order: EulerOrder, name: str, where: str) -> None:
    """Raise Inconsistent where matrices are not those of the angles beside them: columns are exchanged."""
    there = np.isfinite(R).all(axis=(1, 2)) & np.isfinite(degrees).all(axis=1) & (np.abs(degrees[:, 1]) < 89.0)
    if not there.any():
        return
    apart = (Rotation.from_matrix(R[there]).inv() * order.rotation(DEG * degrees[there])).magnitude()
    if np.median(apart) > AGREE_RAD:
        raise Inconsistent(
            f"{where}: of {name!r} the matrix and the angles differ, by {np.median(apart) / DEG:.3g} deg in most "
            "frames",
            consequence="Columns are exchanged, or the angles are set to other axes",
            cure="Export it with Qualisys' standard angles, or without angles",
        )


def _markers(body: Sequence[Row], names: Sequence[str], said: dict[str, list[str]], where: str) -> Tracks:
    """Return markers: X, Y, Z of each, with frame and time before them or without."""
    wide = max((len(row.cells) for row in body), default=0)
    lead = wide - 3 * len(names) - (wide - 3 * len(names)) % 2  # a mark may end the lines
    if lead not in (0, 2):
        raise BadFile(f"{where}: {len(names)} markers are named, and rows have {wide} cells", cure="Export it anew")
    table = numbers(body, 3 * len(names) + lead, where)
    t_s = _times(table, lead, said, body, where)
    markers = [
        Track(name=name, xyz_m=MM * lost_where_zero(table[:, lead + 3 * k : lead + 3 * k + 3]))
        for k, name in enumerate(names)
    ]
    return Tracks(
        where=where, how="Qualisys QTM, 3D", lines=[row.line for row in body], t_s=t_s, markers=tuple(markers)
    )
