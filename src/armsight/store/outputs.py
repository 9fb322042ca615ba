"""A place that results are written to: none that is no file, and no two writers at once."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from armsight._files import real_path
from armsight.drivers.lock import DeviceLock
from armsight.errors import UsageError
from armsight.records.output import Output, output
from armsight.store.atomic import STREAM, write_text


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
