"""Records that have a file of their own write themselves."""

from __future__ import annotations

from importlib import import_module
from os import PathLike


class Saveable:
    """A record with `save`. The writer is reached by name: records know of no files."""

    __slots__ = ()

    def save(self, path: str | PathLike[str]) -> None:
        """Write the record's own kind of file (docs/file-formats.md), whole or not at all. Raises DeviceFailed."""
        import_module("armsight.store.saving").save(self, path)
