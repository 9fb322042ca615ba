"""armsight report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from armsight.cli.command_ui import CommandUI


def report(
    report: Annotated[Path, typer.Argument(metavar="REPORT", help="A report.html, or the folder that it is in.")],
    pdf: Annotated[bool, typer.Option("--pdf", help="Print it as PDF, by a Chromium, Chrome or Edge.")] = False,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="FILE", help="The PDF. [default: beside the report]")
    ] = None,
) -> None:
    """Print a report as PDF; any browser opens the report itself."""
    with CommandUI(as_json=False) as face:
        from armsight.app.print_report import print_report
        from armsight.errors import UsageError

        if not pdf:
            raise UsageError("it is not said what becomes of the report", cure="Give --pdf")
        face.say(f"Printed: {print_report(report, out)}")
