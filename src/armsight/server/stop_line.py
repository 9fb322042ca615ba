"""The line for stops: a process and a port that nothing else shares, for the stop and the enable alone.

Pages, pictures, readers, logs and recordings are the web server's, in another process; here nothing waits for them.
What is said on this line goes to the robot's loop through memory of its own.
"""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import os
import pickle
import secrets
import signal
import socket
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import Message
from starlette.websockets import WebSocket, WebSocketDisconnect

from armsight.clock import monotonic_s
from armsight.control.session.channels import TURN_S, Serves, granted
from armsight.control.session.loop_host import LoopEvent
from armsight.drivers.remote import protocol as say
from armsight.errors import ArmsightError, DeviceFailed, DeviceLost, UsageError
from armsight.priority import listen_first
from armsight.server.auth import Authenticator, BrowserSessions, Denied, Identity, address_of, caller_of
from armsight.server.connections import LINE, Connections
from armsight.server.limited import age_of, known_as
from armsight.server.messages import Session
from armsight.server.waiting import listening
from armsight.server.web_server import ServeOptions, web_server

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess
    from multiprocessing.synchronize import Event

    from armsight.control.session.channels import LineChannels
    from armsight.control.session.service import Service

LOOK_S = 0.2
"""How often the server looks whether it has begun."""

BEGIN_S = 60.0
"""Longest wait until it serves: packages are read anew, on a machine that may be busy."""

END_S = 2.0

FOR_STOPS = 32
"""Orders to the loop that enables leave room for."""


class StopLine:
    """Takes stops from everyone who is known, and the enable of who drives, by their key."""

    def __init__(self, channels: LineChannels, auth: Authenticator) -> None:
        self._channels, self._auth = channels, auth

    def app(self) -> Starlette:
        """Return the application: a WebSocket, and the stop as a plain POST."""
        return Starlette(
            routes=[
                WebSocketRoute(say.STOP_PATH, self.serve),
                Route(say.STOP_PATH, self.post, methods=["POST"]),
            ]
        )

    async def post(self, request: Request) -> Response:
        """Stop the robot until it is reset."""
        found = self._auth.check(caller_of(request))
        if isinstance(found, Denied):
            self.note(f"{address_of(request)} was kept out of the line for stops: {found.why}")
            return PlainTextResponse(found.why, found.status)
        self._stop(found)
        return Response(status_code=204)

    async def serve(self, socket: WebSocket) -> None:
        """Take what a caller says until they leave."""
        found = self._auth.check(caller_of(socket))
        if isinstance(found, Denied):
            self.note(f"{address_of(socket)} was kept out of the line for stops: {found.why}")
            await socket.send_denial_response(PlainTextResponse(found.why, found.status))
            return
        known_as(socket.scope, found.who)
        session = Session("stop")
        await socket.accept()
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await socket.send_text(say.LineWelcome(version=say.VERSION, session=session.nonce).model_dump_json())
            while not session.spent:
                message = await socket.receive()
                if message["type"] == "websocket.disconnect":
                    return
                await asyncio.sleep(0)  # what a caller has piled up must not hold up the others
                if not self._auth.knows(found):
                    break
                answer = self._answer(socket, session, found, message)
                await socket.send_text(answer.model_dump_json())
            await socket.close(1008, "against the protocol")

    def _answer(self, socket: WebSocket, session: Session, who: Identity, message: Message) -> say.Done | say.Refused:
        seq = None
        try:
            command = session.admit(message.get("text") or "")
            seq = command.seq
            if isinstance(command, say.Heartbeat):
                self._beat(command, who, age_of(message))
                known_as(socket.scope, who.who, keep=True)  # who drives does not make room for others
            else:
                self._stop(who)
        except ArmsightError as error:
            return say.Refused.of(error, seq)
        return say.Done(reply_to=command.seq)

    def _beat(self, said: say.Heartbeat, who: Identity, age_s: float) -> None:
        lease, key, person = granted(self._channels.grant)
        if not key or not secrets.compare_digest(said.key.encode(), key.encode()):
            raise DeviceFailed("this key does not drive", consequence="Nothing was done", cure="Connect to drive anew")
        if who.role != "drive" or who.who != person:  # the key tells drivers apart, the token is the right to drive
            raise UsageError(f"{who.who} does not drive", cure="Connect to drive")
        self._order("beat", (said.enable, said.number), monotonic_s() - age_s, lease, key)

    def _stop(self, who: Identity) -> None:
        self._order("stop", f"stopped by {who.who}")

    def _order(self, *order: object) -> None:
        if not self._channels.orders.put(pickle.dumps(order), spare=0 if order[0] == "stop" else FOR_STOPS):
            raise DeviceLost("the loop of the robot takes no orders", consequence="Nothing was sent")

    def note(self, message: str) -> None:
        """Tell the server's log; what finds no room there is left out."""
        self._channels.notes.put(pickle.dumps(LoopEvent(t_s=monotonic_s(), level="warning", message=message[:200])))


