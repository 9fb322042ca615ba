"""The web application of a robot server: state over HTTP, watching and driving over WebSockets from opening to end."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import AsyncIterator
from html import escape
from typing import Annotated, Any, Literal

from fastapi import Depends, FastAPI, HTTPException, Request, WebSocket
from fastapi.responses import HTMLResponse
from starlette.responses import PlainTextResponse
from starlette.websockets import WebSocketDisconnect, WebSocketState

from armsight._version import __version__
from armsight.control.session.authority import Lease
from armsight.control.session.loop_host import SETPOINT_S
from armsight.control.session.service import Service
from armsight.control.setpoints import Taken
from armsight.drivers.remote import protocol as say
from armsight.errors import ArmsightError, DeviceFailed, UsageError
from armsight.server.auth import Authenticator, Caller, Denied, Identity, address_of, caller_of
from armsight.server.limited import LimitedWebSocket, age_of, connection_of, known_as
from armsight.server.messages import VIOLATIONS, Session, accepted, command_of, event_message, state_message

STATE_S = 0.05
"""How often a client is told the state without asking: as often as a person sees a change."""

TAKEN = 4009
"""Close code: another one drives."""

BROKE_RULES = 1008
TOO_LONG = 1009
"""Close codes of RFC 6455: against the rules, and a message that is too long."""

WATCHERS, WATCHERS_PER_ADDRESS = 32, 16
"""Connections that watch at a time; one more, and the busiest makes room. Who drives is not counted among them."""

TAKEN_OUT = "its token was taken out"

CROWDED = 1013
"""Close code: try again later."""


class Connection:
    """One client. Answers go out in the order of the messages; states and events in between, the newest only."""

    def __init__(
        self,
        service: Service,
        auth: Authenticator,
        socket: WebSocket,
        caller: Caller,
        *,
        role: Literal["watch", "drive"],
    ) -> None:
        self._service = service
        self._authority = service.authority
        self._auth = auth
        self._socket = socket
        self._caller = caller
        self._role = role
        self._who = ""
        self._found = Identity(who="", role="watch")
        self._lease: Lease | None = None

    async def serve(self) -> None:
        """Let the client in, or tell why not; take its messages until it leaves. Its leaving holds the robot."""
        if not await self._enter():
            return
        session = Session(self._role)
        sender, why = None, "the server ended"
        try:
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):  # it may be gone by now
                await self._send(self._welcome(session))
            sender = asyncio.create_task(self._send_news())
            why = await self._listen(session)
        finally:
            if self._lease is not None:
                self._authority.leave(self._lease, why)  # first of all, and at once: nothing is awaited before it
            self._count_out()
            if sender is not None:
                sender.cancel()
                with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                    await sender

    async def _enter(self) -> bool:
        found = self._auth.check(self._caller)
        if not isinstance(found, Denied) and self._role == "drive" and found.role != "drive":
            found = Denied(status=403, why=f"{found.who} may watch, not drive")
        if isinstance(found, Denied):
            self._authority.note("warning", f"{self._caller.address} was kept out: {found.why}")
            await self._deny(found)
            return False
        self._found, self._who = found, f"{found.who}@{self._caller.address}"
        known_as(self._socket.scope, found.who, keep=self._role == "drive")
        if self._role == "drive":
            try:
                self._lease = self._authority.take(self._who, found.who)
            except DeviceFailed as error:
                self._authority.note("warning", f"{self._who} was refused to drive: {error.cause}")
                await self._socket.accept()
                await self._send(say.Refused.of(error, None))
                await self._socket.close(TAKEN, error.cause[:120])
                return False
        try:
            await self._socket.accept()
        except BaseException:
            if self._lease is not None:
                self._authority.leave(self._lease, "its connection ended")
            raise
        self._count_in()
        return True

    @property
    def address(self) -> str:
        """Where it comes from."""
        return self._caller.address

    @property
    def load(self) -> float:
        """How many messages it sent lately."""
        line = connection_of(self._socket.scope)
        return line.load() if isinstance(line, LimitedWebSocket) else 0.0

    def turn_out(self) -> None:
        """End it, because another one has to find room."""
        self._authority.note("warning", f"{self._who} made room for others that watch")
        line = connection_of(self._socket.scope)
        if isinstance(line, LimitedWebSocket):
            line.turn_out("there is room for beside others", code=CROWDED)

    def _count_in(self) -> None:
        """Count who watches; where there are too many the busiest goes, and of equal ones the oldest."""
        if self._role != "watch":
            return
        watchers = self._service.watchers
        counts = Counter(other.address for other in watchers)
        crowd = None
        if counts[self.address] >= WATCHERS_PER_ADDRESS:
            crowd = self.address
        elif len(watchers) >= WATCHERS:
            crowd = counts.most_common(1)[0][0]
        if crowd is not None:
            busiest = max((other for other in watchers if other.address == crowd), key=lambda other: other.load)
            watchers.remove(busiest)
            busiest.turn_out()
        watchers.append(self)

    def _count_out(self) -> None:
        if self in self._service.watchers:
            self._service.watchers.remove(self)

    async def _deny(self, denied: Denied) -> None:
        await self._socket.send_denial_response(PlainTextResponse(denied.why, denied.status))

    def _welcome(self, session: Session) -> say.Welcome:
        return say.Welcome(
            version=say.VERSION,
            software=f"armsight {__version__}",
            instance=self._authority.instance,
            session=session.nonce,
            role=self._role,
            who=self._who,
            robot=self._authority.robot,
            heartbeat_s=self._service.host.enable_age_s,
            setpoint_s=SETPOINT_S,
            max_bytes=say.MAX_BYTES,
            stop_port=self._service.stop_port,
            enable_key="" if self._lease is None else self._lease.key,
        )

    async def _listen(self, session: Session) -> str:
        while True:
            try:
                message = await self._socket.receive()
            except RuntimeError:
                return f"{self._who} is gone"
            if message["type"] == "websocket.disconnect":
                return self._left(message.get("code"))
            await asyncio.sleep(0)  # what a client has piled up must not hold up the others
            text = message.get("text") if message.get("text") is not None else message.get("bytes", b"")
            answer = self._answer(session, text or "", age_of(message))
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):
                await self._send(answer)
                if session.spent:
                    await self._socket.close(BROKE_RULES, "against the protocol")
                elif not self._auth.knows(self._found):
                    await self._socket.close(BROKE_RULES, TAKEN_OUT)
            if session.spent:
                return f"{self._who} broke the rules {VIOLATIONS} times"
            if not self._auth.knows(self._found):
                return f"the token of {self._who} was taken out"

    def _left(self, code: int | None) -> str:
        if code == TOO_LONG:
            too_long = f"{self._who} sent a message longer than {say.MAX_BYTES} bytes: refused, closed"
            self._authority.note("warning", too_long)
            return f"{self._who} sent a message that is too long"
        return f"{self._who} is gone" if code in (None, 1005, 1006, 1011) else f"{self._who} left"

    def _answer(self, session: Session, text: str | bytes, age_s: float) -> say.ServerMessage:
        seq = None
        try:
            if not self._auth.knows(self._found):
                raise UsageError(TAKEN_OUT, cure="Connect with a token that counts")
            command = session.admit(text)
            seq = command.seq
            if isinstance(command, say.ReadMessage):
                return self._state(seq)
            if isinstance(command, say.StopMessage) and self._lease is None:
                self._authority.stop(self._who)
                status = self._authority.status()
                return accepted(Taken(t_s=status.t_s, cycle=status.cycle), seq)
            if self._lease is None:
                raise DeviceFailed("this connection does not drive", consequence="Nothing was done")
            return accepted(self._authority.perform(self._lease, command_of(command), seq=seq, age_s=age_s), seq)
        except ArmsightError as error:
            self._authority.note("warning", f"a message of {self._who} was refused: {error.cause}")
            return say.Refused.of(error, seq)

    async def _send_news(self) -> None:
        """Send the state now and then, and events as they come; a client that does not read holds up only itself."""
        with self._service.events() as events:
            while True:
                with contextlib.suppress(DeviceFailed):
                    await self._send(self._state())
                await asyncio.sleep(STATE_S)
                if not self._auth.knows(self._found):
                    await self._socket.close(BROKE_RULES, TAKEN_OUT)
                for event in events.take():
                    await self._send(event_message(event))

    def _state(self, reply_to: int | None = None) -> say.StateMessage:
        return state_message(self._authority.status(), self._authority.instance, reply_to)

    async def _send(self, message: say.ServerMessage) -> None:
        if self._socket.client_state is WebSocketState.CONNECTED:
            await self._socket.send_text(message.model_dump_json())


PUMP_S = 0.02
"""How often the loop's events are fetched."""


