"""NiceGUI's own socket: who speaks on it is asked at every message, and what is no message of a page does nothing."""

from __future__ import annotations

import re
import urllib.parse
from collections.abc import Callable
from typing import Annotated, Any, Literal, TypeVar

from nicegui import Client, json
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from armsight.console.routes import opened_by, person_in, require_login
from armsight.control.session.operator_session import Person
from armsight.errors import UsageError

PATH = "/_nicegui_ws"
VIOLATIONS = 5
"""After so many messages that no page of ours sends, the connection is closed."""

FRAMEWORK = {"sub_pages_open", "sub_pages_navigate", "update:value", "update:modelValue"}
"""What NiceGUI itself hears of every page, a watcher's too: navigation, the dark mode's and the header's own state."""

EVENT = re.compile(r"42[0-9]{0,15}(\[.*)", re.DOTALL)
"""A packet of Engine.IO (4) with one of Socket.IO (2), which may be numbered to be answered."""

Name = Annotated[str, Field(max_length=100)]
Whole = Annotated[int, Field(ge=-1, lt=2**53)]


class _Said(BaseModel):
    """What a page says. NiceGUI may add keys; what it reads has the type that is written here."""

    model_config = ConfigDict(strict=True, extra="ignore", frozen=True)
    client_id: Name


class Event(_Said):
    """Something happened to an element; args: as JSON each."""

    id: Whole
    listener_id: Name
    args: list[str | None] = Field(default=[], max_length=20)


class JavascriptResponse(_Said):
    """The result of a script that the server sent."""

    request_id: Name
    result: Any = None


class Ack(_Said):
    """The page has what was sent before this number."""

    next_message_id: Whole


class Log(_Said):
    """A script of the page tells what it met."""

    level: Literal["debug", "info", "warning", "error"]
    message: Annotated[str, Field(max_length=16_384)]


class Handshake(_Said):
    """The page is there; NiceGUI reads the rest from the same words in the socket's address."""

    tab_id: Name
    document_id: Name
    old_tab_id: Name | None = None
    next_message_id: Whole | None = None


MESSAGES: dict[str, type[_Said]] = {
    "event": Event,
    "javascript_response": JavascriptResponse,
    "ack": Ack,
    "log": Log,
    "handshake": Handshake,
}
"""All that a page may say; NiceGUI's handlers of other names are not reached."""

Model = TypeVar("Model", bound=_Said)


class PageSocket:
    """Stands before NiceGUI's socket. note: is told what was refused, and what scripts tell.

    One WebSocket is one page's: of whom it was opened, who must be the same as who opened the page, and may still come
    in. The other transport, requests that name a connection in their address, is closed: the name would be the right.
    """

    def __init__(self, app: ASGIApp, note: Callable[[str], None]) -> None:
        self.app, self._note = app, note

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through where it is none of NiceGUI's socket, or opens one for its own page."""
        if not str(scope.get("path", "")).startswith(PATH):
            await self.app(scope, receive, send)
        elif scope["type"] == "http":
            await PlainTextResponse("only WebSockets", 404)(scope, receive, send)
        else:
            try:
                said = _handshake_of(scope)
                _own_page(said.client_id, scope)
            except UsageError as error:
                self._note(f"a page's connection was refused: {error.cause}")
                await WebSocketClose(code=1008, reason="no page of yours")(scope, receive, send)
                return
            line = _Line(said.client_id, scope, self._note)
            await self.app(scope, lambda: line.receive(receive), lambda message: line.send(message, send))


class _Line:
    def __init__(self, page: str, scope: Scope, note: Callable[[str], None]) -> None:
        self._page, self._scope, self._note = page, scope, note
        self._connected, self._violations, self._ended = False, 0, False

    async def receive(self, receive: Receive) -> Message:
        """Return the next message that is one; what is none is told and left out."""
        while True:
            message = await receive()
            if message["type"] != "websocket.receive":
                return message
            try:
                text = message.get("text")
                if text is None:
                    raise _refused("bytes")
                if self._admit(text):
                    return message
            except UsageError as error:
                self._violations += 1
                self._note(f"a message of a page was refused: {error.cause}"[:300])
            if self._ended or self._violations >= VIOLATIONS:
                return {"type": "websocket.disconnect", "code": 1008}

    async def send(self, message: Message, send: Send) -> None:
        """Tell the page what is told to it, for as long as who opened it may see it."""
        if message["type"] == "websocket.send" and not self._ended and person_in(self._scope).role == "none":
            self._ended = True
            message = {"type": "websocket.close", "code": 1008, "reason": "logged out"}
        elif self._ended:
            return
        await send(message)

    def _admit(self, text: str) -> bool:
        """Return whether NiceGUI is to hear a packet of Engine.IO. Raises UsageError for what no page of ours sends."""
        if text in ("1", "41"):  # it leaves
            self._ended = True
            return False
        if text == "3":  # it has had the server's ping
            return True
        if text == "40" and not self._connected:
            self._connected = True
            return True
        packet = EVENT.fullmatch(text)
        if packet is None or not self._connected:
            raise _refused("no event")
        match _parsed(packet[1]):
            case [str(kind), dict(fields)] if kind in MESSAGES:
                return self._hears(_validated(MESSAGES[kind], fields))
            case _:
                raise _refused("no event of a page")

    def _hears(self, found: _Said) -> bool:
        person = _own_page(found.client_id, self._scope)
        if found.client_id != self._page:
            raise _refused("it speaks for another page")
        if isinstance(found, Log):
            self._note(f"a page's script told: {found.message[:200]!r}")
            return False
        return not isinstance(found, Event) or _is_heard(found, watches=person.role != "drive")


def _is_heard(event: Event, *, watches: bool) -> bool:
    """Return whether an element waits for this event; it may be gone by now. Raises UsageError."""
    for arg in event.args:
        if arg is not None:
            _parsed(arg)
    element = Client.instances[event.client_id].elements.get(event.id)
    listener = None if element is None else element._event_listeners.get(event.listener_id)
    if listener is None:
        return False
    if watches and listener.type not in FRAMEWORK:
        raise _refused("who may watch changes nothing")
    return True


def _own_page(name: str, scope: Scope) -> Person:
    """Return who speaks, where it is them who opened the page. Raises UsageError, also where they were logged out."""
    page, person = Client.instances.get(name), person_in(scope)
    require_login(person)
    if page is None or opened_by(page) != person:
        raise _refused("it speaks for a page that somebody else opened, or that is gone")
    return person


def _handshake_of(scope: Scope) -> Handshake:
    """Return what a socket's address says of its page. Raises UsageError."""
    query = urllib.parse.parse_qs(scope.get("query_string", b"").decode("latin-1"))
    said: dict[str, Any] = {key: values[0] for key, values in query.items() if len(values) == 1}
    if said.get("transport") != "websocket" or "sid" in query or said.get("EIO") != "4":
        raise _refused("no WebSocket of a page")
    number = said.pop("next_message_id", "")
    if number.isascii() and number.isdigit() and len(number) < 16:
        said["next_message_id"] = int(number)
    return _validated(Handshake, said)


def _parsed(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise _refused("no JSON") from None


def _validated(kind: type[Model], said: Any) -> Model:
    try:
        return kind.model_validate(said)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        raise _refused(f"{'.'.join(str(part) for part in first['loc'])}: {first['msg']}") from None


def _refused(why: str) -> UsageError:
    return UsageError(f"what a page said is none of its messages: {why}", consequence="Nothing was done")
