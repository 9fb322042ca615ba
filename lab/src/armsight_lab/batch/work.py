"""What a worker does with a job: look whether it is done, claim it, run it, put its folder in place whole.

A job runs in OUT/.running/NAME~K, made before it begins and renamed to OUT/NAME when result.json is in it. The folders
that are left there tell how often it was begun and never ended, whoever's scheduler it is that sends it again.
"""

from __future__ import annotations

import errno
import os
import platform
import shutil
import tempfile
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from armsight._version import __version__
from armsight.errors import ArmsightError, DeviceFailed
from armsight.store.atomic import disk_errors
from armsight_lab.batch.jobs import FINAL, Ended, Execute, Job, Status, fingerprint
from armsight_lab.batch.results import JobResult, read_batch, read_job_result, write_job_result
from armsight_lab.history.place import without_password

RUNNING = ".running"
MOST_ATTEMPTS = 3
"""How often a job is begun. One that kills its worker each time is the cause more likely than chance."""
FULL = tuple(os.strerror(number) for number in (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where a batch works. out: absolute. shown: as the person wrote it. folder: that the command was called in."""

    out: Path
    shown: Path
    folder: Path
    batch: str
    version: str = __version__


class Finished(NamedTuple):
    """What a worker tells of a job: little, for the rest is in its result.json. spent_s: with hashing and looking."""

    name: str
    status: Status
    kept: bool
    spent_s: float
    cause: str


def run_group(execute: Execute, place: Place, jobs: Sequence[Job]) -> list[Finished]:
    """Run jobs one after the other in this process. Raises DeviceFailed where no further job could be done here."""
    _require_same(place)
    _use_one_thread()
    return [run_job(execute, place, job) for job in jobs]


def run_job(execute: Execute, place: Place, job: Job) -> Finished:
    """Run a job, unless it is done. Raises DeviceFailed where its result cannot be written."""
    start_s = time.perf_counter()
    if Path.cwd() != place.folder:
        os.chdir(place.folder)
    try:
        hashed = fingerprint(job)
    except (ArmsightError, OSError):  # an input that cannot be read is the job's own to refuse
        hashed = ""
    earlier = _done_before(place, job, hashed)
    if earlier is not None:
        kept = earlier.batch != place.batch  # else this job was done and its group was lost
        cause = earlier.error.cause if earlier.error else ""
        return Finished(job.name, Status(earlier.status), kept, time.perf_counter() - start_s, cause)
    try:
        result = _begun(execute, place, job, hashed)
    except DeviceFailed as error:
        raise _no_space(place, job) if _is_full(error.cause) else error from None
    cause = result.error.cause if result.error else ""
    return Finished(job.name, Status(result.status), False, time.perf_counter() - start_s, cause)


def _done_before(place: Place, job: Job, hashed: str) -> JobResult | None:
    """Return the result of a job that is done with the same inputs; None where it is to be done."""
    found = read_job_result(place.out / job.name)
    same = found is not None and hashed != "" and found.input_hash == hashed and found.status in FINAL
    return found if same else None


def _begun(execute: Execute, place: Place, job: Job, hashed: str) -> JobResult:
    """Run a job and put its folder in place."""
    with disk_errors(place.out):
        attempt, part = _claim(place.out, job.name)
    begun_s = time.perf_counter()
    killed = attempt > MOST_ATTEMPTS
    ended = _killed() if killed else _ended(execute, job, part)
    if (twin := _done_before(place, job, hashed)) is not None:  # of a worker that was taken for dead
        shutil.rmtree(part, ignore_errors=True)
        return twin
    if ended.error is not None and ended.exit_code == DeviceFailed.exit_code and _is_full(ended.error.cause):
        raise _no_space(place, job)
    result = JobResult(
        batch=place.batch,
        job=job.name,
        command=job.command,
        arguments={name: _without_passwords(value) for name, value in job.arguments.items()},
        status=Status.KILLED if killed else ended.status,
        exit_code=ended.exit_code,
        error=ended.error,
        result=ended.figures,
        said=ended.said,
        duration_s=time.perf_counter() - begun_s,
        attempts=min(attempt, MOST_ATTEMPTS),
        input_hash=hashed,
    )
    write_job_result(part, result, called=place.shown / job.name)
    with disk_errors(place.out / job.name):
        _put_in_place(place.out, part, job.name)
    return result


def _without_passwords(value: object) -> object:
    """Return a job's argument as its result.json may hold it, which others read: a history's URL has a password."""
    if isinstance(value, str):
        return without_password(value) if "://" in value else value
    if isinstance(value, Mapping):
        return {name: _without_passwords(one) for name, one in value.items()}
    return [_without_passwords(one) for one in value] if isinstance(value, list | tuple) else value


def _ended(execute: Execute, job: Job, part: Path) -> Ended:
    try:
        return execute(job, part)
    except ArmsightError as error:
        return Ended.of(error)
    except Exception as error:
        return unforeseen(error)


def unforeseen(error: Exception) -> Ended:
    """Return the end by something that armsight does not know, with the traceback in what was said."""
    first = (str(error).splitlines() or [""])[0]
    told = ArmsightError(
        f"armsight met something it does not know: {type(error).__name__}: {first}"[:300],
        cure="The details are in result.json of the job, under `said`",
    )
    return Ended.of(told, "".join(traceback.format_exception(error)))


def _killed() -> Ended:
    return Ended.of(
        DeviceFailed(
            f"the worker process ended each of the {MOST_ATTEMPTS} times that this job was begun",
            consequence="The job is left out",
            cure="Run it by itself and see how it ends; often the memory is too small: fewer workers at once (--jobs) "
            "leave more to each",
        )
    )


def _claim(out: Path, name: str) -> tuple[int, Path]:
    """Return how often the job was begun with this, and a new folder for it."""
    folder = out / RUNNING
    folder.mkdir(exist_ok=True)
    for attempt in range(1, MOST_ATTEMPTS + 1):
        try:
            part = folder / f"{name}~{attempt}"
            part.mkdir()
        except FileExistsError:
            continue
        return attempt, part
    return MOST_ATTEMPTS + 1, Path(tempfile.mkdtemp(prefix=f"{name}~", dir=folder))


def _put_in_place(out: Path, part: Path, name: str) -> None:
    """Rename the whole folder; what was there before goes, and so do folders of attempts that never ended."""
    final = out / name
    if final.exists():
        aside = Path(tempfile.mkdtemp(prefix=f"{name}~old-", dir=out / RUNNING))
        final.replace(aside / name)
        part.replace(final)
        shutil.rmtree(aside, ignore_errors=True)
    else:
        part.replace(final)
    for attempt in range(1, MOST_ATTEMPTS + 1):
        if (left := out / RUNNING / f"{name}~{attempt}").exists():
            shutil.rmtree(left, ignore_errors=True)


def _require_same(place: Place) -> None:
    """Raise DeviceFailed where this worker has other software, or does not see the batch's folder."""
    if place.version != __version__:
        raise DeviceFailed(
            f"a worker on {platform.node()} has armsight {__version__}, and the batch was begun by {place.version}",
            consequence="Its figures could be others; it was given nothing to do",
            cure="Install the same lock file for the scheduler and all workers",
        )
    seen = read_batch(place.out)
    if seen != place.batch or not place.folder.is_dir():
        missing = place.folder if seen == place.batch else place.out
        raise DeviceFailed(
            f"a worker on {platform.node()} does not see {missing}",
            consequence="Its results would be lost; it was given nothing to do",
            cure="Let all workers see the folders of inputs and results under the same names, on a shared disk",
        )


_set: list[bool] = []


def _use_one_thread() -> None:
    """Keep OpenCV to one thread in this process: there is one worker for each core."""
    if not _set:
        import cv2

        cv2.setNumThreads(1)
        _set.append(True)


def _is_full(cause: str) -> bool:
    return any(told in cause for told in FULL)


def _no_space(place: Place, job: Job) -> DeviceFailed:
    return DeviceFailed(
        f"{place.shown}: no space is left, at the job {job.name!r}",
        consequence="The jobs after it were not begun",
        cure="Make room, then give --resume",
    )
