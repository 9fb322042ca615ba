"""Actions (armsight.ops) as commands: flags of their signature, and what their result shows of itself."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from armsight.cli.command import Command, add
from armsight.cli.command_ui import CommandUI
from armsight.fields import Flag, marks
from armsight.ops.action import OUT
from armsight.shown import WRITTEN

if TYPE_CHECKING:
    from armsight.ops.action import Action
    from armsight.records.output import Output


def add_action(
    group: typer.Typer,
    call: Callable[..., Any],
    instead: Callable[[CommandUI, Mapping[str, Any]], bool] | None = None,
    **more: Any,
) -> None:
    """Add an action (armsight.ops) to a group as a command; more: of Command.

    instead: does another job where what was asked, by parameter, means that one, and tells whether it did.
    """
    done: Action = vars(call)["action"]

    @functools.cache  # when the command is asked for: hints take time to read
    def names() -> dict[str, str]:
        return {name: _word(name, hint) for name, hint in done.hints.items()}

    def taken() -> dict[str, tuple[Any, Any]]:
        return {names()[name]: one for name, one in done.flags().items()}

    def run(face: CommandUI, **given: Any) -> None:
        asked = {name: given[word] for name, word in names().items() if word in given}
        if instead is None or not instead(face, asked):
            show(face, done.run(asked, face.progress(done.working) if done.working else None), asked[OUT])

    text = (call.__doc__ or "").partition("\n    Parameters\n")[0]
    add(group, done.command.rpartition(" ")[2], text, Command(function=run, taken=taken, **more))


def show(face: CommandUI, result: Output, out: Path) -> None:
    """Show a result, which was written to `out`."""
    lines = list(result.summary())
    for one in lines if any(one == WRITTEN for one in lines) else [*lines, f"Result: {out}"]:
        if isinstance(one, str):
            face.say(one.replace("{out}", str(out)))
        else:
            face.table(*one)
    face.result(result)


def _word(name: str, hint: Any) -> str:
    """Return what the command line calls a parameter: as its flag is written, where that has a name of its own."""
    names = next((flag.names for flag in marks(hint, Flag) if flag.names), "")
    return names.split()[-1].split("/")[0].lstrip("-").replace("-", "_") if names else name
