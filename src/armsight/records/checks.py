"""How a record takes an array: copied to float64, shape and finiteness checked, made read-only."""

from __future__ import annotations

from math import isfinite
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import Inconsistent

Record = TypeVar("Record")


def frozen_array(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """Return a read-only float64 copy of value; None in shape stands for any length.

    Raises Inconsistent, naming the field, where the shape differs or an entry is not finite.
    """
    array = np.array(value, dtype=np.float64)
    if array.shape != shape and (
        array.ndim != len(shape)
        or any(want is not None and have != want for have, want in zip(array.shape, shape, strict=True))
    ):
        wanted = ", ".join("n" if want is None else str(want) for want in shape)
        raise Inconsistent(f"{name} has shape {array.shape}, not ({wanted})", consequence="It cannot be used")
    if not (isfinite(np.vdot(array, array)) or np.isfinite(array).all()):  # the first is three times as fast
        raise Inconsistent(
            f"{name} holds a value that is not finite",
            consequence="It cannot be used",
            cure="Leave out what was not measured",
        )
    array.setflags(write=False)
    return array


def trusted(kind: type[Record], **fields: object) -> Record:
    """Return a record of all its fields, arrays neither copied nor checked but made read-only.

    For what was just computed and is used by nobody else: float64, of the right shape and finite by construction. In
    a loop of hundreds of frames a second the constructor's copies and checks cost as much as the measurement itself.
    """
    record = object.__new__(kind)
    for name, value in fields.items():
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
        object.__setattr__(record, name, value)
    return record
