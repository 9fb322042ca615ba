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

from armsight.units import DEG

DIGITS = 12
"""Of a number in the person's unit: it is held in SI, and 0.02 m is not quite 20 mm."""


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
    """A number above `above`, from `least` to `most`, in SI; of a tuple: the fewest entries in a file that has it."""

    above: float | None = None
    least: float | None = None
    most: float | None = None

    def __str__(self) -> str:
        """In words, as what follows "must be"."""
        lower = "" if self.least is None else f"at least {self.least:g}"
        lower = lower if self.above is None else f"above {self.above:g}"
        return " and ".join(part for part in (lower, "" if self.most is None else f"at most {self.most:g}") if part)

    def per(self, unit: float) -> Bounds:
        """Return the same bounds of the number in a unit, one of which is so many in SI."""
        ends = (self.above, self.least, self.most)
        return Bounds(*(None if end is None else round(end / unit, DIGITS) for end in ends))

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
    own, not shown where it is None or empty. repeated: it may be given several times; read then takes a list. read:
    makes the field's value of what was given. panel: of the help. needed: by the command
    line, not by Python.
    """

    names: str = ""
    metavar: str | None = None
    positional: bool = False
    quantity: str = ""
    unit: float | None = None
    default: Any | EllipsisType = ...
    repeated: bool = False
    read: Callable[[Any], Any] | None = None
    panel: str | None = None
    needed: bool = False

    def written(self, name: str) -> str:
        """Return how the flag of a field of this name is written; of -o --out the short one, as messages have it.

        Where `names` gives no name it is the field's with the person's unit: none of a quantity, whose unit may be
        written behind the number, none of seconds, hertz and kelvin, and mm or deg of what is given in those.
        """
        if self.names:
            return self.names.split()[0].split("/")[0]
        if self.unit is not None:
            name = name.removesuffix("_m").removesuffix("_rad") + ("_deg" if self.unit == DEG else "_mm")
        elif self.quantity:
            name = name.removesuffix("_m_s").removesuffix("_m")
        elif not name.endswith("_m_s"):
            name = name.removesuffix("_s").removesuffix("_hz").removesuffix("_k")
        return "--" + name.replace("_", "-")


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
    """The names of the modules of a function or class and its bases, which may stand in other ones.

    One that only type checkers import is anything: loading it would take a second.
    """

    def __init__(self, of: Any) -> None:
        super().__init__()
        modules = {one.__module__ for one in getattr(of, "__mro__", (of,))}
        self._names = {name for module in modules for name in vars(sys.modules[module])}

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
    return get_type_hints(of, localns=_Known(of), include_extras=True)


def marks(hint: Any, kind: Any) -> list[Any]:
    """Return what of a kind is said beside a type, the outermost first."""
    inner = get_args(hint)
    if get_origin(hint) is not Annotated:
        return [one for part in inner for one in marks(part, kind)]
    return [one for one in inner[1:] if isinstance(one, kind)] + marks(inner[0], kind)


def bounds_of(hint: Any) -> Bounds | None:
    """Return what is said beside a number, the outermost, of what it may be; None where nothing is."""
    return next(iter(marks(hint, Bounds)), None)


def bare(hint: Any) -> tuple[Any, ...]:
    """Return the types of a hint without what is said beside them, and without None."""
    if get_origin(hint) is Annotated:
        return bare(get_args(hint)[0])
    if get_origin(hint) in (Union, UnionType):
        return tuple(kind for part in get_args(hint) for kind in bare(part))
    return () if hint is NoneType else (hint,)
