"""A job of a batch, how it ended, what runs it, and the hash that tells whether it is still the same job."""

from __future__ import annotations

import fnmatch
import functools
import glob
import hashlib
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Protocol
from unicodedata import normalize

from armsight._version import __version__
from armsight.errors import ArmsightError, DataRefused, UsageError
from armsight.records.result_parts import Refusal
from armsight.store.atomic import json_text, sha256
from armsight_lab.batch.results import BATCH, RESULTS

LONGEST_NAME = 120
"""Letters of a job's name: folders' names may have 255 bytes, and a running job's has a few more."""
RESERVED = {"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))}
"""What Windows takes for a device, with any ending."""
_UNFIT = re.compile(r'[/\\:*?"<>|~\x00-\x1f\x7f]')


class Status(StrEnum):
    """How a job ended."""

    DONE = "done"
    DOUBTFUL = "doubtful"
    """Its results are written and not to be trusted, as the command itself says (exit code 3)."""
    REFUSED = "refused"
    """The data were refused (exit code 3)."""
    MISUSED = "misused"
    """The call itself is wrong (exit code 2)."""
    FAILED = "failed"
    """A camera, link or disk failed (4), or something unforeseen (1)."""
    KILLED = "killed"
    """Its worker ended under it, as often as a job may be begun."""


FINAL = (Status.DONE, Status.DOUBTFUL, Status.REFUSED)
"""What would end the same way again: --resume leaves it alone while inputs and arguments are the same."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """What one call of `execute` is told; it goes to a worker, so it is small and can be pickled.

    name: of its folder. command: for the table. arguments: plain numbers, texts, lists and dictionaries. inputs: what
    may be files, folders, patterns of files or bag:FILE:/topic; the content of those that are there counts.
    """

    name: str
    command: str
    arguments: Mapping[str, object] = field(default_factory=dict)
    inputs: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """How a call ended: its figures as the command's JSON object has them, or the error. said: to the person."""

    figures: Mapping[str, object] | None = None
    exit_code: int = 0
    error: Refusal | None = None
    said: str = ""

    @classmethod
    def of(cls, error: ArmsightError, said: str = "") -> Ended:
        """Return the end by an error."""
        told = Refusal(
            kind=type(error).__name__,
            cause=error.cause,
            consequence=error.consequence,
            cure=error.cure,
            exit_code=error.exit_code,
        )
        return cls(exit_code=error.exit_code, error=told, said=said)

    @property
    def status(self) -> Status:
        """How it ended, in a word."""
        if self.exit_code == 0:
            return Status.DONE
        if self.exit_code == DataRefused.exit_code:
            return Status.DOUBTFUL if self.error is None else Status.REFUSED
        return Status.MISUSED if self.exit_code == UsageError.exit_code else Status.FAILED


class Execute(Protocol):
    """What runs a job: a function of a module, or a partial of one, for workers import it by its name."""

    def __call__(self, job: Job, folder: Path) -> Ended:
        """Run it in this process, and write into the folder alone, which is there and empty.

        What it raises of ArmsightError is the job's end too; any other exception is told as unforeseen.
        """
        ...


def fingerprint(job: Job) -> str:
    """Return what tells this job from others: of its arguments, the content of its inputs, and the software."""
    told = json_text([__version__, job.command, job.arguments], indent=None)
    whole = hashlib.sha256(told.encode("utf-8"))
    for text in job.inputs:
        for path in input_files(text):
            whole.update(f"\0{text}\0{path.name}\0{_content(path)}".encode("utf-8", "surrogateescape"))
    return whole.hexdigest()


def input_files(text: str) -> Iterator[Path]:
    """Yield the files that an argument names: itself, those of a folder, those that fit a pattern, a bag's."""
    if text.startswith("bag:"):
        text = text.removeprefix("bag:").rpartition(":")[0]
    if "\0" in text or not text:
        return
    path = Path(text)
    found = sorted(path.iterdir()) if path.is_dir() else [path]
    if not os.path.lexists(path) and glob.has_magic(text):
        found = [Path(one) for one in sorted(glob.glob(text, recursive=True))]  # noqa: PTH207  absolute patterns as well
    yield from (one for one in found if one.is_file())


def _content(path: Path) -> str:
    told = path.stat()
    return _hash_of(str(path.absolute()), told.st_size, told.st_mtime_ns, told.st_ino)


@functools.lru_cache(maxsize=4096)
def _hash_of(path: str, *written: int) -> str:
    """Return a file's hash; jobs share rigs and targets, and often recordings."""
    return sha256(Path(path))


def check_names(jobs: Sequence[Job]) -> None:
    """Raise UsageError where there is no job, two have one name, or a name cannot be that of a folder."""
    if not jobs:
        raise UsageError("there is no job to do", consequence="Nothing was done", cure="Name at least one job")
    for number, job in enumerate(jobs, 1):
        if why := unfit(job.name):
            raise UsageError(
                f"job {number}: {job.name[:60]!r} {why}, and each job has a folder of its name",
                consequence="Nothing was done",
                cure="Name it with letters, digits, - and _",
            )
    folders = [normalize("NFC", job.name).casefold() for job in jobs]
    twice = [name for name, count in Counter(folders).items() if count > 1]
    if twice:
        same = [number for number, name in enumerate(folders, 1) if name == twice[0]]
        names = dict.fromkeys(jobs[number - 1].name for number in same)
        raise UsageError(
            f"the jobs {', '.join(map(str, same[:5]))} have the same name"
            f"{' on some disks' if len(names) > 1 else ''}, {' and '.join(map(repr, list(names)[:3]))}",
            consequence="One would write over the other; nothing was done",
            cure="Give each job its own name; with --each by --name, such as '{parent}-{name}'",
        )


def check_inputs(jobs: Sequence[Job], out: Path) -> None:
    """Raise UsageError where a job reads what a job of the same batch writes: jobs run in no order."""
    folder, names = os.path.realpath(out), [job.name for job in jobs]
    known = set(names)
    for job in jobs:
        for text in job.inputs:
            first = _first_below(folder, text)
            read = first in known or (glob.has_magic(first) and fnmatch.filter(names, first))
            if read:
                raise UsageError(
                    f"job {job.name!r} reads {text[:200]}, which a job of this batch writes",
                    consequence="Jobs run in no order, so it could read what an earlier batch left; nothing was done",
                    cure="Do it in a second batch with another folder (-o), when this one has ended",
                )


def _first_below(folder: str, text: str) -> str:
    """Return the first part of the path from folder to what an argument names, empty where it is not below it."""
    if text.startswith("bag:"):
        text = text.removeprefix("bag:").rpartition(":")[0]
    if "\0" in text or not text:
        return ""
    path = Path(os.path.realpath(text))
    return path.relative_to(folder).parts[0] if path != Path(folder) and path.is_relative_to(folder) else ""


def unfit(name: str) -> str:
    """Return why a name cannot be a job's, empty where it can."""
    if not name.strip():
        return "is no name"
    if found := _UNFIT.search(name):
        return f"holds {found[0]!r}, which no folder's name may on every system"
    if name != name.strip() or name[0] == "." or name[-1] == ".":
        return "begins or ends with a space or a dot"
    if name.partition(".")[0].lower() in RESERVED:
        return "is a device on Windows"
    if name in (RESULTS, BATCH):
        return "is a file of the batch itself"
    return "is too long" if len(name.encode("utf-8", "surrogateescape")) > LONGEST_NAME else ""
