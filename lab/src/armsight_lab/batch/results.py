"""What a batch tells and writes: result.json of each job, batch.json, and the table of all in Parquet.

A column's type in the table follows from all of its values: whole numbers stay whole, and become floats where one of
them is; lists of numbers and of texts are lists; whatever else is, or is mixed, becomes text (JSON). A column without
any value is of Parquet's null, which every reader joins with any other type.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Annotated, Any

from armsight._version import __version__
from armsight.fields import Doc
from armsight.records.output import Output, output
from armsight.records.result_parts import Refusal
from armsight.store.atomic import write_bytes, write_json


@output
class NotDone(Output):
    """A job that did not come to its end, or to a doubtful one."""

    job: Annotated[str, Doc("Its name.")]
    status: Annotated[str, Doc("doubtful, refused, misused, failed or killed.")]
    cause: Annotated[str, Doc("Why; empty for doubtful results, which tell it themselves.")]


@output
class BatchOutput(Output):
    """armsight batch."""

    n: Annotated[int, Doc("Jobs.")]
    statuses: Annotated[dict[str, int], Doc("How many ended so: done, doubtful, refused, misused, failed, killed.")]
    n_kept: Annotated[int, Doc("Jobs that an earlier run had done, with the same inputs and arguments.")]
    not_done: Annotated[list[NotDone], Doc("The first 20 jobs that are not done; the table has all.")]
    duration_s: Annotated[float, Doc("From the first job to the table.")]
    n_workers: Annotated[int, Doc("The most workers that were there at once.")]
    table: Annotated[str, Doc("The table of all figures, in Parquet.")]


RESULT = "result.json"
BATCH = "batch.json"
RESULTS = "results.parquet"
RESULT_FORMAT = {"format": "armsight/batch-result", "version": 1}
BATCH_FORMAT = {"format": "armsight/batch-folder", "version": 1}

COLUMNS = (
    *("job", "command", "status", "exit_code", "cause", "consequence", "cure"),
    *("duration_s", "input_hash", "attempts"),
)
"""What every row of the table has, first and in this order; the job's figures follow."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JobResult:
    """How a job of a batch ended.

    batch: the run that did it. result: the figures, as the command's JSON object has them. said: what it told the
    person. duration_s: of the last attempt.
    """

    batch: str
    job: str
    command: str
    arguments: Mapping[str, object]
    status: str
    exit_code: int
    error: Refusal | None
    result: Mapping[str, object] | None
    said: str
    duration_s: float
    attempts: int
    input_hash: str
    software: str = f"armsight {__version__}"

    def row(self) -> dict[str, object]:
        """Return the columns, then every figure under its dotted name; one named as a column is result.NAME."""
        of = self.error.to_dict() if self.error else {}
        columns: dict[str, object] = {name: of.get(name) if name in PARTS else getattr(self, name) for name in COLUMNS}
        return columns | dict(_figures(self.result or {}))


PARTS = ("cause", "consequence", "cure")


def write_job_result(folder: Path, result: JobResult, *, called: Path) -> None:
    """Write result.json; the folder is called by the name that it has in the end. Raises DeviceFailed."""
    told = RESULT_FORMAT | {one.name: getattr(result, one.name) for one in dataclasses.fields(result)}
    told["error"] = result.error.to_dict() if result.error else None
    write_json(folder / RESULT, _renamed(told, str(folder), str(called)))


def read_job_result(folder: Path) -> JobResult | None:
    """Return what a job's result.json holds; None where there is none, or no whole one."""
    try:
        told = json.loads((folder / RESULT).read_bytes())
        if {key: told.pop(key) for key in RESULT_FORMAT} != RESULT_FORMAT:
            return None
        error = told.pop("error")
        return JobResult(error=Refusal(**error) if error else None, **told)
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def write_batch(out: Path, batch: str, n_jobs: int) -> None:
    """Write batch.json, which says whose the folder is. Raises DeviceFailed."""
    write_json(out / BATCH, BATCH_FORMAT | {"id": batch, "jobs": n_jobs, "software": f"armsight {__version__}"})


