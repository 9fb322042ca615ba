"""Many calls of one function, on all cores or a cluster, with a folder and a row of a table for each."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from armsight.errors import UsageError
from armsight.ops.arrays import as_path
from armsight.ops.checks import speaks_python
from armsight.ops.given import PathText
from armsight.records import Progress, require_kind
from armsight.records.output import extended, output
from armsight_lab.batch.cluster import Workers
from armsight_lab.batch.jobs import Ended, Job
from armsight_lab.batch.request import BatchJob
from armsight_lab.batch.results import BatchOutput
from armsight_lab.batch.run import run_batch

OUT = "out"


@output
class BatchResult(BatchOutput):
    """What `batch` did: how many jobs ended how, and `columns`, the table of all figures by name."""

    columns: dict[str, list[Any]]


@speaks_python(BatchJob)
def batch(
    function: Callable[..., Any],
    jobs: Mapping[str, Mapping[str, Any]],
    out: PathText,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> BatchResult:
    """Call function(**jobs[name]) for each name, on all cores, and put what it returns into one table.

    jobs: by name the arguments of each call: paths, texts, numbers and lists of them. A function that takes `out` gets
    the job's own folder, out/name. What it returns has to_dict (every result here does), is a dictionary of figures, or
    None. workers: processes, one for each core where not said; or scheduler, the address of Dask's. resume: keep what
    is done with the same arguments and the same content of the files that they name. The workers import the script that
    calls this: it stands below `if __name__ == "__main__":`. Raises UsageError, DeviceFailed; a call that is refused is
    a row.

    Examples
    --------
    >>> jobs = {f"seed-{seed}": {"scenario": "hand-cell", "frames": 1, "room": "dark", "seed": seed} for seed in (1, 2)}
    >>> done = armsight.batch(armsight.write_simulation, jobs, folder / "cells", workers=1)
    >>> done.statuses, done.columns["seed"]
    ({'done': 2}, [1, 2])
    """
    if not callable(function):
        raise UsageError(f"{function!r} is no function", consequence="Nothing was done", cure="Give armsight.measure")
    require_kind("jobs", jobs, Mapping, cure="Give {name: {argument: value}}")
    called = f"{getattr(function, '__module__', '')}.{getattr(function, '__qualname__', type(function).__name__)}"
    made = [_job(name, called, arguments) for name, arguments in jobs.items()]
    done = run_batch(
        made,
        as_path(out, OUT),
        partial(call, function),
        workers=Workers(n=workers, scheduler=scheduler),
        resume=resume,
        overwrite=overwrite,
        progress=progress,
    )
    import pyarrow.parquet as pq

    return extended(done, BatchResult, columns=pq.read_table(done.table).to_pydict())


def call(function: Callable[..., Any], job: Job, folder: Path) -> Ended:
    """Call a function with a job's arguments, in a worker."""
    given = dict(job.arguments)
    if OUT not in given and OUT in inspect.signature(function).parameters:
        given[OUT] = folder
    found = function(**given)
    figures = found.to_dict() if hasattr(found, "to_dict") else found
    if figures is not None and not isinstance(figures, Mapping):
        raise UsageError(
            f"the function returned a {type(figures).__name__}, no figures by name",
            consequence="The job has no row of figures",
            cure="Return a result, a dictionary, or None",
        )
    return Ended(figures=figures)


def _job(name: str, called: str, arguments: Mapping[str, Any]) -> Job:
    require_kind("name", name, str)
    require_kind(f"jobs[{name!r}]", arguments, Mapping, cure="Give {argument: value}")
    plain = {key: _plain(f"{key} of {name!r}", value) for key, value in arguments.items()}
    short = called.removeprefix("armsight.api.").removeprefix("armsight.ops.")
    return Job(name=name, command=short, arguments=plain, inputs=tuple(_texts(plain)))


def _plain(what: str, value: Any) -> Any:
    """Return an argument as a file can hold it. Raises UsageError for an object."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, PathLike):
        return fspath(value)
    if isinstance(value, list | tuple):
        return [_plain(what, one) for one in value]
    raise UsageError(
        f"{what} is a {type(value).__name__}, and jobs go to other processes as text",
        consequence="No job is begun",
        cure="Save it, and give the path of its file",
    )


def _texts(value: Any) -> list[str]:
    if isinstance(value, dict | list):
        return [text for one in (value.values() if isinstance(value, dict) else value) for text in _texts(one)]
    return [value] if isinstance(value, str) else []
