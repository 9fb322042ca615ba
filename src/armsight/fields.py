"""What a field says of itself beside its type: what it means, what it may hold, how it is given on the command line.

`distance_m: Annotated[float, Doc("How far."), Flag("--distance", quantity="m")] = 0.6`. Files, error texts, and the
flags of the command line with their help follow from it.
"""

from __future__ import annotations

import builtins
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from importlib import import_module
from types import EllipsisType, NoneType, UnionType
from typing import Annotated, Any, Protocol, Union, get_args, get_origin, get_type_hints


@dataclass(frozen=True, slots=True)
class Doc:
    """What a field means, as the help of its flag says it, or the schema of a result.

    unit: of a result's, where its name does not end in it; key: its name in JSON, where that is another. nullable: a
    number that is told as null where it is not finite.
    """

    text: str
    unit: str = ""
    key: str = ""
    nullable: bool = False


@dataclass(frozen=True, slots=True)
class Bounds:
    """A number above `above`, from `least` to `most`; of a tuple: the fewest entries in a file that has it."""

    above: float | None = None
    least: float | None = None
    most: float | None = None

    def holds(self, value: float) -> bool:
        """Tell whether a number is finite and within."""
        return (
            math.isfinite(value)
            and (self.above is None or value > self.above)
            and (self.least is None or value >= self.least)
            and (self.most is None or value <= self.most)
        )


@dataclass(frozen=True, slots=True)
class Flag:
    """How a field is given on the command line, where its name, type and default alone do not say it.

    names: the flag as it is written, such as '-o --out'; '' makes it of the field's name. positional: an argument
    without a flag. quantity: 'm', 'm/s' or 'rad or m', which may be written with units (200mm). unit: what one of the
    number is in SI, of flags such as --plate-mm. default: shown and taken where the flag is not given; ...: the field's
    own, not shown where it is None or empty. read: makes the field's value of what was given. panel: of the help.
    """

    names: str = ""
    metavar: str | None = None
    positional: bool = False
    quantity: str = ""
    unit: float | None = None
    default: Any | EllipsisType = ...
    read: Callable[[Any], Any] | None = None
    panel: str | None = None


class FlagGroup(Protocol):
    """A frozen dataclass of flags, which together make one object."""

    def made(self, tell: Callable[[str], None]) -> Any:
        """Return the object; tell is for what the person should hear. Raises UsageError."""
        ...


@dataclass(frozen=True, slots=True)
class Flags:
    """A field that is given by several flags, those of a group."""

    group: type[FlagGroup]


class _Known(dict[str, Any]):
    """The names of a module; one that only type checkers import is anything: loading it would take a second."""

    def __init__(self, module: str) -> None:
        super().__init__()
        self._names = vars(sys.modules[module])

    def __missing__(self, name: str) -> Any:
        if name in self._names or hasattr(builtins, name):
            raise KeyError(name)
        return Any


def loaded(place: str) -> Callable[[], Any]:
    """Return what gives a field a default that takes long to load, by its place: 'module:name', or 'module:Class()'."""

    def make() -> Any:
        module, _, name = place.partition(":")
        value = reduce(getattr, name.removesuffix("()").split("."), import_module(module))
        return value() if name.endswith("()") else value  # type: ignore[operator]  # a class, as the place says

    return make


def loaded_names(package: str, places: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the __getattr__ of a package whose names are loaded when they are first used: name -> module in it."""

    def load(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{places[name]}"), name)

    return load


def known_hints(of: Any) -> dict[str, Any]:
    """Return the annotations of a function or class, with what stands beside them."""
    return get_type_hints(of, localns=_Known(of.__module__), include_extras=True)


def marks(hint: Any, kind: Any) -> list[Any]:
    """Return what of a kind is said beside a type, the outermost first."""
    inner = get_args(hint)
    if get_origin(hint) is not Annotated:
        return [one for part in inner for one in marks(part, kind)]
    return [one for one in inner[1:] if isinstance(one, kind)] + marks(inner[0], kind)


def bare(hint: Any) -> tuple[Any, ...]:
    """Return the types of a hint without what is said beside them, and without None."""
    if get_origin(hint) is Annotated:
        return bare(get_args(hint)[0])
    if get_origin(hint) in (Union, UnionType):
        return tuple(kind for part in get_args(hint) for kind in bare(part))
    return () if hint is NoneType else (hint,)
