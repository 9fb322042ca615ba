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


@dataclass(frozen=True, kw_only=True)
class CommandTraits:
    """What a command is beside its function and flags; command: its words.

    keeps: the results that it writes into its folder `out`. own: a result whose presence says that the folder is this
    command's own, which it may replace unasked. in_place: the input whose place its result may take. streamed: it
    writes one table and nothing else, which may go to the standard output (-o -). panels: of the help, in their order.
    filed: its result may be filed in a history. judged: its result has a verdict.
    """

    command: str = ""
    keeps: tuple[str, ...] = ()
    own: str | None = None
    in_place: str = ""
    streamed: bool = False
    panels: tuple[str, ...] = ()
    filed: bool = False
    judged: bool = False


@dataclass(frozen=True, kw_only=True)
class Action(CommandTraits):
    """What a function does for people: working: what its progress says; examples: of its flags, for the help.

    gives: the attribute of the result that Python gets; '' for all of it. beside: endings of the files that go beside a
    file `out`. None of them or of `keeps` is an input, but `in_place`. writes: the function of (path, result,
    inputs=files) that writes the result into a YAML file, or into a folder where it keeps files, by its name in
    store.saving or 'module:function'; False: the result's own `write`; True: the function itself, while it works, or by
    more than one name. page: 'module:function' in report, of (result, files that went in, what it was called with).
    """

    function: Callable[..., Output]
    working: str = ""
    examples: tuple[str, ...] = ()
    gives: str = ""
    beside: tuple[str, ...] = ()
    writes: bool | str = False
    page: str = ""

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
                needed = self.parameters[name].default is inspect.Parameter.empty  # its reader says what it takes
                if name in self.inputs and (needed or value is not None):
                    taken[name] = self.inputs[name].object_of(name, value, taken, undo)
            if PROGRESS in self.parameters and taken.get(PROGRESS) is None:
                taken[PROGRESS] = progress
            try:
                result = self.function(**taken)
            except ArmsightError as error:
                if error.kept is not None and outs is not None and self.writes is not True:
                    self._write(Path(outs), error.kept, given)
                raise
        if outs is not None and self.writes is not True:
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
        from armsight.ops.saving import write_with_page

        read = sorted(self.inputs.items(), key=lambda item: bool(item[1].files))
        write_with_page(out, result, [file for name, one in read for file in one.hashed_files(given.get(name))], given)


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
