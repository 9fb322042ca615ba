"""CSV tables: read with errors that name file, row and column; numbers written in full precision."""

from __future__ import annotations

import csv
import difflib
import io
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.errors import BadFile, NotEnoughData
from armsight.store.atomic import read_bytes

MAX_BYTES = 1_000_000_000
"""A quarter of an hour of poses at 1 kHz has 0.9 GB."""

FAR_FILLED = 3.0
"""One number in all cells is a fill where it is so many times as far as any value of the other rows."""
MOST_ROWS = 2_000_000
"""Half an hour at 1 kHz. Measured: 0.7 GB of memory for a million rows of four columns."""

Columns = dict[str, Any]
"""Columns of a table by name: arrays of numbers, lists of texts."""

NO_NUMBER = frozenset(("", "nan", "na", "n/a", "#n/a", "null", "none", "missing", "-", "--", "---"))
"""What programs write where they have no number, in small letters."""
UNREAL = 1e20
"""Trackers write such numbers for none: NDI's BAD_FLOAT is -3.7e28."""

_FORMULA = re.compile(r"'*[=+\-@\t\r]")
"""What spreadsheets take for the beginning of a formula, marked or not."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """Columns of numbers (n,), NaN where empty, and of text; where: the file; lines: (n,) of the rows, from 1."""

    where: str
    numbers: dict[str, Array]
    text: dict[str, tuple[str, ...]]
    lines: tuple[int, ...]

    def __len__(self) -> int:
        return len(self.lines)

    def stacked(self, names: Sequence[str]) -> Array:
        """Return the columns of numbers as (n, len(names))."""
        return np.stack([self.numbers[name] for name in names], axis=1) if names else np.empty((len(self), 0))

    def take(self, rows: Sequence[int] | NDArray[np.intp]) -> Table:
        """Return the table of some of its rows, counted from 0."""
        kept = np.asarray(rows, dtype=np.intp)
        return Table(
            where=self.where,
            numbers={name: column[kept] for name, column in self.numbers.items()},
            text={name: tuple(column[row] for row in kept) for name, column in self.text.items()},
            lines=tuple(self.lines[row] for row in kept),
        )

    def without_columns(self, names: Collection[str]) -> Table:
        """Return the table without some of its columns of numbers."""
        return replace(self, numbers={name: column for name, column in self.numbers.items() if name not in names})

    def location(self, row: int) -> str:
        """Return 'file, line 7' for a row counted from 0."""
        return f"{self.where}, line {self.lines[row]}"

    def series(self, prefix: str) -> tuple[str, ...]:
        """Return the names prefix1, prefix2, ... that are columns; BadFile where the count has a gap."""
        found = {name for name in self.numbers if name.startswith(prefix) and name[len(prefix) :].isdecimal()}
        names = tuple(f"{prefix}{i + 1}" for i in range(len(found)))
        if set(names) != found:
            raise BadFile(
                f"{self.where}: the columns {', '.join(sorted(found))} are not counted {prefix}1, {prefix}2, ...",
                cure="Number them from 1 without a gap",
            )
        return names


def read_table(
    path: Path,
    required: Sequence[str],
    *,
    optional: Collection[str] = (),
    text: Collection[str] = (),
    blank: Collection[str] = (),
    series: str = "",
    need_rows: bool = True,
) -> Table:
    """Return the table in a CSV file with a header; see parse_table."""
    return parse_table(
        read_bytes(path, limit=MAX_BYTES),
        str(path),
        required,
        optional=optional,
        text=text,
        blank=blank,
        series=series,
        need_rows=need_rows,
    )


def parse_table(
    data: bytes,
    where: str,
    required: Sequence[str],
    *,
    optional: Collection[str] = (),
    text: Collection[str] = (),
    blank: Collection[str] = (),
    series: str = "",
    need_rows: bool = True,
) -> Table:
    """Return the table in CSV bytes: UTF-8 with or without mark, any line ends, columns in any order.

    required, optional: names of columns. text: those of them that hold words. blank: columns of numbers whose cells
    may be empty. series: a prefix whose numbered columns (q1, q2, ...) are taken as well; in blank it stands for all of
    these. Raises BadFile that names file, row and column, NotEnoughData where need_rows and there is none.
    """
    rows, lines = _rows(data, where)
    header = [name.strip() for name in rows[0]] if rows else []
    _check_header(header, where, required, optional, series)
    body, lines = rows[1:], lines[1:]
    for row, line in zip(body, lines, strict=True):
        if len(row) != len(header):
            raise BadFile(
                f"{where}, line {line}: {len(row)} cells, the header has {len(header)}", cure="Give every row as many"
            )
    if need_rows and not body:
        raise no_rows(where)
    columns = list(zip(*body, strict=True)) if body else [() for _ in header]
    numbers, words = {}, {}
    for name, cells in zip(header, columns, strict=True):
        if name in text:
            words[name] = tuple(bare(cell.strip()) for cell in cells)
        else:
            may_be_blank = name in blank or (series in blank and _in_series(name, series))
            numbers[name] = number_column(cells, name, lines, where, may_be_blank)
    return Table(where=where, numbers=numbers, text=words, lines=tuple(lines))


def decoded(data: bytes, where: str) -> str:
    """Return the text of a table, UTF-8 with or without mark. Raises BadFile for others, and above MOST_ROWS."""
    rows = data.count(b"\n")
    if rows > MOST_ROWS:
        raise BadFile(
            f"{where}: {rows:,} lines, at most {MOST_ROWS:,} are read",
            consequence="They would take more memory than most machines have",
            cure="Give a part of the file, or every tenth row: what is fitted wants minutes of motion, not hours",
        )
    try:
        return data.decode("utf-8").lstrip("\ufeff")  # some programs put the mark twice
    except UnicodeDecodeError as error:
        raise BadFile(
            f"{where}: byte {error.start} is not UTF-8 text", cure="Save it as CSV in UTF-8; it may be a binary file"
        ) from error


def csv_rows(data: bytes, where: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows that are not empty, each with its line. Raises BadFile."""
    reader = csv.reader(io.StringIO(decoded(data, where), newline=""), strict=True)
    try:
        for row in reader:
            if any(_swallows_rows(cell, len(row)) for cell in row):
                raise BadFile(
                    f"{where}, line {reader.line_num}: a quoted cell goes over more than one row",
                    consequence="Rows would be lost in it",
                    cure="Take the quotes away",
                )
            if any(cell.strip() for cell in row):
                yield reader.line_num, row
    except csv.Error as error:
        raise BadFile(f"{where}, line {reader.line_num}: {error}") from error


