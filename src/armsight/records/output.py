"""Results as programs get them: frozen dataclasses whose documented fields are the keys of a JSON object."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from dataclasses import fields as dataclass_fields
from functools import cache
from html import escape
from os import PathLike, fspath
from typing import (
    Annotated,
    Any,
    Generic,
    Self,
    TypeVar,
    cast,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
    overload,
)

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.columns import POSE6
from armsight.fields import Doc
from armsight.geometry import xyz_quat
from armsight.records.by_value import ByValue, Saveable
from armsight.shown import Shown
from armsight.units import displayed_name

Value = TypeVar("Value", covariant=True)
Kind = TypeVar("Kind")
More = TypeVar("More", bound="Output")
Row = tuple[str, str]

FEW = 6
"""Values of a list that are shown; of a longer one their number is."""


@dataclass_transform(frozen_default=True, kw_only_default=True, eq_default=False)
def output(kind: type[Kind]) -> type[Kind]:
    """Make the class a result: `@output class Fit(Output): rms_px: Annotated[float, Doc("Residual, px.")]`."""
    return dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)(kind)


@dataclass(frozen=True, slots=True)
class Key:
    """A key of the JSON object: the attribute it shows, its type, meaning, and whether it is left out for None."""

    attribute: str
    hint: Any
    doc: Doc
    optional: bool

    @property
    def name(self) -> str:
        """What programs call it."""
        return self.doc.key or self.attribute

    def of(self, record: object) -> Any:
        """Return what a record has there, None for a number that is not finite and told as null."""
        value = getattr(record, self.attribute)
        return None if self.doc.nullable and not math.isfinite(value) else value


class Figure(Generic[Value]):
    """A property that programs get beside the fields; made by `figure`."""

    def __init__(self, of: Callable[[Any], Value], doc: Doc, optional: bool) -> None:
        self.of, self.doc, self.optional = of, doc, optional
        self.__doc__ = doc.text

    @overload
    def __get__(self, record: None, kind: type | None = None) -> Figure[Value]: ...
    @overload
    def __get__(self, record: object, kind: type | None = None) -> Value: ...
    def __get__(self, record: object | None, kind: type | None = None) -> Figure[Value] | Value:
        return self if record is None else cast(Value, _of_python(self.of(record)))


def figure(
    meaning: str, *, unit: str = "", key: str = "", optional: bool = False
) -> Callable[[Callable[[Any], Value]], Figure[Value]]:
    """Return the decorator of a method that is worked out from the fields and is a key too; optional: not for None."""
    return lambda of: Figure(of, Doc(meaning, unit=unit, key=key), optional)


class Output(ByValue):
    """A result as programs get it: fixed keys, SI units, the unit in the key's name.

    Keys are the fields with a Doc and what `figure` made; a NamedTuple inside may have them too. A field without a
    default is always there, null where there is no data for it; one with a default is left out of the JSON object
    where it is None. Further fields, without a Doc, are for Python only. Poses become position and quaternion, arrays
    lists.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        for one in dataclass_fields(self):  # type: ignore[arg-type]  # what `output` makes is a dataclass
            held = getattr(self, one.name)
            kept = _of_python(held)
            if kept is not held:
                object.__setattr__(self, one.name, kept)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain numbers, texts, lists and dictionaries, keys as in the JSON object."""
        held = ((key, key.of(self)) for key in keys(type(self)))
        return {key.name: _plain(value, key.hint) for key, value in held if not (key.optional and value is None)}

    def to_json(self) -> str:
        """Return it as strict JSON text in one line; a number that is not finite (no data) becomes null."""
        return json.dumps(finite(self.to_dict()), ensure_ascii=False, allow_nan=False)

    def _shown(self) -> tuple[str, Sequence[Row]]:
        return type(self).__name__, list(flat_rows(self.to_dict()))

    @property
    def exit_code(self) -> int:
        """With which a command ends that gives this result: 3 where it is not to be relied on."""
        return 0

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it, tables and lines."""
        yield from ()

    def __repr__(self) -> str:
        return as_text(*self._shown())

    __str__ = __repr__

    def _repr_html_(self) -> str:
        return as_html(*self._shown())


class TitledOutput(Output, Saveable):
    """A result that prints itself as `title` and `rows`, and has a file."""

    __slots__ = ()

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        raise NotImplementedError

    def rows(self) -> list[Row]:
        """Return (name, value with unit and standard deviation) as people read them."""
        raise NotImplementedError

    def _shown(self) -> tuple[str, Sequence[Row]]:
        return self.title, self.rows()

    @property
    def detail(self) -> Self:
        """The result itself; of earlier versions, which had it beside."""
        warnings.warn("detail is the result itself; use that", DeprecationWarning, stacklevel=2)
        return self


def extended(result: Output, kind: type[More], **fields: Any) -> More:
    """Return a result of a kind that has further fields, or other values of some."""
    of = {one.name: getattr(result, one.name) for one in dataclass_fields(result)}  # type: ignore[arg-type]  # a dataclass
    return kind(**(of | fields))


def keys(kind: type) -> tuple[Key, ...]:
    """Return the keys of a class of results: those of fields first, then its figures, each as declared."""
    of: Any = kind  # a class can be hashed
    return _keys(of)


def field_keys(kind: type) -> tuple[Key, ...]:
    """Return the keys that a class of results is given: those of its fields."""
    return tuple(key for key in keys(kind) if not isinstance(getattr(kind, key.attribute), Figure))


