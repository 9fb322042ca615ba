"""armsight twin."""

from __future__ import annotations

from typing import Annotated

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import KNOWN_ARM


def twin(
    name: Annotated[str, typer.Argument(metavar="DRIVER", help="alter, rsi, egm or rtde.")],
    port: Annotated[
        str | None, typer.Option(metavar="PORT", help="Where it listens; for alter a name for its serial line.")
    ] = None,
    connect: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="Where the driver listens, for rsi and egm.")
    ] = None,
    arm: Annotated[str | None, typer.Option("--arm", metavar="ARM", help=f"{KNOWN_ARM}.")] = None,
    cycle: Annotated[float | None, typer.Option(min=1e-4, max=1.0, help="The controller's cycle in s.")] = None,
) -> None:
    """Emulate a robot's controller, for tests without a robot; Ctrl-C ends it. Prints what --robot takes."""
    with CommandUI(as_json=False, until_stopped=True) as face:
        from armsight.app.robot.twin import run_twin

        stop = face.progress("twin")
        on = lambda: not stop.cancelled()  # noqa: E731
        run_twin(name, port=port, connect=connect, arm=arm, cycle_s=cycle, on=on, ready=typer.echo, warn=face.say)
