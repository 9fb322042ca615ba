"""Files that others may have named: opened, where they are none that may never begin or end; and one process a device.

A device or a pipe is no file, since reading it may never begin or end. A second process at a device, or at a place of
results, is refused, by name of the first.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import stat
from collections.abc import Callable
from io import BufferedReader
from pathlib import Path
from types import TracebackType
from typing import Self

from armsight.errors import DeviceFailed, UsageError


class Files:
    """What writes a record's own kind of file: given by the public face, since records are below those that know."""

    save: Callable[[object, str | os.PathLike[str]], Path]
    plot: Callable[[object], object]


_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""A pipe that nobody writes into opens at once, to be refused, in place of never."""


def open_file(path: Path) -> BufferedReader:
    """Return the file, open for reading bytes. Raises OSError, also for a folder, a device, a pipe or a socket."""
    handle = os.open(path, _FLAGS)
    kind = os.fstat(handle).st_mode
    if stat.S_ISREG(kind):
        return os.fdopen(handle, "rb")
    os.close(handle)
    if stat.S_ISDIR(kind):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    raise OSError(errno.EINVAL, "it is a device or a pipe, not a file")


def read_file(path: Path, *, limit: int) -> bytes:
    """Return the file's content, up to limit + 1 bytes: one more tells that it is too large. Raises as open_file."""
    with open_file(path) as file:
        return file.read(limit + 1)


def real_path(path: Path) -> Path:
    """Return where links lead; those in a ring lead nowhere, which what opens them tells: resolve() would crash."""
    return Path(os.path.realpath(path))


def is_utf8(name: str) -> bool:
    """Tell whether OpenCV may be given this name of a file: at one that UTF-8 cannot hold it crashes."""
    return readable(name) == name


def readable(text: str) -> str:
    """Return text that UTF-8 can hold: names of files that the locale could not decode are, or lose their letters."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        with contextlib.suppress(UnicodeEncodeError):
            return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
        return text.encode("utf-8", "replace").decode("utf-8")
    return text


def arm_source(text: str, *, tip: str | None = None, base: str | None = None) -> str:
    """Return what load_arm takes for the chain from base to tip of a URDF; text itself where neither is named."""
    if tip is None and base is None:
        return text
    if source_parts(text) != (text, None, None):
        raise UsageError(
            f"{text!r} names its chain already", cure="Give --tip and --base, or FILE#BASE:TIP, but not both"
        )
    return f"{text}#{base}:{tip or ''}" if base is not None else f"{text}#{tip}"


def source_parts(text: str) -> tuple[str, str | None, str | None]:
    """Return file, base and tip of FILE, FILE#TIP or FILE#BASE:TIP; a file of that very name comes first."""
    file, mark, chain = text.rpartition("#")
    if not mark or Path(text).exists():
        return text, None, None
    base, colon, tip = chain.rpartition(":")
    return file, base if colon else None, tip or None


try:
    import fcntl
except ImportError:  # not on this system: its camera drivers refuse a second reader themselves
    fcntl = None  # type: ignore[assignment]


class DeviceLock:
    """Held while a device is open; the system lets go of it when the process ends, however it ends."""

    def __init__(
        self,
        device: str,
        *,
        folder: Path | None = None,
        key: str | None = None,
        consequence: str = "Two programs cannot read one camera: each would miss the other's frames",
        cure: str = "Stop the other program, or choose another camera",
    ) -> None:
        """folder: of the file that tells others, named by key where the device's name is no file's.

        consequence and cure: what a second holder is told.
        """
        self._device, self._key = device, key or device
        self._consequence, self._cure = consequence, cure
        from tempfile import gettempdir  # takes longer than all the rest of `import armsight`

        self._folder = folder or Path(gettempdir())
        self._file: int | None = None
        self._path = self._folder

    def __enter__(self) -> Self:
        """Take it. Raises DeviceFailed where another holder, in this process or another, has it."""
        if fcntl is None:
            return self
        plain = re.sub(r"[^A-Za-z0-9]+", "-", self._key).strip("-")
        path = self._folder / f"armsight-{plain}.lock"
        while True:
            try:
                # no link: in a folder that all may write to, somebody's could lead to a file that is emptied here
                file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
            except OSError:
                return self  # a folder that cannot be written must not keep anybody from their camera
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                holder = os.pread(file, 20, 0).decode("ascii", "replace").strip()
                os.close(file)
                raise DeviceFailed(
                    f"{self._device} is in use{f' by process {holder}' if holder.isdecimal() else ''}",
                    consequence=self._consequence,
                    cure=self._cure,
                ) from None
            if _is_at(path, file):
                break
            os.close(file)  # its holder took it away meanwhile: whoever comes next would make another
        os.ftruncate(file, 0)
        os.pwrite(file, str(os.getpid()).encode("ascii"), 0)
        self._file, self._path = file, path
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, 0)
                self._path.unlink()
            os.close(self._file)
            self._file = None


def _is_at(path: Path, file: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(file))
    except OSError:
        return False
