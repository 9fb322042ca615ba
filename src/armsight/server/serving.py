"""Serving a robot: its interface for programs, its pages, the line for stops beside both, and `armsight serve`."""

from __future__ import annotations

import contextlib
import gc
import socket
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fastapi import FastAPI

from armsight.control.guard import Limits
from armsight.control.session.service import Service
from armsight.errors import Cancelled
from armsight.ops.requests.motion import RobotJob
from armsight.ops.robot.hosting import ProcessHost, spec_of
from armsight.ops.robot.opening import arm_model, left_open, open_to_all
from armsight.ops.robot.recorder import RecordingLog, require_recorded
from armsight.priority import SERVES, give_way
from armsight.server.application import create_app
from armsight.server.auth import Authenticator, BrowserSessions
from armsight.server.connections import Connections
from armsight.server.gate import Gate
from armsight.server.stop_line import stop_line
from armsight.server.waiting import listening
from armsight.server.web_server import ServeOptions, check_options, web_server
from armsight.store.limits_file import read_limits

if TYPE_CHECKING:
    from armsight.verify.supervision import Seen


def serve(service: Service, options: ServeOptions, *, ready: Callable[[str], None]) -> None:
    """Serve until SIGINT or SIGTERM; ready takes ws://HOST:PORT. Raises as check_options; DeviceFailed."""
    check_options(options)
    auth = Authenticator(options.tokens or ())
    with listening(options.bind, options.port) as listener, stop_line(service, options):
        give_way(SERVES)  # after the loop and the line for stops were begun
        _keep_collections_short()
        server = web_server(create_app(service, auth), options, _connections(service))
        ready(_url(options, listener))
        server.run(sockets=[listener])


def serve_pages(
    app: FastAPI,
    options: ServeOptions,
    listener: socket.socket,
    *,
    ready: Callable[[str], None],
    service: Service | None = None,
) -> None:
    """Serve an application with pages, behind the gate, until SIGINT or SIGTERM; ready is called with http://HOST:PORT.

    listener: of listening, opened before anything that takes long, so that a port in use is told at once. service: of
    the robot that the pages move, which gets its line for stops. Raises as check_options.
    """
    check_options(options)
    # one for the pages and for the programs beside them
    auth: Authenticator = getattr(app.state, "auth", None) or Authenticator(options.tokens or ())
    if service is not None:
        auth.sessions = BrowserSessions(service.host.line.sessions)
    gate = Gate(app, auth)
    with contextlib.ExitStack() as stack:
        if service is not None:
            stack.enter_context(stop_line(service, options, page_port=listener.getsockname()[1]))
        give_way(SERVES)
        _keep_collections_short()
        server = web_server(gate, options, _connections(service))
        ready(_url(options, listener).replace("ws", "http", 1))
        server.run(sockets=[listener])


@contextlib.contextmanager
def background(service: Service, options: ServeOptions | None = None, *, with_stop_line: bool = False) -> Iterator[str]:
    """Serve from a thread while the block runs; gives the address. Raises as serve."""
    options = options or ServeOptions(port=0)
    check_options(options)
    auth = Authenticator(options.tokens or ())
    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(listening(options.bind, options.port))
        if with_stop_line:
            stack.enter_context(stop_line(service, options))
        server = web_server(create_app(service, auth), options, _connections(service))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, name="armsight-serve")
        thread.start()
        try:
            yield _url(options, listener)
        finally:
            server.should_exit = True
            thread.join()


def _keep_collections_short() -> None:
    """Leave what was loaded out of the collections of garbage: a look through all of it takes half a second, in which
    nobody is answered and an enable grows too old."""
    gc.collect()
    gc.freeze()


def _connections(service: Service | None) -> Connections:
    """Return the limits of callers; what is closed is told in the robot's log, where there is one."""
    return Connections((lambda _: None) if service is None else (lambda what: service.authority.note("warning", what)))


def _url(options: ServeOptions, listener: socket.socket) -> str:
    host = f"[{options.bind}]" if ":" in options.bind else options.bind
    return f"{options.scheme}://{host}:{listener.getsockname()[1]}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Terminal:
    """Who started a server. ready: called once all is there with the address, and which limits the arm stands outside
    of, in words, nothing within; tell: takes what they should hear; cancelled: whether they want it ended."""

    ready: Callable[[str, str], None]
    tell: Callable[[str], None]
    cancelled: Callable[[], bool] = lambda: False


def published_to_plant(
    service: Service, options: ServeOptions, tell: Callable[[str], None], seen: Callable[[], Seen | None] = lambda: None
) -> contextlib.AbstractContextManager[None]:
    """Return what publishes a robot for the plant's systems while its block runs, where options ask for it."""
    return contextlib.nullcontext() if options.plant is None else options.plant.served(service, tell, seen)


def serve_robot(
    job: RobotJob, arm: str | None, options: ServeOptions, log: Path, *, limits: Path | None = None, terminal: Terminal
) -> None:
    """Serve a robot until SIGINT or SIGTERM.

    arm: its file or a preset's name. limits: limits.yaml of the guard. Raises what check_options, arm_model, the
    driver, the disk and the plant's addresses refuse; DeviceFailed at the end where the disk took no more meanwhile.
    """
    check_options(options)
    model = arm_model(job.robot, arm)
    spec = spec_of(job, model, Limits() if limits is None else read_limits(limits))
    with RecordingLog(log) as kept, ProcessHost(spec) as host:
        if terminal.cancelled():
            raise Cancelled("stopped before the robot was served")
        service = Service(host, kept)
        service.authority.note("info", f"{job.robot} is served")
        service.pump()  # what the loop told as it took the arm over
        with published_to_plant(service, options, terminal.tell):
            notes = (service.outside, "" if limits is None else left_open(spec.limits, limits.name), open_to_all(job))
            serve(service, options, ready=lambda url: terminal.ready(url, "; ".join(filter(None, notes))))
        service.authority.note("info", "the server ends")
        service.pump()
    require_recorded(kept.failed)
