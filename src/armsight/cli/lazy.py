"""Commands that are made when they are asked for, and groups of them: of help that only lists them none is made."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import math
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, get_args, get_origin

import typer
from typer._coercion import build_runtime_param
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command_from_info
from typer.models import CommandInfo

from armsight.cli.command_ui import CommandUI
from armsight.cli.flags import Quantity

ALSO = {("calibrate", "cell", "--plan"): "cell-plan"}
"""Group, command and flag that stand for another command of the group, whose flags are then read."""


@contextlib.contextmanager
def _stand_ins(names: dict[str, ModuleType]) -> Iterator[None]:
    """Let modules that are not loaded yet, and of which nothing is used, be others for a while."""
    held = {name: module for name, module in names.items() if name not in sys.modules}
    sys.modules.update(held)
    try:
        yield
    finally:
        for name in held:
            del sys.modules[name]


def load_help() -> None:
    """Load typer's help without rich's Markdown and traceback, which take longer than all else and are not used."""
    stand_ins = {name: ModuleType(name) for name in ("rich.markdown", "rich.traceback")}
    for module, name in zip(stand_ins.values(), ("Markdown", "Traceback"), strict=True):
        setattr(module, name, type(name, (), {}))
    with _stand_ins(stand_ins):
        importlib.import_module("typer.rich_utils")


class _NoHelp(defaultdict[str, list[Any]]):
    """What scipy makes of a function's help to add a note to it: nothing, which takes no time."""

    def __init__(self, _function: object) -> None:
        super().__init__(list)

    def __str__(self) -> str:
        return "\n"


def load_rotations() -> None:
    """Load scipy's rotations without the rest of scipy.spatial, without scipy.linalg, of which splines take functions,
    and without what scipy, copying numpy's names, loads.

    All are loaded when they are asked for. Only a command does so: no other thread asks at the same moment. Nor does
    one read the help of scipy's functions, to which scipy adds notes: most of the time of its special functions.
    """
    import numpy as np  # here, as the help needs none of this
    import scipy

    with contextlib.suppress(ImportError):
        vars(importlib.import_module("scipy._lib._docscrape"))["FunctionDoc"] = _NoHelp
    spatial, linalg = map(ModuleType, ("scipy.spatial", "scipy.linalg"))
    spatial.__path__ = [f"{scipy.__path__[0]}/spatial"]
    vars(linalg)["__getattr__"] = lambda name: lambda *given, **more: getattr(scipy.linalg, name)(*given, **more)
    empty = {name: ModuleType(name) for name in {"f2py", "ma", "polynomial", "testing"} - set(vars(np))}
    vars(np).update(empty)
    try:
        with _stand_ins({one.__name__: one for one in (spatial, linalg)}), contextlib.suppress(Exception):
            importlib.import_module("scipy.spatial.transform")  # where it needs more it is imported as a whole later
    finally:
        for name, module in empty.items():
            if vars(np)[name] is module:
                delattr(np, name)


@contextlib.contextmanager
def _telling_at_once() -> Iterator[None]:
    try:
        yield
    except typer.Exit:
        raise
    except Exception:  # typer prints what is wrong by the same means as its help
        load_help()
        raise


class Group(TyperGroup):
    """A group whose help is printed at once, and what is wrong with its arguments too."""

    def make_context(self, *given: Any, **more: Any) -> Any:
        """Read the arguments of the group itself."""
        with _telling_at_once():
            return super().make_context(*given, **more)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that is asked for, by its other spelling too, and what is left of the arguments."""
        flags = args[: args.index("--")] if "--" in args else args
        for flag in flags[1:]:
            if other := ALSO.get((self.name or "", args[0], flag)):
                args = [other, *(one for one in args[1:] if one != flag)]
                break
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command that is asked for."""
        with _telling_at_once():
            return super().invoke(ctx)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help."""
        load_help()
        super().format_help(ctx, formatter)


class _Conversion:
    """Typer's conversion of what is given for a parameter; pydantic, which takes long to load, only where it is needed.

    It is not for what is not given, for text, choices as they are written, paths that typer does not look at, defaults,
    and numbers that are read with their unit.
    """

    def coerce(self, value: Any, *, param: Any, ctx: Any) -> Any:
        """Return the value. Raises typer.BadParameter."""
        if value is None:
            return () if param.multiple or param.nargs == -1 else None
        kind, info = param.type_descriptor.annotation, param.type_descriptor.parameter_info
        if isinstance(value, str | float) and not param.multiple and isinstance(info.parser, Quantity):
            return info.parser(value)
        if info.parser is None and type(value) is kind:  # text, or a default
            return value
        if isinstance(value, str) and info.parser is None:
            if get_origin(kind) is Literal and value in get_args(kind):
                return value
            if kind is Path and not (info.exists or info.resolve_path or info.allow_dash or info.path_type):
                return Path(value)
        return build_runtime_param(param.type_descriptor).coerce(value, param=param, ctx=ctx)


class LazyCommand(TyperCommand):
    """A command whose flags are made when it is asked for: those of all would take longer than printing the help.

    One of another distribution is loaded then. Its numbers are finite: nan is below no limit and above none, and
    passes every range.
    """

    _params: Any = ()

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help."""
        load_help()
        super().format_help(ctx, formatter)

    @property
    def params(self) -> Any:
        """The flags."""
        if not self._params and (command := getattr(self.callback, "armsight", None)) is not None:
            if callable(command):
                command = command()
                self.help = inspect.getdoc(command.function)

            def run(**given: Any) -> None:
                command.run(**given)

            parameters = command.parameters()
            run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # what typer reads
            run.__annotations__ = {one.name: one.annotation for one in parameters}
            made = get_command_from_info(
                CommandInfo(name=self.name, callback=run), pretty_exceptions_short=False, rich_markup_mode="rich"
            )
            for one in made.params:
                one._runtime_param = _Conversion()  # type: ignore[attr-defined]  # what typer makes when it needs it
            self._params, self.callback = made.params, made.callback
        return self._params

    @params.setter
    def params(self, value: Any) -> None:
        self._params = value

    def make_context(self, info_name: Any, args: list[str], parent: Any = None, **more: Any) -> Any:
        """Read the arguments. A command that is not installed is refused as a failing one ends."""
        with CommandUI(as_json="--json" in args):
            _ = self.params
        return super().make_context(info_name, args, parent, **more)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:  # typer's own copy of click has the type
        """Return what is left of the arguments. Raises typer.BadParameter for nan and inf."""
        left = super().parse_args(ctx, args)
        parameters: list[Any] = self.get_params(ctx)
        for one in parameters:
            given = ctx.params.get(one.name or "")
            for value in given if isinstance(given, list | tuple) else [given]:
                if isinstance(value, float) and not math.isfinite(value):
                    raise typer.BadParameter(f"{value} is no finite number", ctx=ctx, param=one)
        return left
