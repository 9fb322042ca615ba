"""armsight console."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import SRC

if TYPE_CHECKING:
    from armsight.server.web_server import ServeOptions

PORT = 8080


def console(
    robot: Annotated[
        str | None,
        typer.Option(metavar="DRIVER:DEVICE", help="The robot to move: sim:SCENARIO, rtde:HOST, rsi:PORT, egm:PORT."),
    ] = None,
    folder: Annotated[
        Path, typer.Option("--folder", metavar="FOLDER", help="Where cell.yaml and all results are kept.")
    ] = Path("cell"),
    left: Annotated[
        str | None, typer.Option(metavar="SRC", help=f"Left frames, or the complex images of a mirror rig: {SRC}.")
    ] = None,
    right: Annotated[
        str | None, typer.Option(metavar="SRC", help="Right frames, in step with the left ones; none with mirrors.")
    ] = None,
    rig: Annotated[str | None, typer.Option(help="rig.yaml, a name inside the folder.")] = None,
    target: Annotated[str | None, typer.Option(help="target.yaml, a name inside the folder.")] = None,
    play_again: Annotated[bool, typer.Option("--play-again", help="Files begin anew at their end.")] = False,
    bind: Annotated[str, typer.Option(help="Address to listen at; any but this machine's needs TLS and tokens.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option(min=1, max=65535, help="Of the web page.")] = PORT,
    stop_port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Of the line for stops. [default: the next one]")
    ] = None,
    tokens: Annotated[Path | None, typer.Option(help="tokens.yaml: who may watch and who may drive.")] = None,
    tls_cert: Annotated[Path | None, typer.Option(help="The server's certificate, PEM.")] = None,
    tls_key: Annotated[Path | None, typer.Option(help="The certificate's key, PEM.")] = None,
) -> None:
    """Serve the operator's web page; stop with Ctrl-C.

    What is given here is kept in FOLDER/cell.yaml, as the page Settings shows it. A simulated robot brings its cell
    along where the folder holds none.
    """
    with CommandUI(as_json=False, until_stopped=True) as face:
        from armsight.server.web_server import ServeOptions, check_options

        at = {"bind": bind, "port": port, "stop_port": stop_port}
        options = ServeOptions(**at, tokens=tokens, tls_cert=tls_cert, tls_key=tls_key)  # type: ignore[arg-type]
        check_options(options)
        given = {"left": left, "right": right, "rig": rig, "target": target, "play_again": play_again or None}
        changed = {name: value for name, value in given.items() if value is not None}
        if robot is None:
            _without_robot(face, folder, changed, options)
        else:
            serve_cell(face, robot, folder, changed, options)


def _without_robot(face: CommandUI, folder: Path, changed: dict[str, Any], options: ServeOptions) -> None:
    from fastapi import FastAPI

    from armsight.app.operator.one_console import one_console
    from armsight.console.application import add_console
    from armsight.console.state import Console
    from armsight.server.serving import serve_pages
    from armsight.server.web_server import listening

    with listening(options.bind, options.port) as listener, one_console(folder):
        made = Console.of_folder(folder)
        try:
            _tell_refusal(face, made.begin(changed))
            server = FastAPI()
            add_console(server, made)
            serve_pages(server, options, listener, ready=lambda url: _say(face, url))
        finally:
            made.close()


def serve_cell(face: CommandUI, robot: str, folder: Path, changed: dict[str, Any], options: ServeOptions) -> None:
    """Serve a robot with its pages, and with the interface for programs beside them, until Ctrl-C.

    changed: entries of the cell's file. Raises what its files, the robot, the address and the disk refuse.
    """
    from armsight.app.operator.one_console import one_console
    from armsight.app.operator.robot_cell import open_robot_cell, prepare_simulated
    from armsight.console.application import add_console
    from armsight.console.state import Console
    from armsight.errors import Cancelled
    from armsight.server.application import create_app
    from armsight.server.auth import Authenticator
    from armsight.server.serving import serve_pages
    from armsight.server.web_server import listening

    cancelled = face.progress("opening").cancelled
    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(listening(options.bind, options.port))
        stack.enter_context(one_console(folder))
        if not changed:
            prepare_simulated(robot, folder)
        face.say(f"{robot} is being opened")
        cell = stack.enter_context(open_robot_cell(robot, folder))
        if cancelled():
            raise Cancelled("stopped before the page was served")
        cell.service.pump()
        if cell.service.outside:
            face.say(f"Note: {cell.service.outside}.")
        made = Console.of_folder(folder, cell)
        try:
            _tell_refusal(face, made.begin(changed, robot=robot))
            server = create_app(cell.service, Authenticator(options.tokens or ()))
            add_console(server, made)
            serve_pages(server, options, listener, ready=lambda url: _say(face, url), service=cell.service)
        finally:
            made.close()


def _tell_refusal(face: CommandUI, refusal: str) -> None:
    if refusal:
        face.say(f"Nothing is measured yet, the page Settings mends it: {refusal}")


def _say(face: CommandUI, url: str) -> None:
    face.say(f"Open {url} in a browser; stop with Ctrl-C")
