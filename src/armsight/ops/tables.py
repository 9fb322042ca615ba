"""Tables as people have them: what was understood of one, and the same in the columns of ours."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from armsight.errors import BadFile, UsageError
from armsight.fields import Doc
from armsight.kinematics import Arm
from armsight.records.output import output
from armsight.shown import Shown, Table, digits
from armsight.store.atomic import TextOutput
from armsight.store.interpret import OURS, TableFormat
from armsight.store.interpret.read import check_joint_values, check_positions, interpret, kind_of_table
from armsight.store.tables import Table as ParsedTable
from armsight.store.tables import bare, parse_table, word

KINDS = ("joints", "poses", "points", "pairs", "robot_poses", "sweep")
"""Kinds of tables that can be asked for, named as the files are."""
UNTIMED = {"joints": "untimed-joints", "poses": "untimed-poses"}
"""Read without times where there are none: the rows are counted, which is told."""


@output
class ConvertTableOutput(TextOutput):
    """armsight convert table."""

    kind: Annotated[str, Doc("Which table it is: joints, poses, points, pairs, robot_poses or sweep.")]
    how: Annotated[str, Doc("How the file was found to be written.")]
    columns: Annotated[list[str], Doc("The columns of ours that it came to.")]
    ranges: Annotated[
        dict[str, tuple[float, float] | None],
        Doc(
            "Smallest and largest number of each column of numbers, in its unit; null where all of its cells are empty."
        ),
    ]
    n: Annotated[int, Doc("Rows.")]
    notes: Annotated[list[str], Doc("What was understood of units, rotations, times, frames and joints.")]
    file: Annotated[str | None, Doc("The file written; null where none was asked for.")]

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        rows = [
            [name, *(("", "") if found is None else (digits(found[0], 5), digits(found[1], 5)))]
            for name, found in self.ranges.items()
        ]
        yield Table(f"{self.kind}: {self.n} rows", ["column", "smallest", "largest"], rows)
        for note in self.notes:
            yield f"- {note}"
        yield f"Written: {self.file}" if self.file else "Nothing was written; -o FILE writes it"


def convert_table(
    source: Path,
    *,
    kind: str | None = None,
    format_: TableFormat | None = None,
    arm: Arm | None = None,
    out: Path | None = None,
) -> ConvertTableOutput:
    """Read a table, tell what was understood, and hold it in the columns of ours, for the file out where that is given.

    kind: one of KINDS, else that which the columns can be. arm: the arm whose joints' names the columns carry. Raises
    UsageError, DataRefused.
    """
    format_ = format_ or OURS
    if kind is not None and kind not in KINDS:
        raise UsageError(f"no kind of table is called {kind!r}", cure=f"Give --as with one of {', '.join(KINDS)}")
    if arm is not None:
        format_ = format_.of_arm(arm)
    format_.check()
    kind = kind or kind_of_table(source, format_, KINDS)
    found = interpret(source, UNTIMED.get(kind, kind), format_)
    if found.missing:
        raise BadFile(
            f"{source}: no column of {kind} is {', '.join(found.missing)}",
            consequence="The file is not used",
            cure="Name them in the first line, or give --columns",
        )
    rows = [row for row in csv.reader(io.StringIO(found.data.decode("utf-8-sig"), newline="")) if row]
    header, table = rows[0], _parsed(found.data, rows[0], source)
    _check_units(table.numbers, str(source), format_)
    ranges = {name: _range(column) for name, column in table.numbers.items()}
    return ConvertTableOutput(
        content="\n".join(",".join(word(bare(cell)) for cell in row) for row in rows) + "\n",
        kind=kind,
        how=found.how,
        columns=header,
        ranges=ranges,
        n=len(table),
        notes=[*found.notes, *(f"{name}: every cell is empty" for name, range_ in ranges.items() if range_ is None)],
        file=None if out is None else str(out),
    )


def _parsed(data: bytes, header: Sequence[str], source: Path) -> ParsedTable:
    """Return the columns of a table in names of ours."""
    return parse_table(
        data,
        str(source),
        (),
        optional=[name for name in header if not (name[0] == "q" and name[1:].isdecimal())],
        text=[name for name in header if name in ("file", "point", "status", "spots")],
        blank=header,
        series="q",
    )


def _check_units(columns: Mapping[str, NDArray[np.float64]], where: str, format_: TableFormat) -> None:
    """Raise Inconsistent where joint values are degrees, or positions mm: columns of ours alone are not interpreted."""
    joints = [values for name, values in columns.items() if name[0] == "q" and name[1:].isdecimal()]
    if joints:
        check_joint_values(np.stack(joints, axis=1), where, format_)
    for first in (name for name in columns if name.endswith("x_m")):
        names = [name for axis in "xyz" if (name := f"{first[:-3]}{axis}_m") in columns]
        check_positions(np.stack([columns[name] for name in names], axis=1), names, where, format_)


def _range(column: NDArray[np.float64]) -> tuple[float, float] | None:
    """Return the smallest and the largest number, None where every cell is empty."""
    known = column[np.isfinite(column)]
    return (float(known.min()), float(known.max())) if known.size else None