def read_batch(out: Path) -> str | None:
    """Return the id in batch.json; None where there is none."""
    try:
        told = json.loads((out / BATCH).read_bytes())
        return str(told["id"]) if told.get("format") == BATCH_FORMAT["format"] else None
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def rows_of(out: Path, names: Sequence[str]) -> Iterator[Mapping[str, object]]:
    """Yield a row for each job that is finished, in the order of the names."""
    for name in names:
        result = read_job_result(out / name)
        if result is not None:
            yield result.row()


def _figures(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, object]]:
    for name, value in content.items():
        dotted = f"{prefix}{name}"
        if isinstance(value, Mapping):
            yield from _figures(value, f"{dotted}.")
        else:
            yield f"result.{dotted}" if dotted in COLUMNS else dotted, value


def _renamed(value: object, before: str, after: str) -> object:
    if isinstance(value, str):
        return value.replace(before, after)
    if isinstance(value, Mapping):
        return {name: _renamed(one, before, after) for name, one in value.items()}
    return [_renamed(one, before, after) for one in value] if isinstance(value, list | tuple) else value


ROWS = 2000
"""Rows held at once: the table of a hundred thousand jobs is written in less than 100 MB."""
NOTHING, EMPTY, FLAG, WHOLE, NUMBER, TEXT, NUMBERS, TEXTS, JSON = (
    *("nothing", "empty", "flag", "whole", "number", "text", "numbers", "texts", "json"),
)
LARGEST = 2**63
WIDER = {frozenset((WHOLE, NUMBER)): NUMBER, frozenset((EMPTY, NUMBERS)): NUMBERS, frozenset((EMPTY, TEXTS)): TEXTS}
"""What holds both kinds; nothing goes with every kind."""

Rows = Callable[[], Iterable[Mapping[str, Any]]]


def write_result_table(path: Path, rows: Rows) -> int:
    """Write the rows as Parquet in one step, see write_bytes; return how many they are.

    rows() yields them anew each time: once for the types of the columns, once to write. Raises DeviceFailed.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds: dict[str, str] = {}
    for row in rows():
        for name, value in row.items():
            kinds[name] = _both(kinds.get(name, NOTHING), _kind(value))
    types = _types()
    schema = pa.schema([(name, types[kind]) for name, kind in kinds.items()])
    buffer, n = pa.BufferOutputStream(), 0
    with pq.ParquetWriter(buffer, schema, compression="zstd") as writer:
        for some in _some(rows()):
            columns = [
                pa.array([_value(row.get(name), kind) for row in some], type=types[kind])
                for name, kind in kinds.items()
            ]
            writer.write_table(pa.Table.from_arrays(columns, schema=schema))
            n += len(some)
    write_bytes(path, buffer.getvalue().to_pybytes())
    return n


def _some(rows: Iterable[Mapping[str, Any]]) -> Iterator[list[Mapping[str, Any]]]:
    rest = iter(rows)
    while some := list(islice(rest, ROWS)):
        yield some


def _types() -> Mapping[str, Any]:
    import pyarrow as pa

    text, number = pa.string(), pa.float64()
    lists = {EMPTY: pa.list_(pa.null()), NUMBERS: pa.list_(number), TEXTS: pa.list_(text)}
    return lists | {NOTHING: pa.null(), FLAG: pa.bool_(), WHOLE: pa.int64(), NUMBER: number, TEXT: text, JSON: text}


def _kind(value: Any) -> str:
    if isinstance(value, list):
        if not value:
            return EMPTY
        inner = {_kind(one) for one in value}
        return NUMBERS if inner <= {WHOLE, NUMBER, NOTHING} else TEXTS if inner == {TEXT} else JSON
    if isinstance(value, bool):
        return FLAG
    if isinstance(value, int):
        return WHOLE if -LARGEST <= value < LARGEST else NUMBER
    return (
        NOTHING if value is None else NUMBER if isinstance(value, float) else TEXT if isinstance(value, str) else JSON
    )


def _both(one: str, other: str) -> str:
    if one == other or other == NOTHING:
        return one
    return other if one == NOTHING else WIDER.get(frozenset((one, other)), JSON)


def _value(value: Any, kind: str) -> Any:
    if value is None:
        return None
    if kind == NUMBER:
        return float(value)
    if kind == NUMBERS:
        return [None if one is None else float(one) for one in value]
    if kind == JSON and not isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    return value
