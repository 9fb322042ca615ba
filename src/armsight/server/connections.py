"""What a caller may cost: connections, time for a request's head, messages and bytes a second; and how old it speaks.

Kept where bytes come in, before anything is parsed for long: uvicorn's own protocols, with these limits added. What is
over a limit is told once and closed, so that no caller keeps the server from the others.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections import Counter, OrderedDict
from collections.abc import Callable
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame
from websockets.protocol import OPEN

from armsight.app.robot.token_bucket import TokenBucket
from armsight.drivers.remote import protocol as say

HEAD_S = 3.0
"""A request whose head is not there after so long is a slow attack, or a line that no robot is driven over."""

UNKNOWN_PER_ADDRESS = 16
"""Connections of an address that have asked nothing yet; one more, and the oldest of them is closed."""

PER_ADDRESS = 128
"""Connections of an address: a page of the console takes up to ten, and a few browsers may share an address."""

MESSAGES_PER_S, MESSAGES_BURST = 2000.0, 500.0
"""More than twice the commands and heartbeats of the fastest loop."""

BYTES_PER_S, BYTES_BURST = 524_288.0, 65_536.0
"""Those messages take 200 kB a second; a burst of 64 KiB is parsed in 20 ms."""

PING_S = 0.02
"""How often the round trip of a connection that drives is measured: by so much more an age is judged too old."""

MOST_PINGS = 256
"""Pings under way: those of a round trip of 5 s. A line that is slower tells no age at all."""

MEASURED = (say.DRIVE_PATH, say.STOP_PATH, "/console/robot")
"""Paths whose messages set a robot in motion or stop it."""

AGE_KEY = "armsight.sent_after_s"
"""What a received message carries besides: it was sent after this time (time.monotonic()), None where not known."""

ABORT_S = 1.0
"""A caller who does not read why it is closed is cut off after so long."""

AGAINST_THE_RULES = 1008


class Connections:
    """All connections of a server, by address. note: is told what was closed, once a minute for each address."""

    def __init__(self, note: Callable[[str], None]) -> None:
        self._note = note
        self._addresses: dict[asyncio.BaseTransport, str] = {}
        self._counts: Counter[str] = Counter()
        self._unknown: OrderedDict[asyncio.Transport, str] = OrderedDict()
        self._noted: dict[tuple[str, str], float] = {}

    def opened(self, transport: asyncio.Transport) -> None:
        """Take a new connection; where its address has too many, one of them is cut off."""
        address = _address(transport)
        self._addresses[transport] = address
        self._counts[address] += 1
        self._unknown[transport] = address
        waiting = [other for other, its in self._unknown.items() if its == address]
        if self._counts[address] > PER_ADDRESS:
            self.note(address, f"has {PER_ADDRESS} connections; no more are taken")
            transport.abort()
        elif len(waiting) > UNKNOWN_PER_ADDRESS:
            self.note(address, f"opened {UNKNOWN_PER_ADDRESS} connections and asked nothing; the oldest are closed")
            waiting[0].abort()

    def asked(self, transport: asyncio.Transport) -> None:
        """Take note that a request has come."""
        self._unknown.pop(transport, None)

    def closed(self, transport: asyncio.Transport) -> None:
        """Forget a connection."""
        self._unknown.pop(transport, None)
        address = self._addresses.pop(transport, None)
        if address is not None:
            self._counts[address] -= 1
            if not self._counts[address]:
                del self._counts[address]

    def note(self, address: str, what: str) -> None:
        """Tell what an address did; the same once a minute."""
        now_s = time.monotonic()
        self._noted = {key: t_s for key, t_s in self._noted.items() if now_s - t_s < 60.0}
        if self._noted.setdefault((address, what), now_s) == now_s:
            self._note(f"{address} {what}")


class LimitedHttp(H11Protocol):
    """HTTP whose requests' heads come in time."""

    def __init__(self, *, connections: Connections, **uvicorns: Any) -> None:
        super().__init__(**uvicorns)
        self._guarded = connections
        self._head: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for the first head."""
        super().connection_made(transport)
        self._wait_for_head()
        self._guarded.opened(transport)

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
        self._guarded.closed(self.transport)
        super().connection_lost(exc)

    def _wait_for_head(self) -> None:
        if self._head is None:
            self._head = self.loop.call_later(HEAD_S, self.transport.abort)

    def _head_came(self) -> None:
        self._guarded.asked(self.transport)
        if self._head is not None:
            self._head.cancel()
            self._head = None


class LimitedWebSocket(WebSocketsSansIOProtocol):
    """A WebSocket that takes so much a second, and tells of each message after what time it was sent.

    A pong shows that the caller had its ping. What follows it on the same connection was sent later than that ping,
    whatever the caller's clock says: the age of a message is at most the time since. The server's own pings are
    random, so that nobody can answer one that was not sent.
    """

    def __init__(self, *, connections: Connections, **uvicorns: Any) -> None:
        super().__init__(**uvicorns)
        now_s = time.monotonic()
        self.sent_after_s: float | None = None
        self.queue = _Stamping(self)
        self._guarded = connections
        self._messages = TokenBucket(MESSAGES_PER_S, MESSAGES_BURST, now_s)
        self._bytes = TokenBucket(BYTES_PER_S, BYTES_BURST, now_s)
        self._pings: dict[bytes, float] = {}
        self._timer: asyncio.TimerHandle | None = None

    def data_received(self, data: bytes) -> None:
        """Take bytes as far as the caller's budget goes."""
        if self.handshake_complete and not self._bytes.pay(time.monotonic(), len(data)):
            self._over(f"{BYTES_PER_S / 1024:.0f} KiB a second")
            return
        super().data_received(data)

    def handle_events(self) -> None:
        """Take messages as far as the caller's budget goes."""
        frames = sum(isinstance(event, Frame) for event in self.conn.events)
        if frames and not self._messages.pay(time.monotonic(), frames):
            self._over(f"{MESSAGES_PER_S:g} messages a second")
            return
        super().handle_events()

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
        self._guarded.closed(self.transport)
        super().connection_lost(exc)

    def _measure(self) -> None:
        if self.close_sent or self.transport.is_closing() or self.conn.state is not OPEN:
            return
        if self.writable.is_set() and len(self._pings) < MOST_PINGS:
            payload = os.urandom(8)
            self._pings[payload] = time.monotonic()
            self.conn.send_ping(payload)
            self.transport.write(b"".join(self.conn.data_to_send()))
        self._timer = self.loop.call_later(PING_S, self._measure)

    def _over(self, what: str) -> None:
        """Close a caller that sends more than it may, telling it and the log once."""
        if self.close_sent or self.transport.is_closing():
            return
        self._guarded.note(_address(self.transport), f"sent more than {what}: closed")
        self.conn.fail(AGAINST_THE_RULES, f"more than {what}")
        self.transport.write(b"".join(self.conn.data_to_send()))
        self.close_sent = True
        self.queue.put_nowait({"type": "websocket.disconnect", "code": AGAINST_THE_RULES, "reason": what})
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


def age_of(message: Any) -> float:
    """Return how old a received message may be, in s; infinite where no round trip tells it yet."""
    sent_after_s = message.get(AGE_KEY)
    return float("inf") if sent_after_s is None else time.monotonic() - sent_after_s


def _address(transport: asyncio.BaseTransport) -> str:
    peer = transport.get_extra_info("peername")
    return str(peer[0]) if peer else "unknown"
