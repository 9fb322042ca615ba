"""The lines of a tracker's text file as cells, and columns of them as numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armsight.arrays import Array
from armsight.errors import BadFile, Inconsistent
from armsight.store.interpret.raw import splitter
from armsight.store.tables import decoded, is_number, plain_float

CUT = "It may be cut off: export it anew"


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """Cells, and the line that they came from, from 1."""

    line: int
    cells: list[str]


def rows_of(data: bytes, where: str, sample: str = "") -> list[Row]:
    """Return the lines as rows, apart as the first line is that holds sample; a last one that is cut off left out.

    Raises BadFile for what is no text.
    """
    text = decoded(data, where)
    lines = text.splitlines()
    split = splitter(next((line for line in lines if sample in line), lines[0] if lines else ""))
    rows = [Row(line=i, cells=split(line) if line.strip() else []) for i, line in enumerate(lines, 1)]
    if len(rows) > 1 and not text.endswith(("\n", "\r")) and _decimals(rows[-1]) < _decimals(rows[-2]):
        return rows[:-1]  # its last number is half of one
    return rows


def _decimals(row: Row) -> int:
    """Return how many digits stand behind the point of the last number."""
    last = next((cell for cell in reversed(row.cells) if cell), "")
    return len(last.partition(".")[2])


def filled_rows(rows: Sequence[Row]) -> list[Row]:
    """Return the rows that hold anything."""
    return [row for row in rows if any(row.cells)]


def numbers(rows: Sequence[Row], width: int, where: str) -> Array:
    """Return rows of so many cells (n, width) as numbers, NaN where a cell is empty. Raises BadFile with the line."""
    out = np.full((len(rows), width), np.nan)
    for k, row in enumerate(rows):
        cells = row.cells[:width]
        if len(cells) < width or any(row.cells[width:]):
            raise BadFile(
                f"{where}, line {row.line}: {len(row.cells)} cells, the header has {width}",
                cure=f"{CUT}, with decimal points where cells are apart by commas",
            )
        try:
            out[k] = [plain_float(cell) if cell else np.nan for cell in cells]
        except ValueError:
            odd = next(cell for cell in cells if cell and not is_number(cell))
            raise BadFile(f"{where}, line {row.line}: {odd[:40]!r} is no number", cure=CUT) from None
    if np.isinf(out).any():
        raise BadFile(f"{where}, line {rows[int(np.argwhere(np.isinf(out))[0, 0])].line}: a number without end")
    return out


def check_count(rows: Sequence[object], said: str, where: str, what: str = "frames") -> None:
    """Raise Inconsistent where a file has not as many frames, or what is counted, as its header says."""
    if said.isdecimal() and int(said) != len(rows):
        raise Inconsistent(
            f"{where}: the header says {said} {what}, there are {len(rows)}",
            consequence="A part of the recording is missing",
            cure=f"{CUT}; where a part is meant, correct the number in the header",
        )


def check_times(t_s: Array, rows: Sequence[Row], where: str) -> None:
    """Raise Inconsistent where a frame's time is missing or not later than that of the frame before."""
    late = np.flatnonzero(~(np.diff(t_s, prepend=-np.inf) > 0.0))
    if late.size:
        raise Inconsistent(
            f"{where}, line {rows[int(late[0])].line}: the time {t_s[late[0]]:g} s is not later than the one before",
            consequence="The frames have no order",
            cure=CUT,
        )


def lost_where_zero(values: Array) -> Array:
    """Return values (n, k) with the rows of zeros alone as NaN."""
    return np.where((values == 0.0).all(axis=1)[:, None], np.nan, values)
