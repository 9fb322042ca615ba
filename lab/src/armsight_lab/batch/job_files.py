"""Files that list the jobs of a batch: CSV with a row for each, or YAML."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from armsight.errors import BadFile
from armsight.store.atomic import read_bytes
from armsight.store.tables import bare, csv_rows
from armsight.store.yamls import parse_yaml

MAX_BYTES = 200_000_000
"""A million rows of paths."""
JOBS_FORMAT = "armsight/jobs"
TOP = ("format", "version", "defaults", "jobs")
NAME, COMMAND = "name", "command"


@dataclass(frozen=True, slots=True, kw_only=True)
class JobRow:
    """A job as the file has it. where: file and row. given: its other keys that are not empty, as written."""

    where: str
    name: str
    command: str
    given: Mapping[str, object]


def read_jobs(path: Path) -> list[JobRow]:
    """Return the jobs in a .csv, else in a YAML file. Raises BadFile, naming row and key."""
    return parse_jobs(read_bytes(path, limit=MAX_BYTES), str(path))


def parse_jobs(data: bytes, where: str) -> list[JobRow]:
    """Return the jobs in bytes of a file of this name. Raises BadFile, naming row and key."""
    rows = _csv_rows(data, where) if where.lower().endswith(".csv") else _yaml_rows(data, where)
    if not rows:
        raise BadFile(f"{where}: no job is in it", consequence="There is nothing to do", cure="Add a row for each job")
    return rows


def close_to(word: str, known: Sequence[str]) -> str:
    """Return ' (did you mean ...?)' where a known word is near, else nothing."""
    close = difflib.get_close_matches(word, known, n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def _csv_rows(data: bytes, where: str) -> list[JobRow]:
    header: list[str] = []
    rows = []
    for line, row in csv_rows(data, where):
        cells = [bare(cell.strip()) for cell in row]
        if header:
            rows.append(_csv_row(header, cells, f"{where}, line {line}"))
        else:
            header = _header(cells, where)
    if not header:
        raise BadFile(f"{where}: the file is empty", consequence="There is nothing to do", cure="Check the file")
    return rows


def _header(cells: list[str], where: str) -> list[str]:
    missing = [name for name in (NAME, COMMAND) if name not in cells]
    other = next((letter for letter in ";\t" if letter in cells[0]), "")
    if missing and other:
        raise BadFile(
            f"{where}: its columns stand apart by {'semicolons' if other == ';' else 'tabs'}, not commas",
            consequence="No job is begun",
            cure="Save it with commas: in a spreadsheet as CSV (comma separated), or with English number formats",
        )
    if missing:
        raise BadFile(
            f"{where}: the column {missing[0]} is missing; found {', '.join(cells)[:200]}",
            consequence="No job is begun",
            cure="The first line names the columns: name, command, and a flag in each of the others (rig, left, ...)",
        )
    twice = sorted({name for name in cells if name and cells.count(name) > 1})
    if twice or "" in cells:
        what = f"the column {twice[0][:40]!r} stands twice" if twice else "a column has no name"
        raise BadFile(f"{where}: {what}", consequence="No job is begun", cure="Give each column a name of its own")
    return cells


def _csv_row(header: list[str], cells: list[str], where: str) -> JobRow:
    if len(cells) != len(header):
        raise BadFile(
            f"{where}: {len(cells)} cells, the header has {len(header)}",
            consequence="No job is begun",
            cure="Give every row one cell per column; a cell with a comma stands in quotes",
        )
    row = dict(zip(header, cells, strict=True))
    return _job(row, where)


def _yaml_rows(data: bytes, where: str) -> list[JobRow]:
    content = parse_yaml(data, where)
    if content.get("format", JOBS_FORMAT) != JOBS_FORMAT:
        raise BadFile(
            f"{where}: says format {str(content['format'])[:60]!r}",
            consequence="No job is begun",
            cure=f"Give a file that begins with 'format: {JOBS_FORMAT}', or a .csv",
        )
    for key in content:
        if key not in TOP:
            raise BadFile(
                f"{where}: unknown key {key[:60]!r}{close_to(key, TOP)}",
                consequence="No job is begun",
                cure=f"Known are {', '.join(TOP)}",
            )
    if content.get("version", 1) != 1:
        raise BadFile(
            f"{where}: version {content['version']}", consequence="No job is begun", cure="This armsight knows 1"
        )
    defaults, jobs = content.get("defaults") or {}, content.get("jobs") or []
    if not isinstance(jobs, list) or not isinstance(defaults, dict):
        raise BadFile(
            f"{where}: `jobs` is no list, or `defaults` no mapping",
            consequence="No job is begun",
            cure="Write jobs: [{name: ..., command: ..., ...}, ...]",
        )
    return [_yaml_row(defaults, one, f"{where}, job {number}") for number, one in enumerate(jobs, 1)]


def _yaml_row(defaults: Mapping[str, Any], job: Any, where: str) -> JobRow:
    if not isinstance(job, dict):
        raise BadFile(
            f"{where}: {str(job)[:60]!r} is no mapping of keys to values",
            consequence="No job is begun",
            cure="Write {name: ..., command: ..., and the command's flags}",
        )
    row = {**defaults, **job}
    for key, value in row.items():
        values = value if isinstance(value, list) else [value]
        if any(isinstance(one, dict | list) for one in values):
            raise BadFile(
                f"{where}, key {key!r}: a flag has a value, or a list of values",
                consequence="No job is begun",
                cure="Write it as on the command line",
            )
    return _job(row, where)


def _job(row: Mapping[str, object], where: str) -> JobRow:
    for key in (NAME, COMMAND):
        if row.get(key) in (None, ""):
            raise BadFile(f"{where}: the job has no {key}", consequence="No job is begun", cure=f"Give it a {key}")
    given = {key: value for key, value in row.items() if key not in (NAME, COMMAND) and value not in (None, "", [])}
    return JobRow(where=where, name=str(row[NAME]), command=" ".join(str(row[COMMAND]).split()), given=given)
