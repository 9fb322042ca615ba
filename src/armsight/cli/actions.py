"""Actions (armsight.ops) as commands: flags of their signature, and what their result shows of itself."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Mapping
from keyword import iskeyword
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from armsight.cli.command import Command, add
from armsight.cli.command_ui import CommandUI
from armsight.fields import Flag, marks
from armsight.ops.action import OUT

if TYPE_CHECKING:
    from armsight.ops.action import Action
    from armsight.records.output import Output


SECTION = re.compile(r"\n    (?:Parameters|Returns|Raises|Examples)\n    -")
"""What Python's help says further."""


def add_action(
    group: typer.Typer,
    call: Callable[..., Any],
    instead: Callable[[CommandUI, Mapping[str, Any]], bool] | None = None,
    flags: Callable[[], Mapping[str, tuple[Any, Any]]] = dict,
    **more: Any,
) -> None:
    """Add an action (armsight.ops) to a group as a command; more: of Command.

    instead: does another job where what was asked, by parameter, means that one, and tells whether it did. flags:
    further ones, of that job.
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
        asked = {name: given[word] for name, word in names().items() if word in given}
        if instead is None or not instead(face, asked):
            own = {name: asked[name] for name in done.parameters if name in asked}
            show(face, done.run(own, face.progress(done.working) if done.working else None), asked.get(OUT))

    text = SECTION.split(call.__doc__ or "")[0]
    about = {"keeps": done.keeps} | more
    add(group, done.command.rpartition(" ")[2], text, Command(function=run, taken=taken, **about))


def action_of(call: Callable[..., Any]) -> Action:
    """Return what a function does for people."""
    done: Action = vars(call)["action"]
    return done


def show(face: CommandUI, result: Output, out: Path | None) -> None:
    """Show a result, which was written to `out`, if it is of a file. Raises Exit where it is not as it should be."""
    from armsight.report.pages import page_path

    lines, page = list(result.summary()), None if out is None else page_path(out, result)
    told = out is None or hasattr(result, "write") or any("{out}" in str(one) for one in lines)
    for one in lines if told else [*lines, f"Result: {out}" + ("" if page is None else f"; open {page}")]:
        if isinstance(one, str):
            report = "" if out is None else out.with_suffix(".report.html") if page is None else page
            face.say(one.replace("{out}", str(out)).replace("{report}", str(report)))
        else:
            face.table(*one)
    face.result(result)
    if result.exit_code:
        raise typer.Exit(result.exit_code)


def _word(name: str, hint: Any) -> str:
    """Return what the command line calls a parameter: as its flag is written, where that has a name of its own."""
    names = next((flag.names for flag in marks(hint, Flag) if flag.names), "")
    word = names.split()[-1].split("/")[0].lstrip("-").replace("-", "_") if names else name
    return name if iskeyword(word) else word
