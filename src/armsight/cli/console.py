"""armsight console."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import SRC

if TYPE_CHECKING:
    from armsight.server.waiting import WaitingPage
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
    with CommandUI(as_json=False, until_stopped=True) as face, _opening(bind, port, tls_cert is not None) as page:
        from armsight.server.web_server import ServeOptions, check_options

        at = {"bind": bind, "port": port, "stop_port": stop_port}
        options = ServeOptions(**at, tokens=tokens, tls_cert=tls_cert, tls_key=tls_key)  # type: ignore[arg-type]
        check_options(options)
        given = {"left": left, "right": right, "rig": rig, "target": target, "play_again": play_again or None}
        changed = {name: value for name, value in given.items() if value is not None}
        if robot is None:
            _without_robot(face, folder, changed, options, page)
        else:
            serve_cell(face, robot, folder, changed, options, page)


@contextlib.contextmanager
def _opening(bind: str, port: int, secure: bool) -> Iterator[WaitingPage]:
    """Give the page that is there before anything else is loaded."""
    from armsight.console import texts
    from armsight.server.waiting import waiting_page

    with waiting_page(bind, port, texts.TITLE, secure=secure) as page:
        page.step(texts.OPENING["load"])
        yield page


def _without_robot(
    face: CommandUI, folder: Path, changed: dict[str, Any], options: ServeOptions, page: WaitingPage
) -> None:
    from fastapi import FastAPI

    from armsight.app.operator.robot_cell import one_console
    from armsight.console import texts
    from armsight.console.application import add_console
    from armsight.console.state import Console
    from armsight.server.serving import serve_pages

    with one_console(folder):
        made = Console.of_folder(folder)
        try:
            page.step(texts.OPENING["measure"])
            _tell_refusal(face, made.begin(changed))
            server = FastAPI()
            add_console(server, made)
            serve_pages(server, options, page.listener, ready=partial(_say, face, page=page))
        finally:
            made.close()


def serve_cell(
    face: CommandUI, robot: str, folder: Path, changed: dict[str, Any], options: ServeOptions, page: WaitingPage
) -> None:
    """Serve a robot with its pages, and with the interface for programs beside them, until Ctrl-C.

    changed: entries of the cell's file. page: told what is done until the pages are there. Raises what its files, the
    robot, the address and the disk refuse.
    """
    from armsight.app.operator.robot_cell import one_console, open_robot_cell, prepare_simulated
    from armsight.console import texts
    from armsight.console.application import add_console
    from armsight.console.state import Console
    from armsight.errors import Cancelled
    from armsight.server.application import create_app
    from armsight.server.auth import Authenticator
    from armsight.server.serving import serve_pages

    cancelled = face.progress("opening").cancelled
    with contextlib.ExitStack() as stack:
        stack.enter_context(one_console(folder))
        if not changed:
            prepare_simulated(robot, folder)
        face.say(f"{robot} is being opened")
        page.step(texts.OPENING["robot"].format(robot=robot))
        cell = stack.enter_context(open_robot_cell(robot, folder))
        if cancelled():
            raise Cancelled("stopped before the page was served")
        cell.service.pump()
        if cell.service.outside:
            face.say(f"Note: {cell.service.outside}.")
        made = Console.of_folder(folder, cell)
        try:
            page.step(texts.OPENING["measure"])
            _tell_refusal(face, made.begin(changed, robot=robot))
            server = create_app(cell.service, Authenticator(options.tokens or ()))
            add_console(server, made)
            told = partial(_say, face, page=page)
            serve_pages(server, options, page.listener, ready=told, service=cell.service)
        finally:
            made.close()


def _tell_refusal(face: CommandUI, refusal: str) -> None:
    if refusal:
        face.say(f"Nothing is measured yet, the page Settings mends it: {refusal}")


def _say(face: CommandUI, url: str, *, page: WaitingPage) -> None:
    page.close()  # from here the server answers
    face.say(f"Open {url} in a browser; stop with Ctrl-C")
