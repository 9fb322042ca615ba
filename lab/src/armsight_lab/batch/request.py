"""What `armsight batch` is told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from armsight.fields import Bounds, Doc, Flag
from armsight.ops.flags import OutFolder

NAMED = "{name}"


@dataclass(frozen=True, kw_only=True)
class BatchJob:
    """Jobs of a file, or, with each, a command for each file that fits; and who does them: workers or scheduler."""

    jobs: Annotated[
        list[str] | None,
        Doc("jobs.csv or jobs.yaml, a row for each job; with --each, after --, the command and its flags."),
        Flag(positional=True, metavar="JOBS"),
    ] = None
    out: OutFolder
    each: Annotated[
        str | None, Doc("A job for each file or folder that fits; {} in the command is its path."), Flag(metavar="GLOB")
    ] = None
    named: Annotated[
        str, Doc("With --each: the jobs' names; {name}, {parent} and {number} are the file's."), Flag("--name")
    ] = NAMED
    workers: Annotated[
        int | None,
        Doc("Jobs done at once, by a process each. [default: one for each core]"),
        Bounds(least=1),
        Flag("--jobs"),
    ] = None
    scheduler: Annotated[
        str | None, Doc("Instead: the workers of this Dask scheduler."), Flag(metavar="tcp://HOST:8786")
    ] = None
    resume: Annotated[bool, Doc("Keep what is done with the same inputs and flags; do the rest.")] = False
    overwrite: Annotated[bool, Doc("Remove the results of another batch in the folder first.")] = False
