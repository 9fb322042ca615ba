"""Records that have a file of their own write themselves."""

from __future__ import annotations

from importlib import import_module
from os import PathLike
from pathlib import Path

from armsight.records.by_value import ByValue


class Saveable(ByValue):
    """A record with `save`. The writer is reached by name: records know of no files."""

    __slots__ = ()

    def save(self, path: str | PathLike[str]) -> Path:
        """Write the record's own kind of file (docs/file-formats.md), whole or not at all, and return its path.

        The ending decides: .yaml, of an arm also .urdf, of a path .csv. Raises UsageError for another ending or where
        there is no such folder, DeviceFailed.
        """
        file: Path = import_module("armsight.store.saving").save(self, path)
        return file
