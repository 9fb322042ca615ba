"""Opening files that others may have named: a device or a pipe is none, since reading it may never begin or end."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Callable
from io import BufferedReader
from pathlib import Path

from armsight.errors import UsageError


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