def no_rows(where: str) -> NotEnoughData:
    """Return the refusal of a table that is a header alone."""
    return NotEnoughData(
        f"{where}: no row below the header",
        consequence="There is nothing to do",
        cure="Check that the recording ran, and that the file was copied whole",
    )


def _swallows_rows(cell: str, columns: int) -> bool:
    """Whether a cell holds as many commas as a row: two quotes astray. A name with a line break in it has fewer."""
    return ("\n" in cell or "\r" in cell) and cell.count(",") >= max(columns - 1, 1)


def _rows(data: bytes, where: str) -> tuple[list[list[str]], list[int]]:
    found = list(csv_rows(data, where))
    rows, lines = [row for _, row in found], [line for line, _ in found]
    if not rows:
        raise BadFile(f"{where}: the file is empty", cure="Check the file")
    return rows, lines


def _check_header(
    header: list[str], where: str, required: Sequence[str], optional: Collection[str], series: str
) -> None:
    missing = [name for name in required if name not in header]
    if missing:
        raise BadFile(
            f"{where}: the column{'s' * (len(missing) > 1)} {', '.join(missing)} "
            f"{'are' if len(missing) > 1 else 'is'} missing; found {', '.join(header)[:200]}",
            cure=_header_cure(header, required),
        )
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise BadFile(
            f"{where}: the column {twice[0][:40]!r} stands twice",
            consequence="Nobody knows which of them is meant",
            cure="Rename one of them, or take it out",
        )
    known = [*required, *optional]
    for name in header:
        if name not in known and not _in_series(name, series):
            close = difflib.get_close_matches(name, known, n=1)
            also = f", {series}1, {series}2, ..." if series else ""
            raise BadFile(
                f"{where}: unknown column {name[:40]!r}" + (f" (did you mean {close[0]!r}?)" if close else ""),
                cure=f"Valid columns: {', '.join(known)}{also}",
            )


def _in_series(name: str, prefix: str) -> bool:
    """Whether a column is one of prefix1, prefix2, ...; none is where there is no prefix."""
    return bool(prefix) and name.startswith(prefix) and name[len(prefix) :].isdecimal()


def _header_cure(header: list[str], required: Sequence[str]) -> str:
    if len(header) == 1 and ";" in header[0]:
        return "Separate cells by commas, not semicolons, and write decimals with a point"
    if any(is_number(name) for name in header):
        return f"The first line must name the columns: {', '.join(required)}, ..."
    return "Name them in the first line"


def plain_float(text: str) -> float:
    """Return the number that a text is: without underscores, which Python takes between digits. Raises ValueError."""
    if "_" in text:
        raise ValueError(text)
    return float(text)


def is_number(text: str) -> bool:
    """Whether a cell is a number."""
    try:
        plain_float(text)
    except ValueError:
        return False
    return True


