"""armsight serve, and armsight console."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from armsight.cli.command import app, command
from armsight.cli.command_ui import CommandUI
from armsight.errors import Cancelled, UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.flags import AN_ARM, KNOWN_ARM, SRC, cameras_of
from armsight.ops.requests.motion import FollowedCell, RobotJob, RobotSettings, RsiConfig
from armsight.ops.requests.plant import PLANT, PlantFlags

if TYPE_CHECKING:
    from armsight.server.waiting import WaitingPage
    from armsight.server.web_server import ServeOptions

Bind: TypeAlias = Annotated[str, Doc("Address to listen at; any but this machine's needs TLS and tokens.")]
StopPort: TypeAlias = Annotated[
    int | None,
    Doc("Port of the line for stops; 0 takes a free one. [default: the next one]"),
    Bounds(least=0, most=65535),
]
Tokens: TypeAlias = Annotated[Path | None, Doc("tokens.yaml: who may watch, acknowledge alarms, and drive.")]
Certificate: TypeAlias = Annotated[Path | None, Doc("The server's certificate, PEM.")]
Key: TypeAlias = Annotated[Path | None, Doc("The certificate's key, PEM.")]


CellLeft: TypeAlias = Annotated[
    str | None, Doc(f"Left frames, or the complex images of a mirror rig: {SRC}."), Flag(metavar="SRC")
]
CellRight: TypeAlias = Annotated[
    str | None, Doc("Right frames, in step with the left ones; none with mirrors."), Flag(metavar="SRC")
]
CellCameras: TypeAlias = Annotated[
    Any,
    Doc("Frames of a camera by its name in rig.yaml; repeated. --left SRC is short for left=SRC."),
    Flag("--camera", metavar="NAME=SRC", read=cameras_of, repeated=True),
]


@command(app, json=False, panels=(PLANT,))
def serve(
    face: CommandUI,
    plant: PlantFlags,
    robot: Annotated[
        str | None,
        Doc("The robot: sim:SCENARIO, rtde:HOST, rsi:PORT, egm:PORT, alter:PORT, feetech:PORT, dynamixel:PORT."),
        Flag(metavar="DRIVER:DEVICE"),
    ] = None,
    bind: Bind = "127.0.0.1",
    port: Annotated[int, Doc("Port to listen at; 0 takes a free one."), Bounds(least=0, most=65535)] = 8765,
    stop_port: StopPort = None,
    tokens: Tokens = None,
    tls_cert: Certificate = None,
    tls_key: Key = None,
    arm: Annotated[str | None, Doc(f"{KNOWN_ARM}; a simulated robot brings its own."), AN_ARM] = None,
    limits: Annotated[Path | None, Doc("limits.yaml: what the guard keeps. [default: its own]")] = None,
    robot_settings: RobotSettings = None,
    rsi_config: RsiConfig = None,
    log: Annotated[
        Path | None,
        Doc("Recording of commands, events and readings. [default: a new file here]"),
        Flag(metavar="FILE.mcap"),
    ] = None,
    console: Annotated[
        Path | None,
        Doc("Serve the operator's pages as well, of the cell in FOLDER; its arm and limits count."),
        Flag(metavar="FOLDER"),
    ] = None,
    make_certificate: Annotated[
        Path | None,
        Doc("Make a self-signed certificate and its key for OPC UA in FOLDER, and end."),
        Flag(metavar="FOLDER", panel=PLANT),
    ] = None,
    add_token: Annotated[
        str | None,
        Doc("Add a token for watch, acknowledge or drive to --tokens, print it once, and end."),
        Flag(metavar="NAME:ROLE"),
    ] = None,
) -> None:
    """Serve a robot: this program alone talks to its controller and guards it; others watch, stop and drive it."""
    face.until_stopped = True
    from armsight.ops.robot.recorder import default_log
    from armsight.registry import PLANT, extension
    from armsight.server.serving import Terminal, serve_robot
    from armsight.server.web_server import ServeOptions

    if add_token is not None:
        _add_token(face, tokens, add_token)
        return
    if make_certificate is not None:
        pair = extension(PLANT, "make-pair", "plant")(make_certificate)
        face.say(f"{' and '.join(map(str, pair))}: the certificate goes to clients")
        return
    if robot is None:
        raise UsageError("no robot is named", consequence="Nothing is served", cure="Give --robot DRIVER:DEVICE")
    told = plant.made(face.say, tokens)
    at = {"bind": bind, "port": port, "stop_port": stop_port}
    options = ServeOptions(**at, tokens=tokens, tls_cert=tls_cert, tls_key=tls_key, plant=told)  # type: ignore[arg-type]
    if console is not None:
        job = RobotJob(robot=robot, robot_settings=robot_settings, rsi_config=rsi_config)
        _with_pages(face, job, console, options, {"arm": arm, "limits": limits, "log": log})
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
        RobotJob(robot=robot, robot_settings=robot_settings, rsi_config=rsi_config),
        arm,
        options,
        kept,
        limits=limits,
        terminal=Terminal(ready=ready, tell=face.say, cancelled=face.progress("starting").cancelled),
    )


def _with_pages(
    face: CommandUI,
    robot: RobotJob,
    folder: Path,
    options: ServeOptions,
    own: dict[str, object],
) -> None:
    """Serve programs and the operator's pages with one loop, one right to drive, and the same tokens."""
    from armsight.console import texts
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
    from armsight.store.tokens import add_token

    if tokens is None:
        raise UsageError("no token file is named", consequence="No token was made", cure="Give --tokens FILE")
    name, _, role = text.rpartition(":")
    token = add_token(tokens, name, role)
    face.say(f"{name} may {role} with this token; it is kept nowhere, {tokens} holds its hash:")
    typer.echo(token)