async def known(request: Request) -> Identity:
    """Return who asks. Raises HTTPException for whom the server does not know; each refusal is kept in the log."""
    found = request.app.state.auth.check(caller_of(request))
    if isinstance(found, Identity):
        known_as(request.scope, found.who)
        return found
    request.app.state.service.authority.note("warning", f"{address_of(request)} was kept out: {found.why}")
    raise HTTPException(found.status, found.why, headers={"WWW-Authenticate": "Bearer"})


Known = Annotated[Identity, Depends(known)]


def create_app(service: Service, auth: Authenticator) -> FastAPI:
    """Return the application; other pages, such as the console's, may be mounted on it (app.mount, nicegui.run_with).

    service: the robot's control authority, host and log; it is opened and closed by the caller, and its events are
    pumped while the application runs. A page mounted here drives through service.authority, as the connections do.
    """
    app = FastAPI(
        title="armsight robot server",
        version=f"{say.VERSION}.0",
        description="The state of a robot. Watching and driving go over WebSockets; see /api/v1/protocol.",
        docs_url=None,
        redoc_url=None,
        lifespan=_pumping(service),
    )
    app.state.service, app.state.auth = service, auth

    @app.get(say.STATE_PATH, summary="The state of robot and loop")
    async def state(_: Known) -> say.StateMessage:
        try:
            return state_message(service.authority.status(), service.authority.instance)
        except ArmsightError as error:
            raise HTTPException(503, str(error)) from error

    @app.get(f"/api/v{say.VERSION}/protocol", summary="JSON schema of the messages on the WebSockets")
    async def protocol(_: Known) -> dict[str, Any]:
        return say.protocol_schema()

    @app.get("/docs", response_class=HTMLResponse, include_in_schema=False)
    async def docs() -> str:
        return openapi_page(app.openapi())

    @app.websocket(say.STREAM_PATH)
    async def stream(socket: WebSocket) -> None:
        await Connection(service, auth, socket, caller_of(socket), role="watch").serve()

    @app.websocket(say.DRIVE_PATH)
    async def drive(socket: WebSocket) -> None:
        await Connection(service, auth, socket, caller_of(socket), role="drive").serve()

    return app


