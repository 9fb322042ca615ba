"""Whole files at once, or not at all; tables that are readable at any moment while they grow; and places of results.

A place of results is one that is a file or a folder, with one writer at a time, and earlier results are put aside.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import shutil
import stat
import sys
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator, Mapping
from io import FileIO
from pathlib import Path
from typing import Any, Self

import numpy as np

from armsight._files import DeviceLock, open_file, read_file, readable, real_path
from armsight.clock import Clock, SystemClock
from armsight.errors import BadFile, DeviceFailed, UsageError
from armsight.records.output import Output, finite, output

STREAM = Path("-")
"""The standard output, in place of a file."""

FLUSH_S = 1.0
"""Longest time that a measured row waits in memory: what a crash may cost."""

FLUSH_ROWS = 500
"""Most rows that wait in memory; below it the system call's cost does not show beside the formatting."""


@contextlib.contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn the system's refusal to write into DeviceFailed."""
    try:
        yield
    except OSError as error:
        raise DeviceFailed(
            f"{path}: cannot be written ({error.strerror or error})",
            consequence="The file is as it was before",
            cure="Check the folder, its permissions and the free space, or choose another place",
        ) from error


def read_bytes(path: Path, *, limit: int) -> bytes:
    """Return the file's content; BadFile where it cannot be read or holds more than limit bytes."""
    try:
        data = read_file(path, limit=limit)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise BadFile(
            f"{path}: cannot be read ({reason})", consequence="Nothing was done", cure="Check the path"
        ) from error
    if len(data) > limit:
        raise BadFile(
            f"{path}: larger than {limit / 1e6:g} MB, which no file of this kind is",
            cure="Check that this is the file you meant",
        )
    return data


def write_bytes(path: Path, data: bytes) -> None:
    """Replace the file's content in one step: a crash leaves the old file or the new one, never half of one.

    Makes the folder where it is missing. A link stays, and the file that it leads to is replaced; a device such as
    /dev/null, a pipe, or STREAM is written to and never replaced. Raises DeviceFailed where the disk refuses.
    """
    with disk_errors(path):
        if path == STREAM:
            sys.stdout.buffer.write(data)
            sys.stdout.buffer.flush()
            return
        if path.exists() and not path.is_file():
            _write_into(path, data)
            return
        path = Path(os.path.realpath(path)) if path.is_symlink() else path
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            Path(name).chmod(_mode_of(path))
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
        _sync_folder(path.parent)


def _write_into(path: Path, data: bytes) -> None:
    """Write to a character device or a pipe. Raises OSError for all else, and where nobody reads the pipe."""
    if stat.S_ISBLK(path.stat().st_mode):
        raise OSError(errno.EINVAL, "it is a disk, not a file")
    handle = os.open(path, os.O_WRONLY | getattr(os, "O_NONBLOCK", 0))
    with os.fdopen(handle, "wb", buffering=0) as file:
        os.set_blocking(handle, True)
        rest = memoryview(data)
        while rest:
            rest = rest[file.write(rest) :]


def write_text(path: Path, text: str) -> None:
    """Replace the file's content with UTF-8 text in one step; see write_bytes."""
    write_bytes(path, readable(text).encode("utf-8"))


def _mode_of(path: Path) -> int:
    """Permissions of the file that is replaced, or of a new one under the person's umask."""
    if path.exists():
        return path.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask


def _sync_folder(folder: Path) -> None:
    """Make the new name itself survive a power cut, where the system lets a folder be synced."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def plain(value: Any) -> Any:
    """Return value with arrays, numpy scalars, tuples and paths turned into what JSON and YAML know."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return value.as_posix()
    return value


def json_text(value: Any, *, indent: int | None = 2) -> str:
    """Return value as strict JSON text; a number that is not finite (no data) becomes null."""
    return readable(json.dumps(finite(plain(value)), indent=indent, ensure_ascii=False, allow_nan=False))


def write_json(path: Path, value: Any) -> None:
    """Replace the file with value as JSON; see json_text and write_bytes."""
    write_text(path, json_text(value) + "\n")


def sha256(path: Path) -> str:
    """Return the SHA-256 of the file's content in hexadecimal; BadFile where it cannot be read."""
    try:
        with open_file(path) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise BadFile(f"{path}: cannot be read ({error.strerror or error})", cure="Check the path") from error


