"""One process per device: a second one is refused, by name of the first."""

from __future__ import annotations

import contextlib
import os
import re
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Self

from armsight.errors import DeviceFailed

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
        self._folder = folder or Path(tempfile.gettempdir())
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