@command(app, json=False)
def console(
    face: CommandUI,
    robot: Annotated[
        str | None,
        Doc("The robot to move: sim:SCENARIO, rtde:HOST, rsi:PORT, egm:PORT, feetech:PORT."),
        Flag(metavar="DRIVER:DEVICE"),
    ] = None,
    robot_settings: RobotSettings = None,
    rsi_config: RsiConfig = None,
    follow: FollowedCell = None,
    folder: Annotated[Path, Doc("Where cell.yaml and all results are kept."), Flag(metavar="FOLDER")] = Path("cell"),
    left: CellLeft = None,
    right: CellRight = None,
    cameras: CellCameras = None,
    rig: Annotated[str | None, Doc("rig.yaml, a name inside the folder.")] = None,
    target: Annotated[str | None, Doc("target.yaml, a name inside the folder.")] = None,
    play_again: Annotated[bool, Doc("Files begin anew at their end.")] = False,
    bind: Bind = "127.0.0.1",
    port: Annotated[int, Doc("Of the web page."), Bounds(least=1, most=65535)] = 8080,
    stop_port: StopPort = None,
    tokens: Tokens = None,
    tls_cert: Certificate = None,
    tls_key: Key = None,
) -> None:
    """Serve the operator's web page; stop with Ctrl-C.

    What is given here is kept in FOLDER/cell.yaml, as the page Settings shows it. A simulated robot brings its cell
    along where the folder holds none.
    """
    face.until_stopped = True
    with _opening(bind, port, tls_cert is not None) as page:
        from armsight.server.web_server import ServeOptions, check_options

        at = {"bind": bind, "port": port, "stop_port": stop_port}
        options = ServeOptions(**at, tokens=tokens, tls_cert=tls_cert, tls_key=tls_key)  # type: ignore[arg-type]
        check_options(options)
        given = {"left": left, "right": right, "cameras": cameras or None, "rig": rig, "target": target}
        given["play_again"] = play_again or None
        changed = {name: value for name, value in given.items() if value is not None}
        if (job := _of_robot(robot, robot_settings, rsi_config, follow)) is None:
            _without_robot(face, folder, changed, options, page)
        else:
            serve_cell(face, job, folder, changed, options, page)


def _of_robot(
    robot: str | None, settings: RobotSettings, rsi_config: Path | None, follow: str | None
) -> RobotJob | None:
    """Return the robot, None where none is named. Raises UsageError for settings of none."""
    if robot is not None:
        return RobotJob(robot=robot, robot_settings=settings, rsi_config=rsi_config, follow=follow)
    if settings is not None or rsi_config is not None or follow is not None:
        raise UsageError(
            "--robot-set, --rsi-config and --follow are of a robot, and none is named",
            consequence="Nothing is served",
            cure="Give --robot DRIVER:DEVICE",
        )
    return None


@contextlib.contextmanager
def _opening(bind: str, port: int, secure: bool) -> Iterator[WaitingPage]:
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
            server = FastAPI(openapi_url=None)  # whose pages load scripts from elsewhere
            add_console(server, made)
            serve_pages(server, options, page.listener, ready=partial(_say, face, page=page))
        finally:
            made.close()


def serve_cell(
    face: CommandUI,
    job: RobotJob,
    folder: Path,
    changed: dict[str, Any],
    options: ServeOptions,
    page: WaitingPage,
) -> None:
    """Serve a robot with its pages, and with the interface for programs beside them, until Ctrl-C.

    changed: entries of the cell's file. page: told what is done until the pages are there. Raises what its files, the
    robot, the address and the disk refuse.
    """
    from armsight.app.operator.robot_cell import one_console, open_robot_cell, prepare_simulated
    from armsight.console import texts
    from armsight.console.application import add_console
    from armsight.console.state import Console
    from armsight.server.application import create_app
    from armsight.server.auth import Authenticator
    from armsight.server.serving import published_to_plant, serve_pages

    robot, cancelled = job.robot, face.progress("opening").cancelled
    with contextlib.ExitStack() as stack:
        stack.enter_context(one_console(folder))
        if not changed:
            prepare_simulated(job, folder)
        face.say(f"{robot} is being opened")
        page.step(texts.OPENING["robot"].format(robot=robot))
        cell = stack.enter_context(open_robot_cell(job, folder))
        if cancelled():
            raise Cancelled("stopped before the page was served")
        cell.service.pump()
        for note in filter(None, (cell.service.outside, *cell.notes)):
            face.say(f"Note: {note}.")
        made = Console.of_folder(folder, cell)
        try:
            page.step(texts.OPENING["measure"])
            _tell_refusal(face, made.begin(changed, robot=robot))
            server = create_app(cell.service, Authenticator(options.tokens or ()))
            add_console(server, made)
            ready = partial(_say, face, page=page)
            with published_to_plant(cell.service, options, face.say, made.seen):
                serve_pages(server, options, page.listener, ready=ready, service=cell.service)
        finally:
            made.close()


def _tell_refusal(face: CommandUI, refusal: str) -> None:
    if refusal:
        face.say(f"Nothing is measured yet, the page Settings mends it: {refusal}")


def _say(face: CommandUI, url: str, *, page: WaitingPage) -> None:
    page.close()  # from here the server answers
    face.say(f"Open {url} in a browser; stop with Ctrl-C")
