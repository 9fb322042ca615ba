"""armsight serve."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.options import KNOWN_ARM

if TYPE_CHECKING:
    from armsight.server.web_server import ServeOptions


def serve(
    robot: Annotated[
        str | None,
        typer.Option(
            metavar="DRIVER:DEVICE", help="The robot: sim:SCENARIO, rtde:HOST, rsi:PORT, egm:PORT, alter:PORT."
        ),
    ] = None,
    bind: Annotated[str, typer.Option(help="Address to listen at; any but this machine's needs TLS and tokens.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen at; 0 takes a free one.")] = 8765,
    stop_port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Port of the line for stops; 0 takes a free one. [default: the next one]"),
    ] = None,
    tokens: Annotated[Path | None, typer.Option(help="tokens.yaml: who may watch and who may drive.")] = None,
    tls_cert: Annotated[Path | None, typer.Option(help="The server's certificate, PEM.")] = None,
    tls_key: Annotated[Path | None, typer.Option(help="The certificate's key, PEM.")] = None,
    arm: Annotated[
        str | None, typer.Option(metavar="ARM", help=f"{KNOWN_ARM}; a simulated robot brings its own.")
    ] = None,
    limits: Annotated[Path | None, typer.Option(help="limits.yaml: what the guard keeps. [default: its own]")] = None,
    rsi_config: Annotated[
        Path | None, typer.Option(metavar="FILE.xml", help="Of rsi: the RSI Ethernet configuration, for its own tags.")
    ] = None,
    log: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.mcap", help="Recording of commands, events and readings. [default: a new file here]"
        ),
    ] = None,
    console: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Serve the operator's pages as well, of the cell in FOLDER; its arm and limits count.",
        ),
    ] = None,
    add_token: Annotated[
        str | None,
        typer.Option(metavar="NAME:ROLE", help="Add a token for watch or drive to --tokens, print it once, and end."),
    ] = None,
) -> None:
    """Serve a robot: this program alone talks to its controller and guards it; others watch, stop and drive it."""
    with CommandUI(as_json=False, until_stopped=True) as face:
        from armsight.app.robot.recorder import default_log
        from armsight.errors import UsageError
        from armsight.server.serving import serve_robot
        from armsight.server.web_server import ServeOptions

        if add_token is not None:
            _add_token(face, tokens, add_token)
            return
        if robot is None:
            raise UsageError("no robot is named", consequence="Nothing is served", cure="Give --robot DRIVER:DEVICE")
        options = ServeOptions(
            bind=bind, port=port, stop_port=stop_port, tokens=tokens, tls_cert=tls_cert, tls_key=tls_key
        )
        if console is not None:
            _with_pages(
                face, robot, console, options, {"arm": arm, "limits": limits, "rsi-config": rsi_config, "log": log}
            )
            return
        kept = log or default_log()

        def ready(url: str, outside: str) -> None:
            face.say(f"{robot} is served at {url}; what happens is kept in {kept}. Ctrl-C ends it.")
            if outside:
                face.say(f"Note: {outside}.")
            if tokens is None:
                face.say("Without --tokens everyone on this machine may drive.")
            face.say("This is no safety function: the emergency stop stands beside it.")

        serve_robot(
            robot,
            arm,
            options,
            kept,
            limits=limits,
            rsi_config=rsi_config,
            ready=ready,
            cancelled=face.progress("starting").cancelled,
        )


def _with_pages(face: CommandUI, robot: str, folder: Path, options: ServeOptions, own: dict[str, object]) -> None:
    """Serve programs and the operator's pages with one loop, one right to drive, and the same tokens."""
    from armsight.cli.console import serve_cell
    from armsight.console import texts
    from armsight.errors import UsageError
    from armsight.server.waiting import waiting_page
    from armsight.server.web_server import check_options

    given = [f"--{name}" for name, value in own.items() if value is not None]
    if given:
        raise UsageError(
            f"{' and '.join(given)} beside --console",
            consequence="Nothing is served",
            cure=f"Name the files in {folder}/cell.yaml, or on the page Settings: they count from the next start on",
        )
    check_options(options)
    with waiting_page(options.bind, options.port, texts.TITLE, secure=options.tls_cert is not None) as page:
        serve_cell(face, robot, folder, {}, options, page)


def _add_token(face: CommandUI, tokens: Path | None, text: str) -> None:
    """Print a new token on standard output, and nothing else there."""
    from armsight.errors import UsageError
    from armsight.store.tokens import add_token

    if tokens is None:
        raise UsageError("no token file is named", consequence="No token was made", cure="Give --tokens FILE")
    name, _, role = text.rpartition(":")
    token = add_token(tokens, name, role)
    face.say(f"{name} may {role} with this token; it is kept nowhere, {tokens} holds its hash:")
    typer.echo(token)
