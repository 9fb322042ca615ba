"""Places that results are written to: none that is no file, no two writers at once, and earlier results put aside."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import tempfile
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

from armsight._files import real_path
from armsight.drivers.lock import DeviceLock
from armsight.errors import UsageError
from armsight.records.output import Output, output
from armsight.store.atomic import STREAM, disk_errors, write_text


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
        raise UsageError(why, consequence="Nothing was done", cure="Give a file or a folder (-o)")


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
