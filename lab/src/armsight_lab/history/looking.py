"""Runs of the history listed, shown, held side by side, and written out as a table."""

from __future__ import annotations

import csv
import difflib
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation
from sqlalchemy import Connection

from armsight.columns import POSE6, POSITION, ROTATION_VECTOR
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.fields import Doc
from armsight.records.output import Output, figure, output
from armsight.records.result_parts import Difference
from armsight.store.atomic import write_bytes
from armsight_lab.history import queries
from armsight_lab.history.database import reading
from armsight_lab.history.entry import InputFile, Quantity, StoredPose, cell_name, optional_moment
from armsight_lab.history.place import place_of
from armsight_lab.history.queries import Filter, Run
from armsight_lab.history.request import CompareRunsJob, ExportRunsJob, ListJob, ShowJob

BEYOND = 3.0
"""Deviations of a difference beyond which it is marked: chance brings one in 400 so far."""
FORMATS = (".csv", ".parquet", ".jsonl")
COLUMNS = ("run", "cell", "command", "created", "trusted", "kind", "name", "value", "std", "unit")


@output
class HistoryListOutput(Output):
    """armsight history list."""

    runs: Annotated[list[Run], Doc("The runs, the newest first.")]
    n: Annotated[int, Doc("How many there are of this kind, listed or not.")]
    history: Annotated[str, Doc("Where the history is.")]


@output
class HistoryShowOutput(Output):
    """armsight history show."""

    run: Annotated[Run, Doc("The run.")]
    inputs: Annotated[list[InputFile], Doc("What it was given.")]
    parameters: Annotated[list[Quantity], Doc("What was calibrated; of poses the place, and the quaternion.")]
    figures: Annotated[list[Quantity], Doc("All numbers of the result.")]


@output
class RunDifference(Difference):
    """A number of two runs; of the turn of a pose, A is 0 and B the rotation vector from A."""

    @figure("Whether the difference is beyond three deviations; null where there is none.")
    def exceeds(self) -> bool | None:
        return None if self.std is None else abs(self.difference) > BEYOND * self.std


@output
class HistoryCompareOutput(Output):
    """armsight history compare."""

    a: Annotated[Run, Doc("The first run.")]
    b: Annotated[Run, Doc("The second run.")]
    parameters: Annotated[
        list[RunDifference], Doc("What was calibrated; turns of poses as the rotation vector of B against A.")
    ]
    figures: Annotated[list[RunDifference], Doc("All numbers that both have.")]
    notes: Annotated[list[str], Doc("What to know.")]


@output
class HistoryExportOutput(Output):
    """armsight history export."""

    file: Annotated[str, Doc("The table that was written.")]
    n_runs: Annotated[int, Doc("Runs in it.")]
    n_rows: Annotated[int, Doc("Rows in it, one a number.")]
    notes: Annotated[list[str], Doc("What to know.")]


def list_runs(job: ListJob) -> HistoryListOutput:
    """List runs. Raises UsageError for a cell or command that is none, BadFile, DeviceFailed."""
    place = place_of(job.history)
    with reading(place) as connection:
        wanted = filter_of(connection, job)
        found = queries.newest(connection, wanted, job.most)
        n = queries.count(connection, wanted)
    return HistoryListOutput(runs=found, n=n, history=str(place))


def filter_of(connection: Connection, job: ListJob | ExportRunsJob) -> Filter:
    """Return which runs are asked for. Raises UsageError with the choices."""
    cell = None if job.cell is None else known_cell(connection, job.cell)
    command = None if job.command is None else known_command(connection, job.command, cell)
    since, until = optional_moment(job.since), optional_moment(job.until)
    return Filter(cell=cell, command=command, since=since, until=until)


def known_cell(connection: Connection, given: str) -> str:
    """Return a cell of which there are runs. Raises UsageError with the choices."""
    name = cell_name(given)
    return one_of(name, queries.cells(connection), "cell", "Give one of them; armsight history list shows their runs")


def known_command(connection: Connection, given: str, cell: str | None) -> str:
    """Return a command of which there are runs. Raises UsageError with the choices."""
    there = queries.commands(connection, cell)
    groups = {one.partition(" ")[0] for one in there}
    return one_of(given, sorted({*there, *groups}), "command", "Give one of them")


