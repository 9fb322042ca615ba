"""What a batch tells when it has ended."""

from __future__ import annotations

from typing import Annotated

from armsight.fields import Doc
from armsight.records.output import Output, output


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
