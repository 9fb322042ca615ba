"""What a caller may cost and how old it speaks, kept where bytes come in: uvicorn's protocols with limits added."""

from __future__ import annotations

import asyncio
import math
import os
import time
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame
from websockets.protocol import OPEN

from armsight.clock import monotonic_s
from armsight.control.session.service import TokenBucket
from armsight.drivers.remote import protocol as say
from armsight.server.connections import HEAD_S, Connections, address_of_line, after_turns

SLICE = 1024
"""Bytes that are parsed before others have their turn and the budget is looked at again: 170 of the shortest messages,
5 ms."""

PARSING = 0.2
PARSING_BURST_S = 0.05
"""Share of the time that the parsing of one connection's bytes may take, and at once: ten times what ours take."""

LOAD_S, QUIET = 10.0, 200.0
"""Who sent more than QUIET messages in the last LOAD_S makes room first: a watcher that polls sends 100."""

PING_S = 0.02
"""How often the round trip of a connection that drives is measured: by so much more an age is judged too old."""

MOST_PINGS = 256
"""Pings under way: those of a round trip of 5 s. A line that is slower tells no age at all."""

MEASURED = (say.DRIVE_PATH, say.STOP_PATH, "/console/robot")
"""Paths whose messages set a robot in motion or stop it."""

AGE_KEY = "armsight.sent_after_s"
"""What a received message carries besides: it was sent after this time (monotonic_s()), None where not known."""

CONNECTION = "armsight.connection"
"""Where in a request's state the connection stands that it came by."""

ABORT_S = 1.0
"""A caller who does not read why it is closed is cut off after so long."""

AGAINST_THE_RULES = 1008


