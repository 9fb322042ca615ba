"""Actions (armsight.ops) as commands: flags of their signature, and what their result shows of itself."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from keyword import iskeyword
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from armsight.cli.command import Command, ResultsDoubted, add, app
from armsight.cli.command_ui import CommandUI
from armsight.cli.examples import every_command
from armsight.fields import Flag, marks
from armsight.file_names import REPORT, report_path
from armsight.ops import actions
from armsight.ops.action import OUT, CommandTraits, action_of
from armsight.shown import Shown

if TYPE_CHECKING:
    from armsight.records.output import Output


SECTION = re.compile(r"\n    (?:Parameters|Returns|Raises|Examples)\n    -")
"""What Python's help says further."""


def add_action(
    group: typer.Typer,
    call: Callable[..., Any],
    instead: Callable[[CommandUI, Mapping[str, Any]], bool] | None = None,
    flags: Callable[[], Mapping[str, tuple[Any, Any]]] = dict,
    settled: Callable[[], Mapping[str, Any]] = dict,
    beside: Callable[[CommandUI, Mapping[str, Any]], Mapping[str, Any]] = lambda *_: {},
    **more: Any,
) -> None:
    """Add an action (armsight.ops) to a group as a command; more: of Command.

    instead: does another job where what was asked, by parameter, means that one, and tells whether it did. flags:
    further ones, of that job. settled: what holds where a flag is not given, by parameter. beside: what else the
    function gets, made of the face and of what was asked.
    """
    done = action_of(call)

    @functools.cache  # when the command is asked for: hints take time to read
    def names() -> dict[str, str]:
        hints = {name: hint for name, (hint, _) in flags().items()} | dict(done.hints)
        return {name: _word(name, hint) for name, hint in hints.items()}

    def taken() -> dict[str, tuple[Any, Any]]:
        own = done.flags()
        return {names()[name]: one for name, one in {**own, **flags(), **own}.items()}  # its own first, in their order

    def run(face: CommandUI, **given: Any) -> None:
        asked = {**settled(), **{name: given[word] for name, word in names().items() if word in given}}
        if instead is None or not instead(face, asked):
            own = {name: asked[name] for name in done.parameters if name in asked} | dict(beside(face, asked))
            result = done.run(own, face.progress(done.working.format_map(own)) if done.working else None)
            show(face, result, asked.get(OUT), written=done.writes is True)

    text = SECTION.split(call.__doc__ or "")[0]
    about = {one.name: getattr(done, one.name) for one in fields(CommandTraits)} | more
    add(group, done.command.rpartition(" ")[2], text, Command(function=run, taken=taken, **about))


def add_others() -> None:
    """Add every action whose command is not there yet, to the group that its first word names."""
    groups = {one.name: one.typer_instance for one in app.registered_groups}
    there = {name for name, _ in every_command(app)}
    for call in actions():
        command = action_of(call).command
        if command not in there:
            there.add(command)
            add_action(groups.get(command.rpartition(" ")[0]) or app, call)


def show(face: CommandUI, result: Output, out: Any, *, written: bool = False) -> None:
    """Show a result, which was written to `out`, if it is of a file.

    written: it says itself where its files are. Raises ResultsDoubted where it is not as it should be.
    """
    lines, page = list(result.summary()), None if out is None or written else _page(out, result)
    told = out is None or written or hasattr(result, "write") or any("{out}" in str(one) for one in lines)
    lines = lines if told else [*lines, f"Result: {out}" + ("" if page is None else f"; open {page}")]
    show_lines(face, lines, out, page)
    face.result(result)
    if result.exit_code:
        raise ResultsDoubted


def _page(out: Path, result: Output) -> Path | None:
    from armsight.ops.saving import page_path  # with all kinds of files

    return page_path(out, result)


def show_lines(face: CommandUI, lines: Iterable[Shown], out: Any, page: Path | None = None) -> None:
    """Show tables and lines, with the names of what was written in place of {out} and {report}."""
    for one in lines:
        if isinstance(one, str):
            face.say(_with_names(one, out, page))
        else:
            face.table(*one)


def _with_names(line: str, out: Any, page: Path | None) -> str:
    if not isinstance(out, Path):
        return line
    if "{report}" in line:
        line = line.replace("{report}", str(page or report_path(out)))
    return line.replace(f"{{out}}/{REPORT}", str(out / REPORT)).replace("{out}", str(out))


def _word(name: str, hint: Any) -> str:
    """Return what the command line calls a parameter: as its flag is written, where that has a name of its own."""
    names = next((flag.names for flag in marks(hint, Flag) if flag.names), "")
    word = names.split()[-1].split("/")[0].lstrip("-").replace("-", "_") if names else name
    return name if iskeyword(word) else word