def openapi_page(schema: dict[str, Any]) -> str:
    """Return the OpenAPI description as a page that needs nothing from elsewhere: a robot's cell is often offline."""
    rows = "".join(
        f"<tr><td>{escape(method.upper())}</td><td><code>{escape(path)}</code></td>"
        f"<td>{escape(operation.get('summary', ''))}</td></tr>"
        for path, methods in schema["paths"].items()
        for method, operation in methods.items()
    )
    sockets = "".join(
        f"<tr><td>WebSocket</td><td><code>{path}</code></td><td>{what}</td></tr>"
        for path, what in ((say.STREAM_PATH, "Watch, and stop"), (say.DRIVE_PATH, "Drive: one client at a time"))
    )
    title = escape(schema["info"]["title"])
    return (
        f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>{title}</title></head><body>"
        f"<h1>{title}</h1><p>{escape(schema['info']['description'])}</p>"
        f"<table><tr><th>Method</th><th>Path</th><th>What</th></tr>{rows}{sockets}</table>"
        "<p>Machines read <a href='/openapi.json'>/openapi.json</a>.</p></body></html>"
    )


def _pumping(service: Service) -> Any:
    @contextlib.asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        task = asyncio.create_task(_pump(service))
        try:
            yield
        finally:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    return lifespan


async def _pump(service: Service) -> None:
    while True:
        service.pump()
        await asyncio.sleep(PUMP_S)
