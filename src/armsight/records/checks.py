"""What callers hand over, checked before a record keeps it or compiled code reads it: numbers, shape, finiteness, kind.

Compiled code checks no index: an array of another shape makes it read, and write, what lies beside.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from math import isfinite
from numbers import Integral, Real
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from numpy import ndarray
from numpy.typing import ArrayLike, NDArray

from armsight.errors import Inconsistent, UsageError, not_one_of
from armsight.fields import Bounds

Record = TypeVar("Record")
Choice = TypeVar("Choice", bound=StrEnum)


FLOAT64 = np.dtype(np.float64)

Dimensions = tuple[int | None, ...]
"""Lengths of the axes, None for any."""

REAL = "iuf"
"""numpy's kinds of real numbers; truth values, texts and objects are none, however numpy would convert them."""

ROTATION_TOLERANCE = 1e-3
"""Rotation matrices further from orthonormal than this (largest entry of R^T R - I) are refused: not rounding."""


def frozen_array(name: str, value: ArrayLike, shape: Dimensions) -> NDArray[np.float64]:
    """Return a read-only float64 copy of value; None in shape stands for any length.

    Raises Inconsistent, naming the field, where it is no numbers, the shape differs or an entry is not finite.
    """
    array = np.array(real_array(name, value))
    _require_shape(name, array, shape)
    _require_finite(name, array)
    array.setflags(write=False)
    return array


def freeze(record: object, **shapes: Dimensions) -> None:
    """Keep read-only copies of a frozen record's arrays, by their names; raises as frozen_array."""
    for name, shape in shapes.items():
        object.__setattr__(record, name, frozen_array(name, getattr(record, name), shape))


def checked_array(name: str, value: ArrayLike, shape: Dimensions, *, nan: bool = False) -> NDArray[np.float64]:
    """Return value as C-contiguous float64 for compiled code, not copied where it can be; raises as frozen_array.

    nan: entries may be NaN (never infinite), for functions whose answer is then NaN in that row.
    """
    array = for_kernels(real_array(name, value))
    _require_shape(name, array, shape)
    _require_finite(name, array, nan=nan)
    return array


