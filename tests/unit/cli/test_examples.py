"""The examples below each command's help can be typed."""

from __future__ import annotations

import shlex

import click
import pytest
from typer.main import get_command
from typer.testing import CliRunner

from armsight.cli.commands import app
from armsight.cli.examples import EXAMPLES

ROOT = get_command(app)


@pytest.mark.parametrize("example", [text for texts in EXAMPLES.values() for text in texts])
def test_each_example_is_taken(example: str) -> None:
    words = shlex.split(example)
    assert words[0] == "armsight"
    parent, command = click.Context(ROOT), ROOT
    while hasattr(command, "commands"):
        words = words[1:]
        command = command.commands[words[0]]
    context = command.make_context(words[0], words[1:], parent=parent)  # raises where a flag is not known or missing
    assert context.params


def test_help_shows_them_and_the_overview_has_panels_and_completion() -> None:
    run = CliRunner().invoke
    shown = run(app, ["robot", "test", "--help"]).output
    assert EXAMPLES["robot test"][0] in shown
    overview = run(app, ["--help"]).output
    for text in ("Begin", "Calibrate and identify", "Robots", "--install-completion"):
        assert text in overview
    names = set(EXAMPLES)
    leaves = {f"{n} {m}" for n, c in ROOT.commands.items() if hasattr(c, "commands") for m in c.commands}
    assert names == leaves | {n for n, c in ROOT.commands.items() if not hasattr(c, "commands")}
