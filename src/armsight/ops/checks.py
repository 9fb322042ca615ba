"""Arguments held against a public function's annotations, and errors in Python's words, for actions and all else."""

from __future__ import annotations

import ast
import contextlib
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial, wraps
from os import PathLike
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar, get_args, get_origin

from armsight.drivers import CameraSettings
from armsight.errors import ArmsightError, UsageError, not_one_of
from armsight.fields import Bounds, Flag, Flags, bare, bounds_of, known_hints, marks
from armsight.ops.action import Action
from armsight.ops.commands import in_python, parameter
from armsight.records import require_count, require_kind, require_number
from armsight.store.atomic import held_outputs
from armsight.store.interpret import TableFormat

P = ParamSpec("P")
R = TypeVar("R")

WRITTEN = ("out", "record")
"""Parameters that name what a function writes."""

Check = Callable[[str, object], None]


def speaks_python(*requests: type) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Refuse what annotations and bounds exclude, and let errors name parameters and functions, not flags.

    requests: what the function's arguments fill, or the request of the command that does the same: their fields say
    the bounds.
    """

    def decorated(call: Callable[P, R]) -> Callable[P, R]:
        signature = inspect.signature(call)
        checks = cache(partial(_checks, call, requests))  # when first called: hints take time to read

        @wraps(call)
        def run(*args: P.args, **given: P.kwargs) -> R:
            with _speaking_python(checks(), signature.bind(*args, **given).arguments):
                return call(*args, **given)

        vars(run)["requests"] = requests
        return run

    return decorated


def checked_call(made: Action, args: Sequence[Any], given: Mapping[str, Any]) -> Any:
    """Run an action with what Python gives; return what Python gets. Raises ArmsightError in Python's words."""
    arguments = inspect.signature(made.function).bind(*args, **given).arguments
    with _speaking_python(_checks_of(made), arguments):
        result = made.run(arguments)
        return getattr(result, made.gives) if made.gives else result


@contextlib.contextmanager
def _speaking_python(checks: Mapping[str, Sequence[Check]], arguments: Mapping[str, object]) -> Iterator[None]:
    """Check the arguments, hold what is to be written, and let errors name parameters and functions."""
    try:
        for name, value in arguments.items():
            for check in checks.get(name, ()):
                check(name, value)
        with held_outputs(_written(arguments)):
            yield
    except ArmsightError as error:
        in_python(error)
        raise


@cache
def _checks_of(made: Action) -> dict[str, list[Check]]:
    """Return what the parameters of an action ask of their values, by their types and bounds."""
    found: dict[str, list[Check]] = {}
    for name, one in made.parameters.items():
        hint, bounds = made.hints[name], bounds_of(made.hints[name])
        written = next((group.group.made.__annotations__["return"] for group in marks(hint, Flags)), "")
        written = written or " | ".join(map(_written_kind, bare(hint)))
        several = "list[" in str(one.annotation)  # files that are written together
        known = PATH if name in WRITTEN and not several else check_of(str(one.annotation)) or check_of(written)
        found[name] = [] if known is None or name in made.inputs else [partial(_or_none, known)]
        found[name] += [] if bounds is None else [partial(_within, bounds)]
    return found


def _written_kind(kind: Any) -> str:
    return f"Literal{list(get_args(kind))}" if get_origin(kind) is Literal else getattr(kind, "__name__", "")


def _checks(call: Callable[..., Any], requests: tuple[type, ...]) -> dict[str, list[Check]]:
    hints = known_hints(call)
    bounds = bounds_of_parameters(requests)
    found: dict[str, list[Check]] = {}
    for name, one in inspect.signature(call).parameters.items():
        asked, within = check_of(str(one.annotation)), bounds_of(hints.get(name))
        if within is not None and asked is None:
            asked = check_of(" | ".join([*map(_written_kind, bare(hints[name])), "None"]))
        found[name] = [] if asked is None else [asked]
        if (within := bounds.get(name, within)) is not None:
            found[name].append(partial(_within, within))
    return found


def bounds_of_parameters(requests: tuple[type, ...]) -> dict[str, Bounds]:
    """Return the bounds of parameters, by the name that each field of these requests has in Python."""
    found: dict[str, Bounds] = {}
    for kind in requests:
        for name, hint in known_hints(kind).items():
            for group in marks(hint, Flags):
                found |= bounds_of_parameters((group.group,))
            if (bounds := bounds_of(hint)) is not None:
                flag = next(iter(marks(hint, Flag)), Flag())
                found[parameter(flag.written(name))] = bounds
    return found


def _within(bounds: Bounds, name: str, value: object) -> None:
    """Raise UsageError for a number, or one of several, that is not within."""
    for one in value if isinstance(value, list | tuple) else (value,):
        if isinstance(one, int | float) and not bounds.holds(one):
            raise UsageError(
                f"{name} is {one:g}, which must be {bounds}",
                consequence="It cannot be used",
                cure=f"Give a number that is {bounds}",
            )


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


def _or_none(check: Check, name: str, value: object) -> None:
    if value is not None:
        check(name, value)


def _one_of(words: tuple[str, ...], name: str, value: object) -> None:
    if not isinstance(value, str) or value not in words:
        raise not_one_of(name, value, words)


def _kind(*kinds: type) -> Check:
    return lambda name, value: require_kind(name, value, *kinds)


def _having(*names: str) -> Check:
    def check(name: str, value: object) -> None:
        if not all(hasattr(value, one) for one in names):
            raise UsageError(
                f"{name} is of type {type(value).__name__}", cure=f"Give an object with {' and '.join(names)}"
            )

    return check


def _function(name: str, value: object) -> None:
    if not callable(value):
        raise UsageError(f"{name} is of type {type(value).__name__}", cure="Give a function")


def _confirm(name: str, value: object) -> None:
    if not isinstance(value, bool) and not callable(value):
        raise UsageError(f"{name} is {value!r}", cure="Give True, or a function of the question")


PATH = _kind(str, PathLike)
SIMPLE: Mapping[str, Check] = {
    "float": require_number,
    "int": require_count,
    "bool": _kind(bool),
    "str": _kind(str),
    "Progress": _having("update", "cancelled"),
    "Publishing": _having("supervised"),
    "Clock": _having("now_s"),
    "Supervised": _having("robot", "pairs"),
    "Show": _function,
    "Callable": _function,
    "Confirm": _confirm,
    "Settings": _kind(Mapping),
    "RobotSettings": _kind(Mapping),
    "TableFormat": _kind(TableFormat),
    "CameraSettings": _kind(CameraSettings),
    "PairSettings": _kind(CameraSettings, tuple),
}
"""What is asked of a value by its annotation, where that is one of these words alone."""