class LimitedHttp(H11Protocol):
    """HTTP whose requests' heads come in time."""

    def __init__(self, *, connections: Connections, **uvicorns: Any) -> None:
        super().__init__(**uvicorns)
        self.app_state = {**self.app_state, CONNECTION: self}
        self.guarded = connections
        self._waits: object | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for the first head."""
        super().connection_made(transport)
        self._wait_for_head()
        self.guarded.opened(transport)

    def data_received(self, data: bytes) -> None:
        """Take bytes; the time for a head runs from its first one."""
        super().data_received(data)
        if self.conn.their_state is h11.IDLE:
            self._wait_for_head()
        else:
            self._head_came()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        self._head_came()
        self.guarded.closed(self.transport)
        super().connection_lost(exc)

    def _wait_for_head(self) -> None:
        if self._waits is None:
            self._waits = object()
            after_turns(HEAD_S, self._late, self._waits)

    def _head_came(self) -> None:
        self.guarded.asked(self.transport)
        self._waits = None

    def _late(self, waited_for: object) -> None:
        if self._waits is waited_for:
            self.transport.abort()


class LimitedWebSocket(WebSocketsSansIOProtocol):
    """A WebSocket that takes so much a second, and tells of each message after what time it was sent.

    A pong shows that the caller had its ping. What follows it on the same connection was sent later than that ping,
    whatever the caller's clock says: the age of a message is at most the time since. The server's own pings are
    random, so that nobody can answer one that was not sent.
    """

    def __init__(self, *, connections: Connections, **uvicorns: Any) -> None:
        super().__init__(**uvicorns)
        now_s, budget = time.monotonic(), connections.budget
        self.app_state = {**self.app_state, CONNECTION: self}
        self.sent_after_s: float | None = None
        self.queue = _Stamping(self)
        self.guarded = connections
        self._messages = TokenBucket(budget.messages_per_s, budget.messages_burst, now_s)
        self._bytes = TokenBucket(budget.bytes_per_s, budget.bytes_burst, now_s)
        self._parsing = TokenBucket(PARSING, PARSING_BURST_S, now_s)
        self._sent, self._sent_s = 0.0, now_s
        self._backlog = b""
        self._pings: dict[bytes, float] = {}
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        """Begin, as one of whom it is known how much they send."""
        super().connection_made(transport)
        self.guarded.speaks(transport, self.load)

    def load(self) -> float:
        """Return how many messages it sent in the last LOAD_S or so; 0 of one that speaks as clients of ours do."""
        sent = self._lately()
        return sent if sent > QUIET else 0.0

    def _lately(self) -> float:
        return self._sent * math.exp((self._sent_s - time.monotonic()) / LOAD_S)

    def data_received(self, data: bytes) -> None:
        """Take bytes as far as the caller's budget goes; what is over it is not parsed."""
        budget = self.guarded.budget
        if not self._bytes.pay(time.monotonic(), len(data)):
            self.turn_out(f"{budget.bytes_per_s / 1024:.0f} KiB a second")
            return
        self._backlog += data
        if len(self._backlog) == len(data):  # else a turn for what is there already comes
            self._parse()

    def _parse(self) -> None:
        part, self._backlog = self._backlog[:SLICE], self._backlog[SLICE:]
        if not part or self.transport.is_closing():  # what answers a close of ours still has to be read
            self._backlog = b""
            return
        begun_s = time.thread_time()
        super().data_received(part)
        if not self._parsing.pay(time.monotonic(), time.thread_time() - begun_s):
            self.turn_out(f"{PARSING:.0%} of the time for its messages alone")
        elif self._backlog:
            self.loop.call_soon(self._parse)

    def handle_events(self) -> None:
        """Take messages as far as the caller's budget goes."""
        frames = sum(isinstance(event, Frame) for event in self.conn.events)
        self._sent, self._sent_s = self._lately() + frames, time.monotonic()
        if frames and not self._messages.pay(time.monotonic(), frames):
            self.conn.events = [event for event in self.conn.events if _stops(event)]
            super().handle_events()  # a stop is heard whoever said too much before it
            self.turn_out(f"{self.guarded.budget.messages_per_s:g} messages a second")
            return
        super().handle_events()

    def shutdown(self) -> None:
        """End it with the server; one that is closing already cannot be told so, and is not waited for."""
        if self.handshake_complete and self.conn.state is not OPEN:
            self.transport.abort()
            return
        super().shutdown()

    async def send(self, message: Any) -> None:
        """Send, and begin to measure the round trip of a connection that was let in."""
        await super().send(message)
        if message["type"] == "websocket.accept" and self.scope["path"] in MEASURED:
            self._measure()

    def handle_pong(self, event: Frame) -> None:
        """Note after what time the caller sends from now on."""
        sent_s = self._pings.pop(bytes(event.data), None)
        if sent_s is None:
            super().handle_pong(event)
            return
        self.sent_after_s = sent_s if self.sent_after_s is None else max(sent_s, self.sent_after_s)
        self._pings = {payload: t_s for payload, t_s in self._pings.items() if t_s > sent_s}

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        if self._timer is not None:
            self._timer.cancel()
        rest, self._backlog = self._backlog, b""
        if rest and not self.close_sent:
            super().data_received(rest)  # a stop may be the last that was said
        self.guarded.closed(self.transport)
        super().connection_lost(exc)

    def _measure(self) -> None:
        if self.close_sent or self.transport.is_closing() or self.conn.state is not OPEN:
            return
        if self.writable.is_set() and len(self._pings) < MOST_PINGS:
            payload = os.urandom(8)
            self._pings[payload] = monotonic_s()
            self.conn.send_ping(payload)
            self.transport.write(b"".join(self.conn.data_to_send()))
        self._timer = self.loop.call_later(PING_S, self._measure)

    def turn_out(self, what: str, *, code: int = AGAINST_THE_RULES) -> None:
        """Close a caller that sends more than it may, telling it and the log once."""
        if self.transport.is_closing():
            return
        if self.close_sent:  # it was told, and goes on sending instead of answering
            self.transport.abort()
            return
        self.guarded.note(address_of_line(self.transport), f"sent more than {what}: closed")
        if not self.handshake_complete:  # nothing may be told before it is let in
            self.transport.abort()
            return
        self.conn.fail(code, f"more than {what}")
        self.transport.write(b"".join(self.conn.data_to_send()))
        self.close_sent = True
        self.queue.put_nowait({"type": "websocket.disconnect", "code": code, "reason": what})
        self.transport.close()
        self.loop.call_later(ABORT_S, self.transport.abort)


class _Stamping(asyncio.Queue[Any]):
    """The queue of what a WebSocket received, each message with after what time it was sent."""

    def __init__(self, socket: LimitedWebSocket) -> None:
        super().__init__()
        self._socket = socket

    def put_nowait(self, item: Any) -> None:
        """Add an event."""
        if item["type"] == "websocket.receive":
            item[AGE_KEY] = self._socket.sent_after_s
        super().put_nowait(item)


LONGEST_STOP = 300
"""Bytes of a stop: who said too much is not given more."""


def _stops(event: Any) -> bool:
    """Return whether a frame may hold a stop, in the words of programs or of pages."""
    return isinstance(event, Frame) and len(event.data) <= LONGEST_STOP and b'"stop"' in bytes(event.data)


def age_of(message: Any) -> float:
    """Return how old a received message may be, in s; infinite where no round trip tells it yet."""
    sent_after_s = message.get(AGE_KEY)
    return float("inf") if sent_after_s is None else monotonic_s() - sent_after_s


def connection_of(scope: Any) -> LimitedHttp | LimitedWebSocket | None:
    """Return the connection that a request came by; None where it came by none of ours."""
    found: LimitedHttp | LimitedWebSocket | None = scope.get("state", {}).get(CONNECTION)
    return found


def known_as(scope: Any, who: str, *, keep: bool = False) -> None:
    """Tell the connection that a request came by who asks; keep: because it drives."""
    found = connection_of(scope)
    if found is not None:
        found.guarded.known(found.transport, who, keep=keep)