def one_of(given: str, choices: Sequence[str], what: str, cure: str) -> str:
    """Return what was given where it is a choice. Raises UsageError with the nearest, and the choices."""
    if given in choices:
        return given
    if not choices:
        raise UsageError("the history holds no run", consequence="Nothing was done", cure="File one with --cell NAME")
    close = difflib.get_close_matches(given, choices, n=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    more = f" and {len(choices) - MOST_CHOICES} more" if len(choices) > MOST_CHOICES else ""
    listed = ", ".join(map(repr, choices[:MOST_CHOICES]))
    raise UsageError(
        f"there is no {what} {given!r} in the history{hint}",
        consequence="Nothing was done",
        cure=f"{cure}: {listed}{more}",
    )


MOST_CHOICES = 12


def known_run(connection: Connection, number: int) -> Run:
    """Return a run by its number. Raises UsageError with the numbers there are."""
    found = queries.one(connection, number)
    if found is not None:
        return found
    ends = queries.numbers(connection)
    there = "the history holds no run" if ends is None else f"there are runs from {ends[0]} to {ends[1]}"
    raise UsageError(
        f"there is no run {number}: {there}", consequence="Nothing was done", cure="armsight history list shows them"
    )


def show_run(job: ShowJob) -> HistoryShowOutput:
    """Show a run with all its numbers. Raises UsageError, BadFile, DeviceFailed."""
    with reading(place_of(job.history)) as connection:
        run = known_run(connection, job.run)
        figures = queries.figures_of(connection, [run.id]).get(run.id, [])
        given = queries.inputs_of(connection, [run.id]).get(run.id, [])
        parameters = _parameters(connection, [run.id]).get(run.id, [])
    return HistoryShowOutput(
        run=run,
        inputs=given,
        parameters=parameters,
        figures=figures,
    )


def _parameters(connection: Connection, numbers: Sequence[int]) -> dict[int, list[Quantity]]:
    """Return the parameters of runs, of poses their place and quaternion, with deviations of the place."""
    found = queries.parameters_of(connection, numbers)
    for number, poses in queries.poses_of(connection, numbers).items():
        found.setdefault(number, []).extend(one for pose in poses for one in pose_numbers(pose))
    return found


def pose_numbers(pose: StoredPose) -> Iterator[Quantity]:
    """Yield the place of a pose with deviations, its quaternion, and deviations of a small rotation, of no value."""
    for axis, value, std in zip(POSITION, pose.xyz_m, pose.std, strict=False):
        yield Quantity(name=f"{pose.name}.{axis}", value=value, std=std, unit="m")
    for part, value in zip("xyzw", pose.quat_xyzw, strict=True):
        yield Quantity(name=f"{pose.name}.q{part}", value=value, std=None, unit="")
    for axis, std in zip(ROTATION_VECTOR, pose.std[len(POSITION) :], strict=True):
        yield Quantity(name=f"{pose.name}.{axis}", value=None, std=std, unit="rad")


def compare_runs(job: CompareRunsJob) -> HistoryCompareOutput:
    """Hold two runs side by side. Raises UsageError, Inconsistent for runs of two kinds, BadFile, DeviceFailed."""
    with reading(place_of(job.history)) as connection:
        a, b = known_run(connection, job.a), known_run(connection, job.b)
        both = [a.id, b.id]
        figures = queries.figures_of(connection, both)
        parameters, poses = queries.parameters_of(connection, both), queries.poses_of(connection, both)
    found = list(_differences(parameters.get(a.id, []), parameters.get(b.id, [])))
    found += _pose_differences(poses.get(a.id, []), poses.get(b.id, []))
    all_figures = list(_differences(figures.get(a.id, []), figures.get(b.id, [])))
    if a.command != b.command and not found:
        raise Inconsistent(
            f"run {a.id} is of {a.command} and run {b.id} of {b.command}, and they share no parameter",
            consequence="Nothing was compared",
            cure="Give two runs of one command",
        )
    notes = [] if a.cell == b.cell else [f"Run {a.id} is of cell {a.cell!r}, run {b.id} of {b.cell!r}."]
    notes += [] if a.joints == b.joints else [f"The joints differ: {a.joints or 'none'} and {b.joints or 'none'}."]
    notes += [f"Run {one.id} is not to be trusted: {one.reason}" for one in (a, b) if not one.trusted]
    return HistoryCompareOutput(
        a=a,
        b=b,
        parameters=found,
        figures=all_figures if a.command == b.command else [],
        notes=notes,
    )


def _differences(a: Sequence[Quantity], b: Sequence[Quantity]) -> Iterator[RunDifference]:
    there = {one.name: one for one in b}
    for one in a:
        other = there.get(one.name)
        if other is None or one.value is None or other.value is None:
            continue
        off = other.value - one.value
        if one.unit == "rad":
            off = wrapped(off)
        std = None if one.std is None or other.std is None else float(np.hypot(one.std, other.std))
        yield RunDifference(name=one.name, unit=one.unit, a=one.value, b=other.value, difference=off, std=std)


def wrapped(angle_rad: float) -> float:
    """Return an angle within half a turn about 0."""
    return float((angle_rad + np.pi) % (2.0 * np.pi) - np.pi)


def _pose_differences(a: Sequence[StoredPose], b: Sequence[StoredPose]) -> list[RunDifference]:
    there = {one.name: one for one in b}
    found = []
    for one in a:
        other = there.get(one.name)
        if other is None:
            continue
        off = pose_change(one, other)
        held = [*zip(one.xyz_m, other.xyz_m, strict=True), *((0.0, turn) for turn in off[3:])]
        for name, pair, difference, s, t in zip(POSE6, held, off, one.std, other.std, strict=True):
            std = None if s is None or t is None else float(np.hypot(s, t))
            unit = "m" if name in POSITION else "rad"
            named = f"{one.name}.{name}"
            found.append(RunDifference(name=named, unit=unit, a=pair[0], b=pair[1], difference=difference, std=std))
    return found


def pose_change(a: StoredPose, b: StoredPose) -> list[float]:
    """Return what leads from A to B: the shift, m, and the rotation vector of R_b R_a^-1, rad, in the parent's axes."""
    shift = np.subtract(b.xyz_m, a.xyz_m)
    turn = (Rotation.from_quat(b.quat_xyzw) * Rotation.from_quat(a.quat_xyzw).inv()).as_rotvec()
    return [*shift.tolist(), *turn.tolist()]


def export_runs(job: ExportRunsJob) -> HistoryExportOutput:
    """Write every number of every run as a table. Raises UsageError, NotEnoughData, BadFile, DeviceFailed."""
    ending = job.out.suffix.lower()
    if ending not in FORMATS:
        raise UsageError(
            f"{job.out} ends in {ending or 'nothing'}",
            consequence="Nothing is written",
            cure=f"Give a name that ends in {', '.join(FORMATS)}",
        )
    with reading(place_of(job.history)) as connection:
        found = queries.newest(connection, filter_of(connection, job))[::-1]
        numbers = [one.id for one in found]
        tables = {"figure": queries.figures_of(connection, numbers), "parameter": _parameters(connection, numbers)}
    if not found:
        raise NotEnoughData(
            "the history holds no such run",
            consequence="Nothing is written",
            cure="Ask for more: armsight history list",
        )
    rows = [
        (run.id, run.cell, run.command, run.created, run.trusted, kind, one.name, one.value, one.std, one.unit)
        for run in found
        for kind, by_run in tables.items()
        for one in by_run.get(run.id, [])
    ]
    path, notes = job.out, []
    if ending == ".parquet":
        data = _parquet(rows)
        if data is None:
            path = job.out.with_suffix(".jsonl")
            notes.append(
                f"Parquet needs pyarrow (pip install 'armsight[batch]'): the table is {path}, JSON line by line."
            )
    if path.suffix.lower() == ".jsonl":
        data = "".join(
            json.dumps(dict(zip(COLUMNS, row, strict=True)), ensure_ascii=False) + "\n" for row in rows
        ).encode()
    elif path.suffix.lower() == ".csv":
        data = _csv(rows)
    write_bytes(path, data or b"")
    return HistoryExportOutput(file=str(path), n_runs=len(found), n_rows=len(rows), notes=notes)


Cells = Sequence[tuple[object, ...]]


def _csv(rows: Cells) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(rows)
    return text.getvalue().encode()


def _parquet(rows: Cells) -> bytes | None:
    """Return the table as Parquet, None without the package."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        return None
    kinds: Mapping[str, object] = {"run": pyarrow.int64(), "trusted": pyarrow.bool_()}
    kinds = {**kinds, "value": pyarrow.float64(), "std": pyarrow.float64()}
    schema = pyarrow.schema([(name, kinds.get(name, pyarrow.string())) for name in COLUMNS])
    columns = [list(column) for column in zip(*rows, strict=True)] if rows else [[] for _ in COLUMNS]
    table = pyarrow.table(dict(zip(COLUMNS, columns, strict=True)), schema=schema)
    out = io.BytesIO()
    pyarrow.parquet.write_table(table, out)
    return out.getvalue()
