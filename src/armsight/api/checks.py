"""Arguments held against a public function's annotations, and errors in Python's words: one decorator for all."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial, wraps
from os import PathLike
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from armsight.api.commands import in_python
from armsight.drivers import CameraSettings
from armsight.errors import ArmsightError, UsageError
from armsight.records import require_count, require_kind, require_number
from armsight.store.interpret import TableFormat
from armsight.store.outputs import held_outputs

P = ParamSpec("P")
R = TypeVar("R")

WRITTEN = ("out", "record")
"""Parameters that name what a function writes."""

Check = Callable[[str, object], None]


def speaks_python(call: Callable[P, R]) -> Callable[P, R]:
    """Refuse arguments that the annotations exclude, and let errors name parameters and functions, not flags."""
    signature = inspect.signature(call)
    checks = {name: check for name, one in signature.parameters.items() if (check := check_of(str(one.annotation)))}

    @wraps(call)
    def run(*args: P.args, **given: P.kwargs) -> R:
        try:
            arguments = signature.bind(*args, **given).arguments
            for name, value in arguments.items():
                if name in checks:
                    checks[name](name, value)
                require_range(name, value)
            with held_outputs(_written(arguments)):
                return call(*args, **given)
        except ArmsightError as error:
            in_python(error)
            raise

    return run


def _written(arguments: Mapping[str, object]) -> list[Path]:
    """Return what a function is told to write; what is no path is told by the function itself."""
    values = [arguments.get(name) for name in WRITTEN]
    each = [one for value in values for one in (value if isinstance(value, list | tuple) else [value])]
    return [Path(one) for one in each if isinstance(one, str | PathLike) and one]


def check_of(annotation: str) -> Check | None:
    """Return what a parameter's annotation asks of its value: a number, one of some words, settings; None: nothing."""
    parts = annotation.split(" | ")
    known = [part for part in parts if part != "None"]
    found = next((part for part in known if part.startswith("Literal[")), None)
    check: Check
    if found is not None:
        words = ast.literal_eval(f"({found.removeprefix('Literal[').removesuffix(']')},)")
        check = partial(_one_of, words)
    elif len(known) == 1 and known[0] in SIMPLE:
        check = SIMPLE[known[0]]
    else:
        return None
    return partial(_or_none, check) if "None" in parts else check


def require_range(name: str, value: object) -> None:
    """Raise UsageError for a number that a parameter of this name cannot have; see RANGES."""
    if name in RANGES and isinstance(value, int | float) and not RANGES[name](value):
        raise UsageError(
            f"{name} is {value:g}, which cannot be", consequence="It cannot be used", cure=RANGES[name].cure
        )


def _or_none(check: Check, name: str, value: object) -> None:
    if value is not None:
        check(name, value)


def _one_of(words: tuple[str, ...], name: str, value: object) -> None:
    if not isinstance(value, str) or value not in words:
        raise UsageError(
            f"{name} is {value!r}, which is not known",
            consequence="It cannot be used",
            cure=f"Use one of: {', '.join(words)}",
        )


def _kind(*kinds: type) -> Check:
    return lambda name, value: require_kind(name, value, *kinds)


def _progress(name: str, value: Any) -> None:
    if not (hasattr(value, "update") and hasattr(value, "cancelled")):
        raise UsageError(f"{name} is of type {type(value).__name__}", cure="Give an object with update and cancelled")


def _confirm(name: str, value: object) -> None:
    if not isinstance(value, bool) and not callable(value):
        raise UsageError(f"{name} is {value!r}", cure="Give True, or a function of the question")


@dataclass(frozen=True, slots=True, kw_only=True)
class _From:
    """What a number has to be: from `least` on, or above it."""

    least: float
    above: bool = False

    def __call__(self, value: float) -> bool:
        return value > self.least if self.above else value >= self.least

    @property
    def cure(self) -> str:
        return f"Give {'more than' if self.above else 'at least'} {self.least:g}"


RANGES: Mapping[str, _From] = {
    **dict.fromkeys(("every", "frames", "limit", "workers"), _From(least=1)),
    **dict.fromkeys(("max_skew_s", "seed"), _From(least=0)),
    **dict.fromkeys(
        ("cycle_s", "distance_m", "fps", "seconds_s", "tolerance_m", "tolerance_rad", "unit_m"),
        _From(least=0, above=True),
    ),
}
"""What the numbers of these names have to be wherever they are taken, as the options of the command line are."""

SIMPLE: Mapping[str, Check] = {
    "float": require_number,
    "int": require_count,
    "bool": _kind(bool),
    "str": _kind(str),
    "Progress": _progress,
    "Confirm": _confirm,
    "TableFormat": _kind(TableFormat),
    "CameraSettings": _kind(CameraSettings),
    "PairSettings": _kind(CameraSettings, tuple),
}
"""What is asked of a value by its annotation, where that is one of these words alone."""