class Closing(ABC):
    """What `with` closes."""

    @abstractmethod
    def close(self) -> None:
        """Close it; a second call does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class RowFile(Closing):
    """A text file that grows row by row and holds whole rows at any moment.

    Rows wait in memory for at most FLUSH_S seconds or FLUSH_ROWS rows and then go to the system in one write. The
    header is written at once. Use it as a context manager; closing writes what waits and syncs the disk.
    """

    def __init__(self, path: Path, header: str, *, clock: Clock | None = None) -> None:
        self._path = path
        self._clock = clock or SystemClock()
        self._rows: list[str] = []
        with disk_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = FileIO(path, "w")
        self._flushed_s = self._clock.now_s()
        self.add(header)
        self.flush()

    def add(self, row: str) -> None:
        """Take one row without its line end."""
        self._rows.append(row)
        if len(self._rows) >= FLUSH_ROWS or self._clock.now_s() - self._flushed_s >= FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Give the waiting rows to the system."""
        if self._rows:
            data = (readable("\n".join(self._rows)) + "\n").encode("utf-8")
            with disk_errors(self._path):
                while data:
                    data = data[self._file.write(data) :]
            self._rows.clear()
        self._flushed_s = self._clock.now_s()

    def close(self) -> None:
        """Write what waits, sync the disk, close; a second call does nothing."""
        if self._file.closed:
            return
        try:
            self.flush()
            with disk_errors(self._path):
                os.fsync(self._file.fileno())
        finally:
            self._file.close()


@output
class TextOutput(Output):
    """A result whose file is text, its content."""

    content: str = ""

    def write(self, path: Path) -> None:
        """Write the file."""
        write_text(path, self.content)


@contextlib.contextmanager
def held_outputs(outs: Iterable[Path]) -> Iterator[None]:
    """Hold the places that results go to: two writers at once would mix them, and both say done.

    Raises UsageError for a place that is no file or folder, DeviceFailed where another writes there.
    """
    with contextlib.ExitStack() as held:
        for out in dict.fromkeys(outs):
            refuse_output(out)
            held.enter_context(_written_once(out))
        yield


def refuse_output(out: Path) -> None:
    """Raise UsageError for a device, a pipe, a link to a file in another folder, and the standard output."""
    why = ""
    if out == STREAM:
        why = "- is the standard output, which cannot hold what is written here"
    elif out.exists() and not (out.is_file() or out.is_dir()):
        why = f"{out} is a device or a pipe"
    elif out.is_symlink() and not out.is_dir():
        leads = Path(os.path.realpath(out))
        if leads.parent != Path(os.path.realpath(out.parent)):
            why = f"{out} is a link out of its folder, to {leads}"
    if why:
        raise UsageError(why, cure="Give a file or a folder (-o)")


def _written_once(out: Path) -> DeviceLock:
    path_bytes = os.fsencode(real_path(out))
    return DeviceLock(
        str(out),
        key=f"results-{hashlib.sha256(path_bytes).hexdigest()[:32]}",
        consequence="Another command is writing its results there; nothing was done",
        cure="Wait for its end, or give another place (-o)",
    )


ASIDE = ".armsight-earlier-"
SHOWN = 4
FAILED = "failed"
"""In the folder of the earlier results: what a run left that failed while it was to replace them."""


class EarlierResults:
    """Results of an earlier run with these names in a folder, put aside while a new run writes there.

    `put_back` brings them back in place of what the new run left, `settle` deletes them. Names are of files or folders.
    """

    def __init__(self, folder: Path, names: Collection[str]) -> None:
        """Put aside what is there. Raises DeviceFailed where the disk refuses."""
        self._folder, self._names = folder, tuple(names)
        self._aside: Path | None = None
        there = found(folder, names)
        if not there:
            return
        with disk_errors(folder):
            self._aside = Path(tempfile.mkdtemp(prefix=ASIDE, dir=folder))
            for name in there:
                (folder / name).replace(self._aside / name)

    def put_back(self) -> Path | None:
        """Bring the earlier results back; what the new run left under these names goes into FAILED.

        Return that folder; None where it left nothing, or there were no earlier ones and it stays where it is.
        """
        if self._aside is None:
            return None
        new, failed = found(self._folder, self._names), self._folder / FAILED
        with disk_errors(self._folder):
            if new and os.path.lexists(failed):
                _remove(failed)
            for name in new:
                failed.mkdir(exist_ok=True)
                (self._folder / name).replace(failed / name)
            for path in self._aside.iterdir():
                path.replace(self._folder / path.name)
            self._aside.rmdir()
        self._aside = None
        return failed if new else None

    def settle(self) -> None:
        """Delete the earlier results where the new run left any, else bring them back."""
        if self._aside is not None and found(self._folder, self._names):
            with contextlib.suppress(OSError):  # what stays in there is hidden, and in nobody's way
                shutil.rmtree(self._aside)
            self._aside = None
        self.put_back()


def found(folder: Path, names: Collection[str]) -> tuple[str, ...]:
    """Return which names are in a folder, in the order given."""
    return tuple(name for name in names if os.path.lexists(folder / name))


def refuse_earlier(folder: Path, names: Collection[str]) -> None:
    """Raise UsageError where a folder holds results with these names."""
    there = found(folder, names)
    if not there:
        return
    more = f" and {len(there) - SHOWN} more" if len(there) > SHOWN else ""
    raise UsageError(
        f"{folder} holds results of another run: {', '.join(there[:SHOWN])}{more}",
        consequence="They are left as they are, and nothing was done",
        cure="Give another folder (-o), or --overwrite to replace them",
    )


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()
