"""A batch of jobs from its first to its table: handed out in groups, few at a time, so that memory does not grow."""

from __future__ import annotations

import contextlib
import os
import queue
import shutil
import time
import uuid
from asyncio import CancelledError
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from armsight.errors import ArmsightError, Cancelled, DeviceFailed, UsageError
from armsight.records import Progress, Silent
from armsight.store.atomic import disk_errors
from armsight_lab.batch.cluster import Workers, connected
from armsight_lab.batch.jobs import Execute, Job, Status, check_inputs, check_names
from armsight_lab.batch.results import (
    BATCH,
    RESULT,
    RESULTS,
    BatchOutput,
    NotDone,
    rows_of,
    write_batch,
    write_result_table,
)
from armsight_lab.batch.work import RUNNING, Finished, Place, run_group

if TYPE_CHECKING:
    from distributed import Client, Future

GROUP_S = 0.5
"""Work that is sent at once: Dask takes a millisecond or more for each thing that it sends."""
SEND_S = 0.005
"""Of each worker, that much more work is sent at once: groups end no oftener than one in 5 ms, however many work."""
MOST_IN_GROUP = 500
SHARES = 4
"""Groups are so small that each worker still gets as many of what is left: the last ones end together."""
AHEAD = 2
"""Groups on their way for each worker: one that it does and one that waits, so that it never does."""
LOOKS_S = 0.25
"""How often it is looked whether the person wants it to stop, and whether workers came or went."""
FIRST_TABLE = 1000
"""Finished jobs after which the table is first written, and then whenever twice as many are: all its writing costs no
more than a few times the last one."""
MOST_LOST = 20
"""Groups lost one after the other, with nothing finished between: more is no accident of one job."""
SHOWN = 20