def _of_python(value: Any) -> Any:
    """Return numpy's numbers, also those in a list or dictionary, as Python's: they print as such."""
    if isinstance(value, np.generic):
        return value.item()
    if type(value) in (list, tuple) and any(isinstance(one, np.generic) for one in value):
        return type(value)(map(_of_python, value))
    if type(value) is dict and any(isinstance(one, np.generic) for one in value.values()):
        return {name: _of_python(one) for name, one in value.items()}
    return value


@cache
def _keys(kind: Any) -> tuple[Key, ...]:
    hints = get_type_hints(kind, include_extras=True)
    found = []
    if issubclass(kind, tuple):
        return tuple(Key(name, hints[name], get_args(hints[name])[1], False) for name in kind._fields)
    for one in dataclass_fields(kind):
        hint = hints[one.name]
        doc = next((part for part in get_args(hint) if isinstance(part, Doc)), None)
        if get_origin(hint) is Annotated and doc is not None:
            optional = one.default is None
            found.append(Key(one.name, hint, doc, optional))
    worked_out: dict[str, Figure[Any]] = {}
    mro: tuple[type, ...] = kind.__mro__
    for base in reversed(mro):
        worked_out |= {name: value for name, value in vars(base).items() if isinstance(value, Figure)}
    for name, value in worked_out.items():
        hint = get_type_hints(value.of, include_extras=True)["return"]
        found.append(Key(name, hint, value.doc, value.optional))
    return tuple(found)


def is_output(hint: Any) -> bool:
    """Tell whether a type is a class of results, or of named tuples whose fields have a Doc."""
    return isinstance(hint, type) and (issubclass(hint, Output) or hasattr(hint, "_fields"))


def _plain(value: Any, hint: Any) -> Any:
    """Return a value as JSON has it; a whole number is written as a float where one is declared."""
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, Output):
        return value.to_dict()
    if isinstance(value, str):
        return str(value)
    if isinstance(value, PathLike):
        return fspath(value)
    if isinstance(value, int | np.integer):
        return float(value) if _is_float(hint) else int(value)
    if isinstance(value, float | np.floating):
        return float(value)
    if isinstance(value, RigidTransform):
        xyz, quat = xyz_quat(value)
        return {"xyz_m": xyz.tolist(), "quat_xyzw": quat.tolist()}
    if hasattr(value, "_fields"):
        return {key.name: _plain(one, key.hint) for key, one in zip(keys(type(value)), value, strict=True)}
    inner = _inner(hint)
    if isinstance(value, Mapping):
        return {str(name): _plain(one, inner) for name, one in value.items()}
    return [_plain(one, inner) for one in value]


@cache
def _inner(hint: Any) -> Any:
    hint = _bare(hint)
    return (
        float
        if get_origin(hint) in (None, np.ndarray)
        else (get_args(hint)[-1], get_args(hint)[0])[get_args(hint)[-1] is Ellipsis]
    )


@cache
def _is_float(hint: Any) -> bool:
    return _bare(hint) is float


def _bare(hint: Any) -> Any:
    """Return the first type in an annotation that is none of Annotated, a union, or None."""
    while get_origin(hint) is Annotated or (
        get_origin(hint) not in (list, tuple, dict) and type(None) in get_args(hint)
    ):
        hint = get_args(hint)[0] if get_args(hint)[0] is not type(None) else get_args(hint)[1]
    return hint


def finite(value: Any) -> Any:
    """Return numbers, lists and dictionaries of them with null for each number that is not finite."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def with_std(value: float, std: float | None, unit: str, *, scale: float = 1.0) -> str:
    """Return '12.345 +- 0.021 mm': as many digits as the standard deviation is worth."""
    if std is None or not std > 0.0:
        return f"{value * scale:.6g} {unit}".rstrip()
    if not math.isfinite(std):
        return f"{value * scale:.6g} {unit}, not determined"
    digits = max(0, 1 - math.floor(math.log10(std * scale)))
    return f"{value * scale:.{digits}f} +- {std * scale:.{digits}f} {unit}".rstrip()


def pose_rows(values: Mapping[str, float], std: Mapping[str, float]) -> list[Row]:
    """Return the rows of a pose: x, y, z in mm, rx, ry, rz in degrees, each with its standard deviation."""
    return [
        (stem, with_std(values[name], std.get(name), unit, scale=1.0 / size))
        for name in POSE6
        if name in values
        for stem, unit, size in (displayed_name(name),)
    ]


def as_text(title: str, rows: Sequence[Row]) -> str:
    """Return title and rows as lines, the values below each other."""
    width = max((len(name) for name, _ in rows), default=0)
    return "\n".join([title, *(f"  {name:<{width}}  {value}".rstrip() for name, value in rows)])


def as_html(title: str, rows: Sequence[Row]) -> str:
    """Return title and rows as a table."""
    cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows)
    return f"<table><caption>{escape(title)}</caption>{cells}</table>"


def flat_rows(content: Mapping[str, Any], prefix: str = "") -> Iterator[Row]:
    """Yield a nested dictionary's figures under dotted names, in SI; those withheld are counted only."""
    withheld = 0
    for name, value in content.items():
        if isinstance(value, Mapping) and value.get("withheld"):
            withheld += 1
        elif isinstance(value, Mapping):
            yield from flat_rows(value, f"{prefix}{name}.")
        elif isinstance(value, list) and (len(value) > FEW or any(isinstance(one, list | dict) for one in value)):
            yield f"{prefix}{name}", f"({len(value)})"
        elif value not in (None, "", []):
            yield f"{prefix}{name}", ", ".join(map(_digits, value)) if isinstance(value, list) else _digits(value)
    if withheld:
        yield f"{prefix}withheld", f"({withheld})"


def _digits(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
