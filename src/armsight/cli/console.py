"""armsight console."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import SRC

PORT = 8080


def console(
    folder: Annotated[
        Path, typer.Option("--folder", metavar="FOLDER", help="Where cell.yaml and all results are kept.")
    ] = Path("cell"),
    left: Annotated[str | None, typer.Option(metavar="SRC", help=f"Left frames: {SRC}.")] = None,
    right: Annotated[str | None, typer.Option(metavar="SRC", help="Right frames, in step with the left ones.")] = None,
    rig: Annotated[str | None, typer.Option(help="rig.yaml, a name inside the folder.")] = None,
    target: Annotated[str | None, typer.Option(help="target.yaml, a name inside the folder.")] = None,
    play_again: Annotated[bool, typer.Option("--play-again", help="Files begin anew at their end.")] = False,
    port: Annotated[int, typer.Option(min=1, max=65535, help="Of the web page, on this machine.")] = PORT,
) -> None:
    """Serve the operator's web page on this machine; stop with Ctrl-C.

    What is given here is kept in FOLDER/cell.yaml, as the page Settings shows it.
    """
    with CommandUI(as_json=False) as face:
        from armsight.console.application import serve_console
        from armsight.console.state import Console

        given = {"left": left, "right": right, "rig": rig, "target": target, "play_again": play_again or None}
        made = Console.of_folder(folder)
        made.apply(made.cell.model_copy(update={name: value for name, value in given.items() if value is not None}))
        face.say(f"Open http://127.0.0.1:{port} in a browser; stop with Ctrl-C")
        serve_console(made, port)
