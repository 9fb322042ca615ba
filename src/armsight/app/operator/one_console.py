"""One console for a folder: two would write over each other's calibrations, paths and settings."""

from __future__ import annotations

from pathlib import Path

from armsight.drivers.lock import DeviceLock
from armsight.store.atomic import disk_errors


def one_console(folder: Path) -> DeviceLock:
    """Return what a console holds while it serves a cell's folder, which is made where it is missing.

    Raises DeviceFailed where it cannot be made, and on entering where another console serves it.
    """
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return DeviceLock(
        "the console of this folder",
        folder=folder,
        consequence="Two consoles would write over each other's files; nothing is served",
        cure=f"Open the page of the other one, stop it, or choose another folder than {folder}",
    )
