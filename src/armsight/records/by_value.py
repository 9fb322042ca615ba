"""Records that are equal where their values are."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight._files import Files

MISSING = object()


class ByValue:
    """A record that `==` compares by value, bit for bit; `is_close`, where there is one, does with tolerances."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return self is other or (type(self) is type(other) and same_value(_content(self), _content(other)))

    def __hash__(self) -> int:
        return hash(type(self))  # arrays have none, and equal records must have one


def same_value(a: Any, b: Any) -> bool:
    """Return whether two values are of one type and equal throughout; NaN is equal to NaN."""
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return a.shape == b.shape and bool(((a == b) | ((a != a) & (b != b))).all())
    if isinstance(a, RigidTransform | Rotation):
        return bool(np.array_equal(a.as_matrix(), b.as_matrix()))
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(same_value(value, b[key]) for key, value in a.items())
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(same_value(x, y) for x, y in zip(a, b, strict=True))
    if hasattr(a, "__dataclass_fields__"):
        return same_value(_content(a), _content(b))
    return bool(a == b or (a != a and b != b))


def _content(record: Any) -> Mapping[str, Any]:
    """Return what a record was made of: not what was worked out from that."""
    known = getattr(record, "__dataclass_fields__", None)
    if known is None:
        return dict(vars(record))
    return {name: getattr(record, name, MISSING) for name, field in known.items() if field.init}


class Saveable(ByValue):
    """A record with `save`. Records know of no files and plots: `armsight/__init__.py` gives them what makes these."""

    __slots__ = ()

    def save(self, path: str | PathLike[str]) -> Path:
        """Write the record's own kind of file (docs/file-formats.md), whole or not at all, and return its path.

        The ending decides: .yaml, of an arm also .urdf or .mjcf, of a path .csv. Raises UsageError for another ending
        or where there is no such folder, DeviceFailed.
        """
        return Files.save(self, path)

    def plot(self) -> Any:
        """Return what there is to see of it as a plotly figure. Raises TypeError where there is nothing."""
        return Files.plot(self)
