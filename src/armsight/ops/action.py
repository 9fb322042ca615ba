"""One function an action: command line, Python and page call it, and its signature is its only declaration.

`@action("calibrate tooltip") def calibrate_tool_tip(poses: APoses, *, point_m: ... = None, out: ... = None)`: what
stands beside a parameter's type says its meaning, bounds and flag (armsight.fields), and how a file's path becomes the
object that the function takes (Input). A parameter without a meaning is Python's alone.
"""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, wraps
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from armsight.fields import Doc, Flags, known_hints, loaded, marks

if TYPE_CHECKING:
    from armsight.records.output import Output
    from armsight.records.progress import Progress

P = ParamSpec("P")
R = TypeVar("R")

OUT = "out"
PROGRESS = "progress"
Given = Mapping[str, Any]
"""What an action was called with, by parameter."""


@dataclass(frozen=True, slots=True)
class Input:
    """A parameter that may be given as a file's path.

    read: 'module:function' of (name, value, given, undo), loaded late; it returns the object of a path or of what
    Python hands over. undo: an ExitStack, for what lasts as long as the action. kind: what the command line takes.
    hashed: its file's hash goes into what is written.
    """

    read: str
    kind: type = Path
    hashed: bool = False

    def object_of(self, name: str, value: Any, given: Given, undo: contextlib.ExitStack) -> Any:
        """Return the object. Raises UsageError, DataRefused."""
        return loaded(self.read)()(name, value, given, undo)


@dataclass(frozen=True)
class Action:
    """What a function does for people: command: its words on the command line; working: what its progress says."""

    command: str
    function: Callable[..., Output]
    working: str

    @cached_property
    def hints(self) -> Mapping[str, Any]:
        """The annotations with what stands beside them, by parameter."""
        return known_hints(self.function)

    @cached_property
    def inputs(self) -> Mapping[str, Input]:
        """The parameters that may be files."""
        found = {name: next(iter(marks(hint, Input)), None) for name, hint in self.hints.items()}
        return {name: one for name, one in found.items() if one is not None}

    @property
    def parameters(self) -> Mapping[str, inspect.Parameter]:
        """The parameters, annotations as they are written."""
        return inspect.signature(self.function).parameters

    def flags(self) -> dict[str, tuple[Any, Any]]:
        """Return hint and default of what the command line asks for: all that has a meaning, and groups of flags."""
        return {
            name: (self.hints[name], one.default)
            for name, one in self.parameters.items()
            if marks(self.hints[name], Doc | Flags)
        }

    def run(self, given: Given, progress: Progress | None = None) -> Output:
        """Read what is given as files, do the work, and write the result where `out` says. Raises ArmsightError."""
        with contextlib.ExitStack() as undo:
            taken = {
                name: self.inputs[name].object_of(name, value, given, undo)
                if name in self.inputs and value is not None
                else value
                for name, value in given.items()
            }
            out = None if given.get(OUT) is None else Path(given[OUT])
            if out is not None:
                taken[OUT] = out
            if PROGRESS in self.parameters and taken.get(PROGRESS) is None:
                taken[PROGRESS] = progress
            result = self.function(**taken)
        if out is not None:
            from armsight.store.saving import write_result

            write_result(out, result, self._files(given))
        return result

    def _files(self, given: Given) -> list[Path]:
        """Return the files whose hashes go into the result, in the order of the parameters."""
        files: list[Path] = []
        for name, one in sorted(self.inputs.items(), key=lambda item: item[1].kind is str):  # frames stand last
            value = given.get(name)
            if not one.hashed or not isinstance(value, str | PathLike):
                continue
            if one.kind is str:  # frames
                from armsight.app.calibrate.camera_noise import input_files

                files += input_files(fspath(value))
            else:
                files.append(Path(value))
        return files


def action(command: str, *, working: str = "") -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Make a function an action; it stays a function of Python, which checks what it is given and writes `out`."""

    def decorated(function: Callable[P, R]) -> Callable[P, R]:
        made = Action(command=command, function=function, working=working)  # type: ignore[arg-type]  # it returns a result

        @wraps(function)
        def run(*args: P.args, **given: P.kwargs) -> R:
            from armsight.ops.checks import checked_call

            return checked_call(made, args, given)  # type: ignore[return-value]  # what the function returns

        vars(run)["action"] = made
        return run

    return decorated
