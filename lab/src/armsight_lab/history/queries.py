"""What is put into a history and asked of it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any

from sqlalchemy import Connection, Select, Table, func, insert, select

from armsight.columns import POSE6_STD, POSE7
from armsight.fields import Doc
from armsight.records.output import output
from armsight_lab.history.database import figures, inputs, parameters, poses, runs
from armsight_lab.history.entry import Entry, InputFile, Quantity, RunHead, StoredPose

MANY = 500
"""Runs asked for at once: databases bound the number of values in a question."""


@output
class Run(RunHead):
    """A run in the history, without its numbers."""

    id: Annotated[int, Doc("Its number.")]
    filed: Annotated[str, Doc("When it was filed, UTC.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Filter:
    """Which runs: of a cell, of a command (or group of commands, as calibrate), created from since to before until."""

    cell: str | None = None
    command: str | None = None
    since: str | None = None
    until: str | None = None

    def of(self, question: Select[Any]) -> Select[Any]:
        """Return a question for runs that asks for these alone."""
        if self.cell is not None:
            question = question.where(runs.c.cell == self.cell)
        if self.command is not None:
            question = question.where((runs.c.command == self.command) | runs.c.command.startswith(f"{self.command} "))
        if self.since is not None:
            question = question.where(runs.c.created >= self.since)
        if self.until is not None:
            question = question.where(runs.c.created < self.until)
        return question


HEADER = tuple(runs.c[field.name] for field in fields(Run))


def add(connection: Connection, entry: Entry, filed: str) -> tuple[int, bool]:
    """Put a run in; return its number, and whether it is new: the same one is filed once."""
    there = connection.execute(select(runs.c.id).where(runs.c.fingerprint == entry.fingerprint)).scalar()
    if there is not None:
        return int(there), False
    row = {
        **{field.name: getattr(entry, field.name) for field in fields(RunHead)},
        "filed": filed,
        "fingerprint": entry.fingerprint,
        "result": json.dumps(entry.result, ensure_ascii=False),
    }
    made = connection.execute(insert(runs), row).inserted_primary_key
    number = int(made[0]) if made else 0
    _fill(connection, inputs, number, [one.to_dict() for one in entry.inputs])
    _fill(connection, figures, number, [one.to_dict() for one in entry.figures])
    _fill(connection, parameters, number, [one.to_dict() for one in entry.parameters])
    _fill(connection, poses, number, [_pose_row(one) for one in entry.poses])
    return number, True


def _fill(connection: Connection, table: Table, number: int, rows: Sequence[Mapping[str, Any]]) -> None:
    if rows:
        connection.execute(insert(table), [{"run_id": number, **row} for row in rows])


def _pose_row(pose: StoredPose) -> dict[str, Any]:
    values = zip((*POSE7, *POSE6_STD), (*pose.xyz_m, *pose.quat_xyzw, *pose.std), strict=True)
    return {"name": pose.name, **dict(values)}


def count(connection: Connection, wanted: Filter) -> int:
    """Return how many runs there are."""
    return int(connection.execute(wanted.of(select(func.count()).select_from(runs))).scalar() or 0)


def newest(connection: Connection, wanted: Filter, most: int | None = None) -> list[Run]:
    """Return runs, the newest first."""
    question = wanted.of(select(*HEADER)).order_by(runs.c.created.desc(), runs.c.id.desc()).limit(most)
    return [Run(**row._mapping) for row in connection.execute(question)]


def one(connection: Connection, number: int) -> Run | None:
    """Return a run by its number."""
    row = connection.execute(select(*HEADER).where(runs.c.id == number)).first()
    return None if row is None else Run(**row._mapping)


def cells(connection: Connection) -> list[str]:
    """Return the names of all cells."""
    return [str(row[0]) for row in connection.execute(select(runs.c.cell).distinct().order_by(runs.c.cell))]


def commands(connection: Connection, cell: str | None = None) -> list[str]:
    """Return the commands of which there are runs."""
    question = Filter(cell=cell).of(select(runs.c.command).distinct()).order_by(runs.c.command)
    return [str(row[0]) for row in connection.execute(question)]


def numbers(connection: Connection) -> tuple[int, int] | None:
    """Return the first and the last number of a run, None where there is none."""
    first, last = connection.execute(select(func.min(runs.c.id), func.max(runs.c.id))).one()
    return None if first is None else (int(first), int(last))


def inputs_of(connection: Connection, numbers: Sequence[int]) -> dict[int, list[InputFile]]:
    """Return the inputs of runs by their numbers."""
    return _by_run(connection, inputs, numbers, lambda row: _made(InputFile, row))


def figures_of(connection: Connection, numbers: Sequence[int]) -> dict[int, list[Quantity]]:
    """Return all numbers of the results of runs."""
    return _by_run(connection, figures, numbers, lambda row: _made(Quantity, row))


def parameters_of(connection: Connection, numbers: Sequence[int]) -> dict[int, list[Quantity]]:
    """Return what was calibrated in runs."""
    return _by_run(connection, parameters, numbers, lambda row: _made(Quantity, row))


def poses_of(connection: Connection, numbers: Sequence[int]) -> dict[int, list[StoredPose]]:
    """Return the poses that were calibrated in runs."""
    return _by_run(connection, poses, numbers, _stored)


def _made(kind: Any, row: Any) -> Any:
    return kind(**{one.name: getattr(row, one.name) for one in fields(kind)})


def _stored(row: Any) -> StoredPose:
    return StoredPose(
        name=row.name,
        xyz_m=(row.x_m, row.y_m, row.z_m),
        quat_xyzw=(row.qx, row.qy, row.qz, row.qw),
        std=tuple(getattr(row, name) for name in POSE6_STD),
    )


def _by_run(connection: Connection, table: Table, numbers: Sequence[int], made: Any) -> dict[int, list[Any]]:
    found: dict[int, list[Any]] = {}
    for start in range(0, len(numbers), MANY):
        part = numbers[start : start + MANY]
        for row in connection.execute(
            select(table).where(table.c.run_id.in_(part)).order_by(*table.primary_key.columns)
        ):
            found.setdefault(row.run_id, []).append(made(row))
    return found


def kinds_of_joints(connection: Connection, cell: str) -> list[Run]:
    """Return the first run of each kind of arm in a cell."""
    first = select(func.min(runs.c.id)).where(runs.c.cell == cell, runs.c.joints != "").group_by(runs.c.joints)
    return [
        Run(**row._mapping)
        for row in connection.execute(select(*HEADER).where(runs.c.id.in_(first)).order_by(runs.c.id))
    ]
