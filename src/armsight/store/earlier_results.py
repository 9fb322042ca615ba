"""The results of an earlier run in a folder: refused, or put aside until the new ones are there."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Collection
from pathlib import Path

from armsight.errors import UsageError
from armsight.store.atomic import disk_errors

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