@contextlib.contextmanager
def stop_line(service: Service, options: ServeOptions, *, page_port: int | None = None) -> Iterator[None]:
    """Serve the line for stops of a robot while the block runs, beside the server that options are of.

    Its port is options.stop_port; where that is None the one after options.port, or any that is free. page_port: of the
    pages that may use it. Raises DeviceFailed where the port that was asked for cannot be had.
    """
    with _listening(options) as listener:
        service.stop_port = listener.getsockname()[1]
        context = multiprocessing.get_context("spawn")
        up = context.Event()
        process = context.Process(
            target=run_stop_line,
            args=(service.host.line, options, listener, page_port, os.getpid(), up),
            name="armsight-stop-line",
            daemon=True,
        )
        process.start()
        try:
            _wait(process, up)
            yield
        finally:
            service.stop_port = None
            process.terminate()
            process.join(END_S)
            if process.is_alive():
                process.kill()
                process.join()


def _wait(process: BaseProcess, up: Event) -> None:
    """Wait until it serves: who comes before would have no line. Raises DeviceFailed where it does not begin."""
    until_s = time.monotonic() + BEGIN_S
    while not up.wait(LOOK_S):
        if time.monotonic() > until_s or not process.is_alive():
            raise DeviceFailed("the line for stops did not begin", consequence="Nothing is served")


def run_stop_line(
    channels: LineChannels,
    options: ServeOptions,
    listener: socket.socket,
    page_port: int | None,
    parent: int,
    up: Event,
) -> None:
    """Serve until the process that started this one ends; up is set once it does."""
    # other work of a busy machine must not keep a stop waiting
    listen_first()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both; the server ends this one in order
    sessions = BrowserSessions(channels.sessions)
    line = StopLine(channels, Authenticator(options.tokens or (), page_port=page_port, sessions=sessions))
    server = web_server(line.app(), options, Connections(line.note, LINE), lifespan=False)

    async def watch() -> None:
        while not (server.started or server.should_exit):
            await asyncio.sleep(0.01)
        up.set()
        while os.getppid() == parent and not server.should_exit:
            channels.turns.turn(Serves.LINE, monotonic_s())
            await asyncio.sleep(TURN_S)
        server.should_exit = True

    async def run() -> None:
        watching = asyncio.create_task(watch())
        await server.serve(sockets=[listener])
        watching.cancel()

    asyncio.run(run())


@contextlib.contextmanager
def _listening(options: ServeOptions) -> Iterator[socket.socket]:
    if options.stop_port is not None or options.port == 0:
        with listening(options.bind, options.stop_port or 0) as listener:
            yield listener
        return
    with contextlib.ExitStack() as stack:
        try:
            listener = stack.enter_context(listening(options.bind, options.port + 1))
        except DeviceFailed:
            listener = stack.enter_context(listening(options.bind, 0))
        yield listener
