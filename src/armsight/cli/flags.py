"""A command's flags, made of what its function takes: requests field by field, and parameters of its own.

A flag's name, help, range and unit stand beside the field (armsight.fields) and nowhere else; here they become typer's.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass
from typing import Annotated, Any, Generic, TypeVar, get_args, get_origin

import typer

from armsight.errors import UsageError
from armsight.fields import DIGITS, Bounds, Doc, Flag, Flags, bare, bounds_of, known_hints, marks
from armsight.ops.action import Input
from armsight.units import UNITS_OF, read_quantity

Request = TypeVar("Request")
Notify = Callable[[str], None]


class Quantity:
    """Reads an option in a unit, SI where none is written behind it; refuses what another was meant by."""

    def __init__(self, unit: str) -> None:
        self._unit = unit
        self.__name__ = unit

    def __call__(self, given: str | float) -> float:
        """Return the number in SI; a default is one already. Raises typer.BadParameter, with the ways to write it."""
        try:
            return read_quantity(str(given), self._unit)
        except ValueError as error:
            raise typer.BadParameter(str(error)) from None


@dataclass(frozen=True, slots=True)
class OneFlag:
    """A flag by the name that typer hands its value over with; written: as people give it.

    bounds: of its number in SI; unit: what one of the number that people give is in SI.
    """

    name: str
    written: str
    parameter: inspect.Parameter
    read: Callable[[Any], Any] | None
    bounds: Bounds | None
    unit: float

    def values(self, given: Mapping[str, Any], notify: Notify) -> dict[str, Any]:
        """Return its value by its name; nothing where it was not given and has no default of its own.

        Raises UsageError for a number beyond its bounds, of which the parser knows those alone that it can show.
        """
        value = given[self.name]
        if value is None:
            return {}
        made = value if self.read is None else self.read(value)
        for number in made if isinstance(made, list | tuple) else (made,):
            if self.bounds is not None and isinstance(number, int | float) and not self.bounds.holds(number):
                raise UsageError(
                    f"{self.written} is {number / self.unit:g}, which must be {self.bounds.per(self.unit)}",
                    consequence="Nothing was done",
                    cure=f"Give a number that is {self.bounds.per(self.unit)}",
                )
        return {self.name: made}

    def flags(self) -> tuple[OneFlag, ...]:
        """Return the flags."""
        return (self,)


@dataclass(frozen=True, slots=True)
class Parts:
    """What several flags make together: a request; or, as a group within one, what its `made` returns."""

    name: str
    kind: type
    parts: tuple[OneFlag | Parts, ...]
    group: bool = False

    def values(self, given: Mapping[str, Any], notify: Notify) -> dict[str, Any]:
        """Return the object by its name. Raises UsageError."""
        one = self.kind(**{name: value for part in self.parts for name, value in part.values(given, notify).items()})
        return {self.name: one.made(notify) if self.group else one}

    def flags(self) -> tuple[OneFlag, ...]:
        """Return the flags."""
        return tuple(flag for part in self.parts for flag in part.flags())


class PartialRequest(Generic[Request]):
    """One of the requests that a command can make: which of its flags were given, and the request itself.

    Of a mode's own flags (CommandFlags) it is a dictionary of their values.
    """

    def __init__(self, parts: Parts, values: Mapping[str, Any], defaults: Mapping[str, Any], notify: Notify) -> None:
        self._parts, self._values, self._defaults, self._notify = parts, values, defaults, notify

    @property
    def flags(self) -> tuple[str, ...]:
        """All its flags, as they are written."""
        return tuple(one.written for one in self._parts.flags())

    @property
    def given(self) -> tuple[str, ...]:
        """The flags that were given, as they are written."""
        flags = self._parts.flags()
        return tuple(one.written for one in flags if self._values[one.name] != self._defaults[one.name])

    @property
    def missing(self) -> tuple[str, ...]:
        """The flags that were not given and that it cannot do without."""
        needed = [one for one in self._parts.flags() if one.parameter.default is inspect.Parameter.empty]
        return tuple(one.written for one in needed if self._values[one.name] is None)

    def value(self, name: str) -> Any:
        """Return one of its values, None where it was not given and has no default of its own. Raises UsageError."""
        part = next(one for one in self._parts.parts if one.name == name)
        return part.values(self._values, self._notify).get(name)

    def made(self, **more: Any) -> Request:
        """Return the request; more: fields in place of those of the flags. Raises UsageError."""
        parts = self._parts.parts
        values = {name: value for part in parts for name, value in part.values(self._values, self._notify).items()}
        return self._parts.kind(**{**values, **more})  # type: ignore[no-any-return]  # the kind of the annotation


def taken_by(function: Callable[..., None]) -> dict[str, tuple[Any, Any]]:
    """Return hint and default of all parameters of a command's function but the first, the CommandUI."""
    hints = known_hints(function)
    _, *taken = inspect.signature(function).parameters.values()
    return {one.name: (hints[one.name], one.default) for one in taken}


