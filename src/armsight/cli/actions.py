"""Actions (armsight.ops) as commands: flags of their signature, and what their result shows of itself."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from keyword import iskeyword
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from armsight.cli.command import Command, add
from armsight.cli.command_ui import CommandUI
from armsight.cli.tables import show
from armsight.fields import Flag, marks
from armsight.ops.action import OUT

if TYPE_CHECKING:
    from armsight.ops.action import Action


SECTION = re.compile(r"\n    (?:Parameters|Returns|Raises|Examples)\n    -")
"""What Python's help says further."""


def add_action(group: typer.Typer, call: Callable[..., Any], **more: Any) -> None:
    """Add an action (armsight.ops) to a group as a command; more: of Command."""
    done: Action = vars(call)["action"]

    @functools.cache  # when the command is asked for: hints take time to read
    def names() -> dict[str, str]:
        return {name: _word(name, hint) for name, hint in done.hints.items()}

    def taken() -> dict[str, tuple[Any, Any]]:
        return {names()[name]: one for name, one in done.flags().items()}

    def run(face: CommandUI, **given: Any) -> None:
        from armsight.report.pages import page_path

        asked = {name: given[word] for name, word in names().items() if word in given}
        result = done.run(asked, face.progress(done.working) if done.working else None)
        show(face, result.summary())
        page = page_path(Path(asked[OUT]), result)
        if not hasattr(result, "write"):  # else its summary says what is told of files
            face.say(f"Result: {asked[OUT]}" + ("" if page is None else f"; open {page}"))
        face.result(result)
        if result.exit_code:
            raise typer.Exit(result.exit_code)

    text = SECTION.split(call.__doc__ or "")[0]
    add(group, done.command.rpartition(" ")[2], text, Command(function=run, taken=taken, keeps=done.keeps, **more))


def _word(name: str, hint: Any) -> str:
    """Return what the command line calls a parameter: as its flag is written, where that has a name of its own."""
    names = next((flag.names for flag in marks(hint, Flag) if flag.names), "")
    word = names.split()[-1].split("/")[0].lstrip("-").replace("-", "_") if names else name
    return name if iskeyword(word) else word