def in_time(table: Table, notify: Callable[[str], None]) -> Table:
    """Return a table with t_s as a stream: rows that repeat the row before, stamp and all, are left out and told.

    Loggers that poll faster than a controller speaks write such rows. Raises BadFile, naming the line, where a stamp
    comes again with other values, or goes back.
    """
    t_s, cells = table.numbers["t_s"], [*table.numbers.values(), *(np.array(c) for c in table.text.values())]
    again = np.zeros(len(table), dtype=bool)
    again[1:] = np.all(
        [(c[1:] == c[:-1]) | ((c[1:] != c[1:]) & (c[:-1] != c[:-1])) for c in cells], axis=0
    )  # NaN is NaN
    kept = np.flatnonzero(~again)
    late = np.flatnonzero(np.diff(t_s[kept]) <= 0.0)
    if late.size:
        before, row = int(kept[late[0]]), int(kept[late[0] + 1])
        back = t_s[row] < t_s[before]
        raise BadFile(
            f"{table.location(row)}, column t_s: "
            + (f"{t_s[row]:.9g} s after {t_s[before]:.9g} s" if back else f"{t_s[row]:.9g} s again, with other values"),
            consequence="Nobody knows what came when",
            cure="Put the rows in the order of time" if back else "Write finer stamps, or leave one row out",
        )
    if again.any():
        notify(f"{table.where}: {int(again.sum())} of {len(table)} rows repeat the row before them and are left out")
    return table.take(kept)


def number_column(cells: Sequence[str], name: str, lines: Sequence[int], where: str, may_be_blank: bool) -> Array:
    """Return a column's numbers (n,); BadFile for what is none. may_be_blank: cells that say so are NaN."""
    values = np.empty(len(cells))
    for i, cell in enumerate(cells):
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
            if not may_be_blank or cell.strip().lower() not in NO_NUMBER:
                raise _bad_cell(cell, name, lines[i], where) from None
        if "_" in cell or math.isinf(value) or (value != value and not may_be_blank):
            raise _bad_cell(cell, name, lines[i], where)
        values[i] = value
    return values


def _bad_cell(cell: str, name: str, line: int, where: str) -> BadFile:
    shown = repr(cell if len(cell) <= 40 else cell[:37] + "...") if cell.strip() else "empty"
    return BadFile(
        f"{where}, line {line}, column {name}: {shown} is not a finite number", cure="Correct it, or remove the row"
    )


def known(values: Array) -> NDArray[np.bool_]:
    """Return which numbers are any, and none that a tracker writes for none."""
    return np.asarray(np.abs(values) < UNREAL)  # NaN is not


def zeros(values: Array) -> NDArray[np.bool_]:
    """Return which rows (n,) of numbers (n, k), k at least 1, are zero throughout."""
    return np.asarray((values == 0.0).all(axis=1) & bool(values.shape[1]))


def filled(values: Array) -> NDArray[np.bool_]:
    """Return which rows of positions (n, 3) hold one number, such as -9999, as other rows do, far beyond the rest."""
    same = (values == values[:, :1]).all(axis=1) & (values[:, 0] != 0.0)
    _, of, count = np.unique(values[same, 0], return_inverse=True, return_counts=True)
    out = np.zeros(len(values), bool)
    out[np.flatnonzero(same)] = count[of] > 1
    others = np.abs(values[~out])
    others = others[np.isfinite(others)]
    return np.asarray(out & (np.abs(values[:, 0]) / FAR_FILLED > others.max(initial=0.0)) & bool(len(others)))


def number(value: float) -> str:
    """Return the shortest text that reads back as the same float; empty for NaN, which stands for nothing."""
    value = float(value)
    return "" if math.isnan(value) else repr(value)


def word(text: str) -> str:
    """Return a text as one cell: quoted where CSV needs it, and with ' before it where a spreadsheet saw a formula.

    Names come out of files that anybody wrote, and a spreadsheet runs what begins with an equals sign. parse_table
    takes the mark away again.
    """
    if _FORMULA.match(text) and not is_number(text):
        text = f"'{text}"
    return '"' + text.replace('"', '""') + '"' if any(mark in text for mark in ',"\n\r') else text


def bare(text: str) -> str:
    """Return a cell's text without the mark that word gave it."""
    return text[1:] if text.startswith("'") and _FORMULA.match(text) else text


def cells(values: Sequence[float] | Array) -> str:
    """Return numbers as comma-separated cells in full precision."""
    return ",".join(["" if value != value else repr(float(value)) for value in values])


def table_text(columns: Mapping[str, NDArray[Any] | list[str]]) -> str:
    """Return columns as a table: numbers in full precision, NaN as an empty cell, whole ones as they are, texts."""
    shown = []
    for column in columns.values():
        if isinstance(column, list):
            shown.append(map(word, column))
        else:
            shown.append(map(number if column.dtype.kind == "f" else str, column.tolist()))
    return "\n".join([",".join(columns), *map(",".join, zip(*shown, strict=True))]) + "\n"


def read_columns(data: bytes) -> Columns:
    """Return a table of ours as columns (n,): numbers where all cells are, NaN for empty ones, else texts."""
    rows = list(csv.reader(io.StringIO(data.decode("utf-8-sig"), newline="")))
    header, body = rows[0], [row for row in rows[1:] if row]
    return {name: _column([row[i] for row in body]) for i, name in enumerate(header)}


def _column(cells: list[str]) -> Array | list[str]:
    try:
        return np.array([float(cell) if cell else np.nan for cell in cells])
    except ValueError:
        return cells
