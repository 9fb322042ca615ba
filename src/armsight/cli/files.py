"""armsight reproduce and report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from armsight.cli.actions import add_action
from armsight.cli.command import app, command, convert
from armsight.cli.command_ui import CommandUI
from armsight.errors import UsageError
from armsight.fields import Doc, Flag
from armsight.ops.machine import reproduce


def _kinds(wanted: bool) -> None:
    """Print the kinds of files that are known."""
    if wanted:
        from armsight.ops.file_kinds import listing

        for line in listing():
            typer.echo(line)
        raise typer.Exit


@convert.callback()
def _convert(
    listed: Annotated[
        bool, typer.Option("--list", callback=_kinds, is_eager=True, help="List the kinds of files, and stop.")
    ] = False,
) -> None:
    """Convert between armsight's files and those of other programs."""


add_action(app, reproduce, keeps=("reproduce.json", "report.html"))


@command(app, json=False)
def report(
    face: CommandUI,
    report: Annotated[
        Path, Doc("A report.html, or the folder that it is in."), Flag(positional=True, metavar="REPORT")
    ],
    pdf: Annotated[bool, Doc("Print it as PDF, by a Chromium, Chrome or Edge.")] = False,
    out: Annotated[Path | None, Doc("The PDF. [default: beside the report]"), Flag("-o --out", metavar="FILE")] = None,
) -> None:
    """Print a report as PDF; any browser opens the report itself."""
    from armsight.ops.print_report import print_report

    if not pdf:
        raise UsageError("it is not said what becomes of the report", cure="Give --pdf")
    face.say(f"Printed: {print_report(report, out)}")
