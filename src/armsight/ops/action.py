"""One function an action: command line, Python and page call it, and its signature is its only declaration.

`@action("calibrate tooltip") def calibrate_tool_tip(poses: APoses, *, point_m: ... = None, out: ... = None)`: what
stands beside a parameter's type says its meaning, bounds and flag (armsight.fields), and how a file's path becomes the
object that the function takes (Input). A parameter without a meaning is Python's alone.
"""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, wraps
from os import PathLike, fspath
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from armsight._files import real_path
from armsight.errors import ArmsightError, UsageError
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
    Python hands over. given: all arguments by name, those before it as objects already. undo: an ExitStack, for what
    lasts as long as the action. kind: what the command line takes. hashed: its file's hash goes into what is written;
    files: 'module:function' of what is given, which lists its files where it is not one itself.
    """

    read: str
    kind: Any = Path
    hashed: bool = False
    files: str = ""

    def object_of(self, name: str, value: Any, given: Given, undo: contextlib.ExitStack) -> Any:
        """Return the object. Raises UsageError, DataRefused."""
        return loaded(self.read)()(name, value, given, undo)

    def hashed_files(self, value: Any) -> list[Path]:
        """Return the files whose hashes go into what is written; none for an object."""
        if not self.hashed:
            return []
        paths = [fspath(one) for one in _each(value) if isinstance(one, str | PathLike)]
        return [Path(one) for path in paths for one in (loaded(self.files)()(path) if self.files else [path])]


@dataclass(frozen=True)
class Action:
    """What a function does for people: command: its words on the command line; working: what its progress says.

    gives: the attribute of the result that Python gets; '' for all of it. keeps: the files that it writes into a folder
    `out`; beside: endings of those that go beside a file `out`. None of them is an input, but `in_place`, whose
    place the result may take. writes: the function itself writes what `out` names, while it works, or by more than one
    name.
    """

    command: str
    function: Callable[..., Output]
    working: str = ""
    gives: str = ""
    keeps: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    in_place: str = ""
    writes: bool = False

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
        self._require_kept(given)
        with contextlib.ExitStack() as undo:
            taken = dict(given)
            if (outs := given.get(OUT)) is not None:
                taken[OUT] = [Path(one) for one in outs] if isinstance(outs, list | tuple) else Path(outs)
            for name, value in given.items():
                if name in self.inputs and value is not None:
                    taken[name] = self.inputs[name].object_of(name, value, taken, undo)
            if PROGRESS in self.parameters and taken.get(PROGRESS) is None:
                taken[PROGRESS] = progress
            try:
                result = self.function(**taken)
            except ArmsightError as error:
                if error.kept is not None and outs is not None and not self.writes:
                    self._write(Path(outs), error.kept, given)
                raise
        if outs is not None and not self.writes:
            self._write(Path(outs), result, given)
        return result

    def _require_kept(self, given: Given) -> None:
        """Raise UsageError where what is to be read would be written over; FILE#LINK is a chain of an arm's file."""
        if given.get(OUT) is None:
            return
        names = [name for name in self.inputs if name != self.in_place]
        read = [one for name in names for one in _each(given.get(name)) if isinstance(one, str | PathLike)]
        texts = {text for one in read for text in (fspath(one), fspath(one).partition("#")[0]) if text}
        paths = {real_path(Path(text)) for text in texts}
        outs = [Path(one) for one in _each(given[OUT])]
        beside = [out.with_suffix(ending) for out in outs for ending in self.beside]
        for file in [outs[0] / name for name in self.keeps] or [*outs, *beside]:
            if real_path(file) in paths and not file.is_dir():
                raise UsageError(
                    f"{file} is to be read, and would be written over",
                    consequence="Nothing is written",
                    cure=f"Give another {'folder' if self.keeps else 'name'} with -o",
                )

    def _write(self, out: Path, result: object, given: Given) -> None:
        """Write the result's files, with the hashes of what went in, frames last."""
        read = sorted(self.inputs.items(), key=lambda item: bool(item[1].files))
        write_with_page(out, result, [file for name, one in read for file in one.hashed_files(given.get(name))], given)


def write_with_page(out: Path, result: object, files: Sequence[Path] = (), given: Given = MappingProxyType({})) -> None:
    """Write a result's files, with the hashes of the files that went in, and its page beside them. Raises DeviceFailed.

    given: what the action was called with, of which the page tells.
    """
    from armsight.report.pages import page_of, page_path
    from armsight.store import write_text
    from armsight.store.saving import write_result

    write_result(out, result, files)
    if (page := page_path(out, result)) is not None:
        write_text(page, page_of(result, files, given))


def _each(value: Any) -> Sequence[Any]:
    return value if isinstance(value, list | tuple) else (value,)


def action(command: str, **more: Any) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Make a function an action; it stays a function of Python, which checks what it is given and writes `out`.

    more: of Action.
    """

    def decorated(function: Callable[P, R]) -> Callable[P, R]:
        made = Action(command=command, function=function, **more)  # type: ignore[arg-type]  # it returns a result

        @wraps(function)
        def run(*args: P.args, **given: P.kwargs) -> R:
            from armsight.ops.checks import checked_call

            return checked_call(made, args, given)  # type: ignore[no-any-return]  # what the function returns

        vars(run)["action"] = made
        return run

    return decorated


def action_of(call: Callable[..., Any]) -> Action:
    """Return what a function does for people."""
    done: Action = vars(call)["action"]
    return done
