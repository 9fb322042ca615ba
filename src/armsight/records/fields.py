"""What a record's field may hold, said once beside the field: `speed_m_s: Positive = 0.1`. Files follow it too."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from armsight.errors import Inconsistent
from armsight.fields import Bounds
from armsight.records.checks import require_number

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
    """Raise UsageError where a field of a record is no number, Inconsistent where it is not within its Bounds.

    None is let through.
    """
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
