"""armsight batch."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from armsight.cli.command import NOT_TO_BE_TRUSTED, declared
from armsight.cli.command_ui import CommandUI
from armsight.errors import DeviceFailed, UsageError
from armsight_lab.batch.request import NAMED, BatchJob

if TYPE_CHECKING:
    from armsight_lab.batch.jobs import Job
    from armsight_lab.batch.results import BatchOutput

SHOWN = 8


@declared()
def batch(face: CommandUI, job: BatchJob) -> None:
    """Run many measure, verify, identify, simulate, calibrate or kinematics commands, on all cores or a Dask cluster.

    Writes a folder for each job and results.parquet, a row for each with all its figures. Exit code 3 where some were
    refused or are doubtful, 4 where some failed.
    """
    from armsight_lab.batch.cluster import Workers, compile_for
    from armsight_lab.batch.run import run_batch
    from armsight_lab.cli.batch_commands import run_command

    workers = Workers(n=job.workers, scheduler=job.scheduler)
    listed, progress = _listed(job), face.progress("batch")
    if job.scheduler is None:
        compile_for({one.command for one in listed}, progress)
    done = run_batch(
        listed,
        job.out,
        run_command,
        workers=workers,
        resume=job.resume,
        overwrite=job.overwrite,
        progress=progress,
    )
    _tell(face, done)
    _tell_unfiled(face, [job.out / one.name for one in listed])
    face.result(done)
    if {"failed", "killed"} & set(done.statuses):
        raise typer.Exit(DeviceFailed.exit_code)
    if set(done.statuses) - {"done"}:
        raise typer.Exit(NOT_TO_BE_TRUSTED)


def _listed(job: BatchJob) -> list[Job]:
    """Return the jobs that are asked for. Raises UsageError, DataRefused."""
    from armsight.config import load_settings
    from armsight_lab.cli.batch_jobs import jobs_of_file, jobs_of_pattern

    settings = load_settings().model_dump(include={"fps", "max_skew_s"})
    words = job.jobs or []
    if job.each is None:
        if len(words) == 1 and job.named == NAMED:
            return jobs_of_file(Path(words[0]), settings)
        said = "--name is for --each" if len(words) == 1 else f"{len(words)} files of jobs were given" if words else ""
        raise UsageError(
            said or "no jobs were given",
            consequence="Nothing was done",
            cure="Give one jobs.csv or jobs.yaml; or --each 'recordings/*.mcap' -o OUT -- measure --left {} ...",
        )
    if not words:
        raise UsageError(
            "--each has no command", consequence="Nothing was done", cure="Write it after --: -- measure --left {} ..."
        )
    return jobs_of_pattern(job.each, job.named, words, settings)


def _tell(face: CommandUI, done: BatchOutput) -> None:
    counts = ", ".join(f"{count} {status}" for status, count in done.statuses.items())
    kept = f"; {done.n_kept} were done before" if done.n_kept else ""
    face.say(f"{done.n} jobs on {done.n_workers} workers in {done.duration_s:.1f} s: {counts}{kept}")
    for one in done.not_done[:SHOWN]:
        face.say(f"  {one.job}: {one.status}{f', {one.cause}' if one.cause else ''}")
    more = done.n - done.statuses.get("done", 0) - min(len(done.not_done), SHOWN)
    if more > 0:
        face.say(f"  ... and {more} more, in the table")
    face.say(f"Results: {done.table}")


def _tell_unfiled(face: CommandUI, folders: Iterable[Path]) -> None:
    """Say which results wait for being filed: the jobs themselves are done, and nobody saw what they said."""
    waiting = [path for folder in folders for path in sorted(folder.glob("*.unfiled*.json"))]
    if waiting:
        face.say(f"NOT FILED in the history: {len(waiting)} results, such as {waiting[0]}")
        face.say(f"  why is in its result.json, under `said`; file each later: armsight history add {waiting[0]}")
