"""What these tests share with the server's: a loop and a log in memory, tokens, a certificate; and raw sockets."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from armsight.server.auth import Authenticator
from armsight.store.tokens import add_token, read_tokens
from loading import module_of

ROOT = Path(__file__).resolve().parents[2]
WAIT_S = 20.0

_server = module_of(ROOT / "tests/unit/server/conftest.py")
certificate, host, log, service = _server.certificate, _server.host, _server.log, _server.service


class Tokens:
    """A file with one token for each role: `drive` of ann, `watch` of eve."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.drive, self.watch = add_token(file, "ann", "drive"), add_token(file, "eve", "watch")
        self.auth = Authenticator(read_tokens(file))


@pytest.fixture
def tokens(tmp_path: Path) -> Tokens:
    return Tokens(tmp_path / "tokens.yaml")


@pytest.fixture
def said() -> Callable[[str, bytes], bytes]:
    """Return what a server at ws://HOST:PORT answers to bytes that are sent to it, up to its end or the answer's."""

    def say(url: str, request: bytes) -> bytes:
        where, _, port = url.rpartition("//")[2].rpartition(":")
        with socket.create_connection((where, int(port)), timeout=WAIT_S) as line:
            line.sendall(request)
            answer = b""
            while b"\r\n\r\n" not in answer:
                more = line.recv(65536)
                if not more:
                    break
                answer += more
            return answer

    return say


@contextmanager
def _running(server: Any, listener: socket.socket) -> Iterator[None]:
    """Run a web server in a thread while the block runs."""
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    try:
        yield
    finally:
        server.should_exit = True
        thread.join()


@pytest.fixture(scope="session")
def fakes() -> Any:
    """The loop and log in memory, for those who make a server of their own; and what runs one."""
    return SimpleNamespace(FakeHost=_server.FakeHost, KeptLog=_server.KeptLog, running=_running)


@pytest.fixture(scope="module")
def patient() -> Iterator[None]:
    """Wait long for heads, pongs and parsing: clients that a busy machine lets wait are no attack, nor is what the
    collection of this process' garbage takes while bytes are parsed."""
    with pytest.MonkeyPatch.context() as patched:
        for name in ("connections.HEAD_S", "limited.HEAD_S", "limited.PARSING_BURST_S", "web_server.PING_S"):
            patched.setattr(f"armsight.server.{name}", 10.0 * WAIT_S)
        yield


@pytest.fixture(scope="module")
def new_nicegui() -> Iterator[None]:
    """NiceGUI keeps one application a process: a second server in the same one needs it as it was before the first."""
    from nicegui import Client, core

    routes = list(core.app.routes)
    yield
    core.app.middleware_stack = None
    core.app.user_middleware.clear()
    core.app.routes[:] = routes
    Client.instances.clear()


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory, fakes: Any, new_nicegui: None, patient: None) -> Iterator[Any]:
    """A console with a robot in memory behind its door, and its line for stops; tokens: drive of ann, watch of eve."""
    from armsight.app.operator.robot_cell import RobotCell
    from armsight.console.application import add_console
    from armsight.console.state import Console
    from armsight.control.guard import Limits
    from armsight.control.session.operator_session import OperatorSession
    from armsight.control.session.service import Service
    from armsight.server.application import create_app
    from armsight.server.connections import LINE, Connections
    from armsight.server.gate import Gate
    from armsight.server.stop_line import StopLine
    from armsight.server.waiting import listening
    from armsight.server.web_server import ServeOptions, web_server

    folder = tmp_path_factory.mktemp("cell")
    file = folder.parent / f"{folder.name}-tokens.yaml"
    drive, watch = add_token(file, "ann", "drive"), add_token(file, "eve", "watch")
    host, log = fakes.FakeHost(), fakes.KeptLog()
    service = Service(host, log)
    robot = RobotCell(robot="fake:0", service=service, session=OperatorSession(service), limits=Limits())
    auth = Authenticator(read_tokens(file))
    app = create_app(service, auth)
    console = Console(folder=folder, robot=robot)
    add_console(app, console)
    line_auth = Authenticator(read_tokens(file))
    options, line = ServeOptions(port=0), StopLine(host.line, line_auth).app()
    with listening("127.0.0.1", 0) as listener, listening("127.0.0.1", 0) as stops:
        server = web_server(Gate(app, auth), options, Connections(lambda _: None))
        line_server = web_server(line, options, Connections(lambda _: None, LINE), lifespan=False)
        with fakes.running(server, listener), fakes.running(line_server, stops):
            at, line_at = (f"127.0.0.1:{one.getsockname()[1]}" for one in (listener, stops))
            yield SimpleNamespace(
                at=f"http://{at}", socket=f"ws://{at}", line=f"ws://{line_at}", folder=folder, host=host, log=log,
                app=app, auth=auth, line_auth=line_auth, service=service, drive=drive, watch=watch, console=console,
                robot=robot,
            )  # fmt: skip