class CommandFlags:
    """The flags of a command, of hint and default of each parameter; their order is that of the help.

    In place of a hint may stand a mode's own flags: a mapping of their hints and defaults, asked for as PartialRequest.
    """

    def __init__(self, taken: Mapping[str, tuple[Any, Any]]) -> None:
        self._parts = [_taken(name, *one) for name, one in taken.items()]

    def parameters(self) -> list[inspect.Parameter]:
        """Return typer's parameters; of flags of one name the first counts, and no mode's are required."""
        found: dict[str, inspect.Parameter] = {}
        for part, asked in self._parts:
            for flag in part.flags():
                one = flag.parameter
                found.setdefault(flag.name, one.replace(default=_or_none(one.default)) if asked else one)
        return list(found.values())

    def arguments(self, given: Mapping[str, Any], notify: Notify) -> dict[str, Any]:
        """Return what the function is called with. Raises UsageError."""
        made: dict[str, Any] = {}
        defaults = {one.name: _or_none(one.default) for one in self.parameters()}
        for part, asked in self._parts:
            made |= {part.name: PartialRequest(part, given, defaults, notify)} if asked else part.values(given, notify)  # type: ignore[arg-type]
        return made


def _taken(name: str, hint: Any, default: Any) -> tuple[OneFlag | Parts, bool]:
    """Return the flags of a parameter, and whether it is one of several requests."""
    if get_origin(hint) is PartialRequest:
        return _request(name, get_args(hint)[0]), True
    if isinstance(hint, Mapping):
        return Parts(name=name, kind=dict, parts=tuple(_field(one, *what) for one, what in hint.items())), True
    if dataclasses.is_dataclass(hint):
        return _request(name, hint), False  # type: ignore[arg-type]  # a class
    return _field(name, hint, default), False


def _request(name: str, kind: type, *, group: bool = False) -> Parts:
    """Return the flags of a dataclass: of each field that has a Doc, or that is a group."""
    hints = known_hints(kind)
    documented = [one for one in dataclasses.fields(kind) if marks(hints[one.name], Doc | Flags)]
    parts = [_field(one.name, hints[one.name], _default(one)) for one in documented]
    return Parts(name=name, kind=kind, parts=tuple(parts), group=group)


def _field(name: str, hint: Any, default: Any) -> OneFlag | Parts:
    for flags in marks(hint, Flags):
        return _request(name, flags.group, group=True)
    flag = next(iter(marks(hint, Flag)), Flag())
    shown = default if flag.default is ... else flag.default
    if flag.unit is not None and isinstance(shown, float) and flag.default is ...:
        shown = round(shown / flag.unit, DIGITS)
    if flag.needed:
        shown = inspect.Parameter.empty
    open_ = shown is None or shown in ("", ())
    kind = _kind(hint, flag)
    info = _info(name, hint, flag, shown)
    parameter = inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=None if open_ else shown,
        annotation=Annotated[kind | None if open_ else kind, info],
    )
    unit = flag.unit
    read = flag.read if unit is None else lambda value: value * unit
    written, bounds = flag.written(name), bounds_of(hint)
    return OneFlag(name=name, written=written, parameter=parameter, read=read, bounds=bounds, unit=unit or 1.0)


def _info(name: str, hint: Any, flag: Flag, shown: Any) -> Any:
    """Return typer's description of a flag; shown: its default in the person's unit, of which six digits are."""
    limits = (bounds_of(hint) or Bounds()).per(flag.unit or 1.0)
    more: dict[str, Any] = {"metavar": flag.metavar, "help": next(iter(marks(hint, Doc)), Doc("")).text}
    if flag.panel is not None:
        more["rich_help_panel"] = flag.panel
    if flag.quantity:
        more |= {"parser": Quantity(flag.quantity)}
        more["metavar"] = flag.metavar or "|".join(UNITS_OF[flag.quantity]).upper()
    else:
        more |= {"min": limits.least, "max": limits.most}
    if flag.unit is not None and isinstance(shown, float) and float(f"{shown:.6g}") != shown:
        more["show_default"] = f"{shown:.4g}"
    if flag.positional:
        return typer.Argument(**more)
    return typer.Option(*(flag.names.split() or [flag.written(name)]), **more)


def _kind(hint: Any, flag: Flag) -> Any:
    """Return the type that typer reads: text where an object is made of it."""
    if isinstance(flag.default, bool):
        return bool
    if flag.repeated:
        return list[str]
    for given in marks(hint, Input):
        return given.kind
    kind = bare(hint)[0]
    return str if flag.read is not None or kind is Any else kind


def _default(one: dataclasses.Field[Any]) -> Any:
    if one.default is not MISSING:
        return one.default
    return inspect.Parameter.empty if one.default_factory is MISSING else None


def _or_none(default: Any) -> Any:
    return None if default is inspect.Parameter.empty else default
