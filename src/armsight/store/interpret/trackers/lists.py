"""SpatialAnalyzer's lists of points, and libfranka's logs.

SpatialAnalyzer, ASCII export: [collection] [group] point, X, Y, Z and what else was asked for, by commas or blanks, in
the working frame; remarks begin with //; no unit unless a remark says it (SA User's Manual, Exporting ASCII Formatted
Points). libfranka's logToCSV: `time` is whole milliseconds (src/log.cpp: time.toMSec()), the rest m and rad.
"""

from __future__ import annotations

import re
from dataclasses import replace

from armsight.errors import Ambiguous, BadFile, UsageError
from armsight.store.interpret.raw import RawTable, parse_text
from armsight.store.interpret.table_format import UNITS, TableFormat
from armsight.store.interpret.trackers.grid import CUT, Row, numbers
from armsight.store.interpret.trackers.tracks import Track, Tracks, length_of
from armsight.store.tables import decoded, is_number

REMARK = "//"
POLAR = frozenset(("theta", "phi", "cylindrical", "cylindric", "spherical"))
_ROW = re.compile(r"\s*[A-Za-z_][^,;\t]*(?:[,\s]+\S+){3,}\s*")
_WORD = re.compile(r"[A-Za-z]+")


def is_points(head: str) -> bool:
    """Whether text is a list of points by name: every line of the first few names one, and has X, Y, Z behind it."""
    lines = [line for line in head.lstrip("\ufeff").splitlines()[:-1] if line.strip()]
    rows = [line for line in lines[:20] if not line.lstrip().startswith(REMARK)]
    return bool(rows) and all(_ROW.fullmatch(line) and 0 < _names(_cells(line)) <= 3 for line in rows)


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.split(",")] if "," in line else line.split()


def _names(cells: list[str]) -> int:
    """Return how many names stand before X, Y, Z; 0 where that is open: a point's name may be a number."""
    words = next((k for k, cell in enumerate(cells) if is_number(cell)), len(cells))
    if words == 3 and len(cells) >= 6 and all(map(is_number, cells[3:6])):
        return 3
    return len(cells) - 3 if len(cells) > 3 and words <= len(cells) - 3 <= 3 and all(map(is_number, cells[-3:])) else 0


def read_points(data: bytes, where: str, format_: TableFormat) -> Tracks:
    """Return a group of a list of points, in the file's order, as one marker. Raises BadFile, UsageError, Ambiguous."""
    lines = [(i, line) for i, line in enumerate(decoded(data, where).splitlines(), 1) if line.strip()]
    remarks = " ".join(line for _, line in lines if line.lstrip().startswith(REMARK))
    words = [word.lower() for word in _WORD.findall(remarks)]
    if not POLAR.isdisjoint(words):
        raise UsageError(f"{where}: its coordinates are not X, Y, Z", cure="Export it in Cartesian coordinates")
    lengths = [word for word in words if UNITS.get(word, ("",))[0] == "length" and word != "in"]
    scale = length_of(lengths[0] if lengths else "", where, format_, "the list of points")
    rows = [Row(line=i, cells=_cells(line)) for i, line in lines if not line.lstrip().startswith(REMARK)]
    lead, wide = _names(rows[0].cells), len(rows[0].cells)
    odd = next((row for row in rows if len(row.cells) != wide or _names(row.cells) != lead), None)
    if odd is not None:
        raise BadFile(
            f"{where}, line {odd.line}: not a point like those above, {lead} names and {wide - lead} numbers", cure=CUT
        )
    groups = [" ".join(row.cells[: lead - 1]) or "points" for row in rows]
    names = list(dict.fromkeys(groups))
    wanted = [name for name in names if format_.body in ("", name, name.split(" ")[-1])]
    if len(wanted) != 1:
        raise Ambiguous(
            f"{where}: holds the groups {', '.join(names)[:300]}",
            consequence="It is open which is meant",
            cure="Name one with --body",
        )
    rows = [row for row, group in zip(rows, groups, strict=True) if group == wanted[0]]
    xyz = numbers([Row(line=row.line, cells=row.cells[lead : lead + 3]) for row in rows], 3, where)
    point = [row.cells[lead - 1] for row in rows]
    if len(set(point)) < len(point):
        raise Ambiguous(f"{where}: two points of {wanted[0]!r} have one name", consequence="It is open which is meant")
    return Tracks(
        where=where,
        how="SpatialAnalyzer's list of points",
        lines=[row.line for row in rows],
        t_s=None,
        markers=(Track(name=format_.body or wanted[0], xyz_m=scale * xyz),),
        notes=(f"{len(point)} points in their order, {point[0]} to {point[-1]}",),
    )


def is_libfranka(head: str) -> bool:
    """Whether text is a log that libfranka wrote."""
    return re.match(r"\ufeff?\s*time, ?success_rate, ?state\.q\[0\]", head) is not None


def read_libfranka(data: bytes, where: str, format_: TableFormat) -> RawTable:
    """Return the log, its time in ms as its program means it. Raises BadFile, NotEnoughData."""
    raw = parse_text(data, where)
    names = ("time_ms", *raw.names[1:])
    return replace(raw, names=names, how="a log of libfranka", csv=False)