def run_batch(
    jobs: Sequence[Job],
    out: Path,
    execute: Execute,
    *,
    workers: Workers | None = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> BatchOutput:
    """Run every job on some worker; return how they ended. Their results are OUT/<name>/ and OUT/results.parquet.

    execute(job, folder) runs one job in a worker's process and writes into the folder alone, which becomes
    OUT/<job.name>; it returns an Ended(figures=...) or raises an ArmsightError, and is a function of a module (workers
    import it) or a functools.partial of one. figures are plain (numbers, texts, lists, dictionaries): they become
    columns `a.b.c` of the table.

    workers: by default one process of one thread for each core. resume: keep what OUT holds of jobs whose arguments
    and inputs are the same. overwrite: remove an earlier batch's results first. One process at a time may write to OUT:
    callers hold it (store.outputs.held_outputs), as every command does its -o.

    Raises UsageError for jobs or an OUT that cannot be, DeviceFailed where workers or disk fail, Cancelled; what is
    finished by then is kept, and in the table.
    """
    check_names(jobs)
    check_inputs(jobs, out)
    _require_free(out, resume=resume, overwrite=overwrite)
    start_s, workers, progress = time.perf_counter(), workers or Workers(), progress or Silent()
    progress.update(0, len(jobs), BEGINNING)
    try:
        with connected(workers) as client:
            place = _begin(out, len(jobs), overwrite=overwrite)
            done = _HandOut(
                client, partial(run_group, execute, place), jobs, progress, partial(_write_table, out, jobs)
            )
            done.run_all(out)
    finally:
        if workers.scheduler is None:  # elsewhere what was begun may still be on its way
            shutil.rmtree(out / RUNNING, ignore_errors=True)
    shutil.rmtree(out / RUNNING, ignore_errors=True)
    _write_table(out, jobs)
    return done.told(time.perf_counter() - start_s, str(out / RESULTS))


BEGINNING = "starting workers"
WAITING = "waiting for workers"


@dataclass
class _HandOut:
    """The jobs that are on their way, and what is known of those that are not any more."""

    client: Client
    work: partial[list[Finished]]
    jobs: Sequence[Job]
    progress: Progress
    write_table: Callable[[], int]
    counts: Counter[Status] = field(default_factory=Counter)
    not_done: list[NotDone] = field(default_factory=list)
    n_kept: int = 0
    most_workers: int = 0

    def __post_init__(self) -> None:
        self._left: Iterator[Job] = iter(self.jobs)
        self._again: list[tuple[Job, ...]] = []
        self._sent: dict[Future[Any], tuple[Job, ...]] = {}
        self._ended: queue.SimpleQueue[Future[Any]] = queue.SimpleQueue()
        self._spent_s, self._n_spent, self._lost = 0.0, 0, 0
        self._begun, self._done = 0, 0
        self._next_table, self._looked_s, self._threads = FIRST_TABLE, float("-inf"), 1

    def run_all(self, out: Path) -> None:
        """Hand out and take in until all is done. Raises Cancelled, DeviceFailed, which tell what is kept in out."""
        try:
            self._run()
        except ArmsightError as error:
            try:
                n, table = self.write_table(), f", with {RESULTS}"
            except DeviceFailed:  # for the same reason as what came before; --resume writes it
                n, table = self._done, ""
            kept = f"{n} of {len(self.jobs)} jobs are finished and kept in {out}{table}"
            error.consequence = ". ".join(part.rstrip(".") for part in (error.consequence, kept) if part)
            error.cure = error.cure or "Give --resume to do the rest"
            raise
        finally:
            with contextlib.suppress(Exception):  # a scheduler that is lost needs no asking
                self.client.cancel(list(self._sent), force=True)
            self._sent.clear()

    def told(self, duration_s: float, table: str) -> BatchOutput:
        """Return how the jobs ended."""
        return BatchOutput(
            n=len(self.jobs),
            statuses={status.value: self.counts[status] for status in Status if self.counts[status]},
            n_kept=self.n_kept,
            not_done=self.not_done,
            duration_s=duration_s,
            n_workers=self.most_workers,
            table=table,
        )

    def _run(self) -> None:
        while self._fill():
            with contextlib.suppress(queue.Empty):
                self._take(self._ended.get(timeout=LOOKS_S))
            self.progress.update(self._done, len(self.jobs), "" if self._threads else WAITING)
            if self.progress.cancelled():
                raise Cancelled(f"stopped after {self._done} of {len(self.jobs)} jobs")
            if self._done >= self._next_table:
                self._next_table = 2 * max(self.write_table(), self._done)

    def _fill(self) -> bool:
        """Send groups up to what the workers there are can take; tell whether any is on its way."""
        self._look()
        while len(self._sent) < AHEAD * max(self._threads, 1) and (group := self._next()):
            future = self.client.submit(self.work, group, pure=False, key=f"group-{uuid.uuid4().hex}")
            self._sent[future] = group
            future.add_done_callback(self._ended.put)
        return bool(self._sent)

    def _look(self) -> None:
        """See how many workers there are."""
        now_s = time.monotonic()
        if now_s - self._looked_s < LOOKS_S:
            return
        self._looked_s = now_s
        try:
            self._threads = sum(self.client.nthreads().values())
        except Exception as error:
            raise _scheduler_lost(error) from error
        self.most_workers = max(self.most_workers, self._threads)

    def _next(self) -> tuple[Job, ...]:
        if self._again:
            return self._again.pop()
        mean_s = self._spent_s / self._n_spent if self._n_spent else GROUP_S
        fair = (len(self.jobs) - self._begun) // (SHARES * max(self._threads, 1))
        group_s = max(GROUP_S, SEND_S * self._threads)
        size = max(1, min(int(group_s / max(mean_s, 1e-6)), MOST_IN_GROUP, fair))
        group = tuple(job for _, job in zip(range(size), self._left, strict=False))
        self._begun += len(group)
        return group

    def _take(self, future: Future[Any]) -> None:
        group = self._sent.pop(future, ())
        if not group:
            return
        try:
            found: list[Finished] = future.result()
        except ArmsightError:
            raise
        except CancelledError as error:
            raise _scheduler_lost(error) from error
        except Exception as error:
            self._lose(group, error)
            return
        finally:
            future.release()
        self._lost = 0
        for one in found:
            self._count(one)

    def _lose(self, group: tuple[Job, ...], error: BaseException) -> None:
        """Send the jobs of a lost group again, each by itself: the claims on the disk tell whose fault it was."""
        self._lost += 1
        if type(error).__name__ != "KilledWorker" or self._lost > MOST_LOST:
            raise DeviceFailed(
                f"the workers cannot do their work: {type(error).__name__}: {' '.join(str(error).split())[:200]}",
                consequence="The jobs that are not finished are left",
                cure="Check that armsight is installed alike on all workers",
            ) from error
        self._again += [(job,) for job in group]

    def _count(self, one: Finished) -> None:
        self._done += 1
        self.counts[one.status] += 1
        self.n_kept += one.kept
        self._spent_s, self._n_spent = self._spent_s + one.spent_s, self._n_spent + 1
        if one.status is not Status.DONE and len(self.not_done) < SHOWN:
            self.not_done.append(NotDone(job=one.name, status=one.status.value, cause=one.cause))


def _scheduler_lost(error: BaseException | None) -> DeviceFailed:
    return DeviceFailed(
        f"the scheduler was lost ({' '.join(str(error).split())[:120] or type(error).__name__})",
        consequence="The jobs that are not finished are left",
        cure="Begin it again, then give --resume",
    )


def _require_free(out: Path, *, resume: bool, overwrite: bool) -> None:
    """Raise UsageError where OUT is no place for this batch."""
    if resume and overwrite:
        raise UsageError("--resume keeps what is there, and --overwrite removes it", cure="Give one of them")
    if out.exists() and not out.is_dir():
        raise UsageError(f"{out} is a file", consequence="Nothing was done", cure="Give a folder (-o)")
    there = out.is_dir() and any(out.iterdir())
    if not there or resume or overwrite:
        if there and not (out / BATCH).is_file():
            raise UsageError(
                f"{out} holds other things than a batch's results",
                consequence="They are left as they are, and nothing was done",
                cure="Give another folder (-o)",
            )
        return
    raise UsageError(
        f"{out} holds results of another {'batch' if (out / BATCH).is_file() else 'run'}",
        consequence="They are left as they are, and nothing was done",
        cure="Give another folder (-o); --resume to do what is missing there, or --overwrite to replace them",
    )


def _begin(out: Path, n_jobs: int, *, overwrite: bool) -> Place:
    """Make OUT this batch's own; what an earlier one left half done goes."""
    with disk_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(out / RUNNING, ignore_errors=True)
        if overwrite:
            _remove_results(out)
        (out / RUNNING).mkdir(exist_ok=True)
    place = Place(out=out.absolute(), shown=out, folder=Path.cwd(), batch=uuid.uuid4().hex)
    write_batch(out, place.batch, n_jobs)
    return place


def _remove_results(out: Path) -> None:
    """Remove the folders and the table of an earlier batch, and nothing else."""
    (out / RESULTS).unlink(missing_ok=True)
    with os.scandir(out) as entries:
        earlier = [Path(one.path) for one in entries if one.is_dir(follow_symlinks=False)]
    for folder in earlier:
        if (folder / RESULT).is_file():
            shutil.rmtree(folder)


def _write_table(out: Path, jobs: Sequence[Job]) -> int:
    """Write the table of what is finished; return how many jobs that is."""
    return write_result_table(out / RESULTS, partial(rows_of, out, [job.name for job in jobs]))
