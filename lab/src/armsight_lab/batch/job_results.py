"""The files of a batch: result.json of each job, batch.json of the whole, and the rows that its table has."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from armsight._version import __version__
from armsight.records.result_parts import Refusal
from armsight.store.atomic import write_json

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