def for_kernels(array: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the array as compiled code takes it, copied only where it must be: contiguous and writeable.

    A read-only or strided array is another type to numba, which would compile anew for it: seconds.
    """
    flags = array.flags
    return array if flags.c_contiguous and flags.writeable else array.copy()


def checked_rows(name: str, value: ArrayLike, columns: int, *, nan: bool = False) -> NDArray[np.float64]:
    """Return one row (columns,) or many (n, columns) as (n, columns); see checked_array."""
    array = real_array(name, value)
    return checked_array(name, array[None] if array.shape == (columns,) else array, (None, columns), nan=nan)


def require_kind(name: str, value: object, *kinds: type, cure: str = "") -> None:
    """Raise UsageError where value is of none of these kinds: a path for a record, a dict for settings."""
    if not isinstance(value, kinds):
        wanted = " or ".join(kind.__name__ for kind in kinds)
        raise UsageError(f"{name} is of type {type(value).__name__}, not {wanted}", cure=cure or f"Give a {wanted}")


def require_number(name: str, value: object, *, cure: str = "") -> None:
    """Raise UsageError where value is no finite real number: a text, an array, a truth value."""
    real = isinstance(value, Real) and not isinstance(value, bool | np.bool_)
    if not real or not isfinite(float(value)):  # type: ignore[arg-type]  # it is real
        raise UsageError(f"{name} is {value!r}, no number", cure=cure or "Give a number")


def require_numbers(record: object, *names: str) -> None:
    """Raise UsageError where one of a record's fields is no finite number; None is let through."""
    for name in names:
        value = getattr(record, name)
        if value is not None and not (type(value) is float and isfinite(value)):
            require_number(name, value)


def require_count(name: str, value: object, least: int = 0) -> None:
    """Raise UsageError where value is no whole number of at least so many."""
    if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
        raise UsageError(f"{name} is {value!r}, not a whole number from {least}", cure="Give a whole number")


def require_texts(name: str, values: object) -> tuple[str, ...]:
    """Return a sequence of texts as a tuple; raises UsageError where it is one text or holds anything else."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise UsageError(f"{name} is no list of texts", cure="Give one text a row")
    found = tuple(values)
    for value in found:
        require_kind(f"an entry of {name}", value, str)
    return found


def one_of(kind: type[Choice], name: str, value: Any) -> Choice:
    """Return the member of an enumeration; raises UsageError, with the members, for anything else."""
    try:
        return kind(value)
    except ValueError:
        raise not_one_of(name, value, kind) from None


def checked_poses(name: str, value: ArrayLike, rows: int | None = None) -> NDArray[np.float64]:
    """Return rigid transforms (n, 4, 4), checked; raises Inconsistent, naming the row (from 0), for any other."""
    T = checked_array(name, value, (rows, 4, 4), nan=True)
    require_rigid(name, T)
    return T


def require_rigid(name: str, T: NDArray[np.float64]) -> None:
    """Raise Inconsistent, naming the row, where one of T (n, 4, 4) is not finite or no rigid transform."""
    finite = np.isfinite(T).all(axis=(1, 2))
    if not finite.all():
        raise Inconsistent(
            f"pose {int(np.argmin(finite))} of {name} is not finite",
            consequence="It says no place",
            cure="Leave out the poses in which nothing was measured",
        )
    if not len(T):
        return
    R = T[:, :3, :3]
    off = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2))
    off = np.maximum(off, np.abs(T[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1))
    off = np.where(np.linalg.det(R) > 0.0, off, np.inf)
    worst = int(np.argmax(off))
    if off[worst] > ROTATION_TOLERANCE:
        raise Inconsistent(
            f"pose {worst} of {name} is no rigid transform"
            + (f" (off by {off[worst]:.2g})" if np.isfinite(off[worst]) else " (it mirrors)"),
            consequence="Its rotation cannot be trusted",
            cure="Give [[R, t], [0, 0, 0, 1]] with R orthonormal and right-handed, t in metres",
        )


def real_array(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """Return value as float64, the very array where it is one; raises Inconsistent for what is masked or not real."""
    if type(value) is np.ndarray and value.dtype == FLOAT64:
        return value
    if hasattr(value, "mask") and isinstance(value, np.ma.MaskedArray) and np.ma.getmaskarray(value).any():
        raise Inconsistent(
            f"{name} is masked in places",
            consequence="What is below the mask would be taken as measured",
            cure="Leave the masked rows out",
        )
    try:
        array = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise _no_numbers(name, str(error)) from error
    if array.dtype.kind not in REAL:
        raise _no_numbers(name, f"numpy makes {array.dtype} of it")
    return array.astype(np.float64)


def _no_numbers(name: str, why: str) -> Inconsistent:
    return Inconsistent(
        f"{name} is not an array of numbers ({why})",
        consequence="It cannot be used",
        cure="Give rows of equal length, of real numbers only",
    )


def _require_shape(name: str, array: NDArray[np.float64], shape: Dimensions) -> None:
    fits = len(array.shape) == len(shape)
    for have, want in zip(array.shape, shape, strict=False):
        fits = fits and (want is None or have == want)
    if not fits:
        wanted = ", ".join("n" if want is None else str(want) for want in shape)
        wanted += "," if len(shape) == 1 else ""
        turned = array.ndim == len(shape) == 2 and array.shape[0] == shape[1]
        raise Inconsistent(
            f"{name} has shape {array.shape}, not ({wanted})",
            consequence="It cannot be used",
            cure="Transpose it: one row each" if turned else "Give one row each",
        )


def _require_finite(name: str, array: NDArray[np.float64], *, nan: bool = False) -> None:
    flat = array.ravel()
    if isfinite(np.vdot(flat, flat)):  # three times as fast as to look at each; vdot warns of no overflow
        return
    bad = np.isinf(array) if nan else ~np.isfinite(array)
    if bad.any():
        row = f" at row {np.argwhere(bad)[0][0]}" if array.ndim else ""
        raise Inconsistent(
            f"{name} holds a value that is {'infinite' if nan else 'not finite'}{row}",
            consequence="It cannot be used",
            cure="Leave out the poses in which nothing was measured",
        )


def trusted(kind: type[Record], **fields: object) -> Record:
    """Return a record of all its fields, arrays neither copied nor checked but made read-only.

    For what was just computed and is used by nobody else: float64, of the right shape and finite by construction. In
    a loop of hundreds of frames a second the constructor's copies and checks cost as much as the measurement itself.
    """
    record, put = object.__new__(kind), object.__setattr__
    for name, value in fields.items():
        if isinstance(value, ndarray):
            value.setflags(write=False)
        put(record, name, value)
    return record


def changed(record: Record, **fields: object) -> Record:
    """Return a record with some of its fields changed, none checked anew; see trusted."""
    names: tuple[str, ...] = record.__slots__  # type: ignore[attr-defined]
    return trusted(type(record), **({name: getattr(record, name) for name in names} | fields))


# What a record's field may hold, said once beside the field: `speed_m_s: Positive = 0.1`. Files follow it too.

MOST = 1e6
"""No speed, length, time or count of a limit is larger: a unit gone wrong."""


@dataclass(frozen=True, slots=True)
class Shape:
    """Lengths of an array's axes, None for any; endless: entries may be infinite, which files hold as null."""

    lengths: tuple[int | None, ...]
    endless: bool = False


Positive = Annotated[float, Bounds(above=0.0, most=MOST)]
NotNegative = Annotated[float, Bounds(least=0.0, most=MOST)]


@cache
def _bounds(kind: Any) -> tuple[tuple[str, Bounds], ...]:
    hints = get_type_hints(kind, include_extras=True)
    return tuple((name, limit) for name, hint in hints.items() for limit in _in(hint))


def _in(hint: Any) -> Iterator[Bounds]:
    """Yield the bounds of a number, also of one that may be None."""
    for part in (hint, *get_args(hint)):
        if get_origin(part) is Annotated and get_args(part)[0] in (float, int):
            yield from (one for one in get_args(part)[1:] if isinstance(one, Bounds))


def require_bounds(record: object, of: str = "") -> None:
    """Raise UsageError where a record's field is no number, Inconsistent where it is beyond its Bounds; None may be."""
    kind: Any = type(record)  # a class can be hashed
    for name, limit in _bounds(kind):
        value = getattr(record, name)
        if value is None:
            continue
        if not isinstance(value, int | float) or isinstance(value, bool):
            require_number(of + name, value)
        if not limit.holds(value):
            raise Inconsistent(
                f"{of}{name} is {value:g}, which must be {limit}",
                consequence="It cannot be used",
                cure="Give one, or leave the key away for the default",
            )


# Whether lengths can be metres at all: one rule for whatever is calibrated, identified or verified.

FAR_M = 50.0
"""No robot's flange is so far from its base, no camera sees a target and no tip rests on a point so far away: such
numbers are millimetres."""
SPREAD_M = 25.0
"""Positions that an arm brought its tool to lie no further from their middle: those of a gantry 20 m long lie 10 m from
it. In millimetres an arm reaches it that moves by 25 mm."""
TOOL_M = 10.0
"""No tool's end is so far from its flange, nor from the target on it: 10 mm taken as metres."""
PITCH_M = 1.0
"""No board's points are so far apart."""
TARGET_M = 15.0
"""No target's lights are so far apart: 15 mm taken as metres."""
LARGEST_BASELINE_M = 1.0
"""A pair further apart than this has its unit said: centimetres (7.5), millimetres (60) and squares of a board (2.4)
look like wide rigs, and no rig of cameras that see a tool has been met that is wider than 0.6 m."""


def wide_rig(baseline_m: float) -> str:
    """Return what to look for where a rig is wider than any that sees an arm, else ''."""
    if baseline_m <= LARGEST_BASELINE_M:
        return ""
    return (
        f"The rig's cameras are {baseline_m:.3g} m apart: lengths in centimetres, millimetres or squares look so. "
        "Where they stand closer, calibrate with the board's square in metres, or convert the rig's file with --unit."
    )


def check_metres(length_m: ArrayLike, most_m: float, what: str) -> None:
    """Raise Inconsistent where the middle of lengths that are said to be metres is beyond what any is. what: they are,
    in words that a length follows."""
    array = np.atleast_1d(np.asarray(length_m, float))
    middle = float(np.median(array)) if array.size else 0.0
    if middle > most_m:
        raise Inconsistent(
            f"{what} {middle:.4g} m: these are millimetres (mm, or another unit) given as metres",
            consequence="Every distance in the result would be wrong",
            cure="Divide the lengths by 1000, or name the right unit when exporting them",
        )


def check_spread(xyz_m: ArrayLike, what: str) -> None:
    """Raise Inconsistent where positions (m, 3) that an arm brought its tool to lie too far from their middle for
    metres.

    Where they are seen from does not count: a tracker or a map has its origin anywhere.
    """
    array = np.asarray(xyz_m, float).reshape(-1, 3)
    if len(array):
        check_metres(np.linalg.norm(array - np.median(array, axis=0), axis=1), SPREAD_M, f"{what} spread over")
