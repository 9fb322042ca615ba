"""A table as its file has it: names of columns, where there are any, and the cells as text."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass

from armsight.errors import BadFile, NotEnoughData
from armsight.store.tables import decoded, is_number, no_rows

REMARKS = ("#", "%", "//")


@dataclass(frozen=True, slots=True, kw_only=True)
class RawTable:
    """where: the file. how: what kind it was found to be, in words. names: of the columns, () where it has none.
    columns: the cells (k lists of n). lines: (n,) the line that each row came from, from 1. csv: whether the file
    has its cells as a CSV of ours, by commas. notes: what was understood, in words. tracked: a tracker wrote it.
    listed: a robot's program, whose points have no times."""

    where: str
    how: str
    names: tuple[str, ...]
    columns: tuple[Sequence[str], ...]
    lines: tuple[int, ...]
    csv: bool = False
    notes: tuple[str, ...] = ()
    tracked: bool = False
    listed: bool = False

    def __len__(self) -> int:
        return len(self.lines)


def parse_text(data: bytes, where: str) -> RawTable:
    """Return the table in text: cells apart by comma, semicolon, tab or blanks; lines that begin with # are remarks.

    A remark right before the first row names the columns where it has as many words. Rows of four numbers whose every
    fourth is 0 0 0 1 are poses of 4 x 4. Raises BadFile that names the line.
    """
    lines = [(i, line) for i, line in enumerate(decoded(data, where).splitlines(), 1) if line.strip()]
    body = [(i, line) for i, line in lines if not line.lstrip().startswith(REMARKS)]
    if not body:
        raise BadFile(f"{where}: the file is empty", cure="Check the file")
    split = splitter(body[min(1, len(body) - 1)][1])
    rows = _without_last_mark([(i, split(line)) for i, line in body])
    names: tuple[str, ...] = ()
    levels = 1
    if not is_data(rows[0][1]):
        levels = _header_lines(rows)
        names, rows = _joined([cells for _, cells in rows[:levels]]), rows[levels:]
    else:
        before = [line for i, line in lines if i < rows[0][0]]
        words = split(before[-1].lstrip().lstrip("#%/").strip()) if before else []
        names = tuple(words) if len(words) == len(rows[0][1]) and not is_data(words) else ()
    if not rows:
        raise no_rows(where)
    blocks = None if names else _matrix_blocks(rows)
    if blocks is not None:
        return _transposed(where, "matrices of 4 x 4, one below the other", MATRIX, blocks)
    wide = len(names or rows[0][1])
    for i, row in rows:
        if len(row) != wide:
            raise BadFile(
                f"{where}, line {i}: {len(row)} cells, the {'header' if names else 'first row'} has {wide}",
                cure="Give every row one cell per column",
            )
    how = f"a table of {wide} columns {split.how}, {'with' if names else 'without'} a header"
    how += f" of {levels} lines, joined: {', '.join(filter(None, names))[:TOLD]}" if levels > 1 else ""
    return _transposed(where, how, names, rows, csv=split.by == "," and levels == 1)


LEVELS, TOLD = 5, 120
"""Header lines that are joined at the most; letters of the names that are told."""


def _header_lines(rows: Sequence[tuple[int, list[str]]]) -> int:
    """Return how many lines the header has: several as wide as the table without a number, above rows of numbers; with
    numbers, as joints are counted by, where a line that names the first column alone ends them."""
    count = 1
    for k, (_, cells) in enumerate(rows[1:LEVELS], 2):
        if len(cells) != len(rows[0][1]) or not any(cells) or is_number(cells[0]):
            break
        if not any(map(is_number, cells)) and (count == k - 1 or not any(cells[1:])):
            count = k
    return count if count < len(rows) and is_data(rows[count][1]) else 1


def _joined(levels: list[list[str]]) -> tuple[str, ...]:
    """Return the columns' names of a header, lines joined; a last line that names the first column alone names it.

    So pandas writes columns of several levels, with the index's name below them.
    """
    last = levels[-1]
    index = last[0] if len(levels) > 1 and not any(last[1:]) else ""
    names = ["_".join(filter(None, words)) for words in zip(*levels[: -1 if index else None], strict=True)]
    return (index, *names[1:]) if index else tuple(names)


MATRIX = tuple(f"m{row}{column}" for row in range(4) for column in range(4))


def table_of(records: Sequence[dict[str, str]], where: str, how: str) -> RawTable:
    """Return records of the same keys as a table, the k-th as if from line k + 1. Raises BadFile, NotEnoughData."""
    if not records:
        raise NotEnoughData(f"{where}: holds no row", consequence="There is nothing to do")
    names = tuple(records[0])
    for k, record in enumerate(records, 1):
        if set(record) != set(names):
            odd = sorted(set(record) ^ set(names))[0]
            raise BadFile(
                f"{where}: of entry {k} and entry 1 only one has {odd[:60]!r}", cure="Give every entry the same keys"
            )
    columns = tuple([record[name] for record in records] for name in names)
    return RawTable(where=where, how=how, names=names, columns=columns, lines=tuple(range(2, len(records) + 2)))


def _without_last_mark(rows: list[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
    """Return rows without the cell behind a mark that ends lines: one that the first line has not, or leaves empty."""
    first = rows[0][1]
    wide = len(first) - (len(first) > 1 and not first[-1])
    return [(i, row[:wide] if len(row) == wide + 1 and not row[-1] else row) for i, row in rows]


def _transposed(
    where: str, how: str, names: tuple[str, ...], rows: Sequence[tuple[int, Sequence[str]]], *, csv: bool = False
) -> RawTable:
    columns = tuple([row[k] for _, row in rows] for k in range(len(rows[0][1])))
    return RawTable(where=where, how=how, names=names, columns=columns, lines=tuple(i for i, _ in rows), csv=csv)


class splitter:  # noqa: N801 - a function that says how it splits
    """Splits a line as the sample is written."""

    def __init__(self, sample: str) -> None:
        self.by = next((mark for mark in (";", "\t", ",") if mark in sample), "")
        self.how = {";": "by semicolons", "\t": "by tabs", ",": "by commas", "": "by blanks"}[self.by]

    def __call__(self, line: str) -> list[str]:
        """Return the cells of a line."""
        if not self.by:
            return line.split()
        cells = [cell.strip() for cell in next(csv.reader(io.StringIO(line), delimiter=self.by))]
        if self.by in (";", "\t"):
            cells = [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells]
        return cells


_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")


def is_data(cells: Sequence[str]) -> bool:
    """Whether a line is a row and no header: most of its cells are numbers."""
    return 2 * sum(is_number(cell) for cell in cells) > len(cells)


def _matrix_blocks(rows: Sequence[tuple[int, list[str]]]) -> list[tuple[int, list[str]]] | None:
    """Return a row of 16 cells for each matrix of 4 x 4, None where the file holds none; a count may come first."""
    if len(rows[0][1]) == 1 and rows[0][1][0].isdecimal():
        rows = rows[1:]
    if not rows or len(rows) % 4 or any(len(row) != 4 or not all(map(is_number, row)) for _, row in rows):
        return None
    if any([float(cell) for cell in rows[k][1]] != [0.0, 0.0, 0.0, 1.0] for k in range(3, len(rows), 4)):
        return None
    return [(rows[k][0], [cell for _, row in rows[k : k + 4] for cell in row]) for k in range(0, len(rows), 4)]
