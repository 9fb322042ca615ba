"""What a caller may cost: connections, time for a request's head, messages and bytes a second; and how old it speaks.

Kept where bytes come in, before anything is parsed for long: uvicorn's own protocols, with these limits added. What is
over a limit is told once and closed, so that no caller keeps the server from the others.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame
from websockets.protocol import OPEN

from armsight.app.robot.token_bucket import TokenBucket
from armsight.drivers.remote import protocol as say

HEAD_S = 3.0
"""A connection whose TLS handshake and first head are not there after so long is a slow attack, or a line that no robot
is driven over."""

UNKNOWN_PER_ADDRESS = 16
"""Connections of an address that have asked nothing yet; one more, and the oldest of them is closed."""

PER_ADDRESS = 128
"""Connections of an address: a page of the console takes up to ten, and a few browsers may share an address."""

IN_ALL = 512
"""Connections of all addresses: half of the files that a process may have open where nothing else is set."""

PER_TURN = 4
"""Connections that are taken before those that are there have their turn: the system keeps up to 128 waiting, and the
heads of so many together would keep a stop waiting for 0.2 s."""

SLICE = 1024
"""Bytes that are parsed before others have their turn and the budget is looked at again: 170 of the shortest messages,
5 ms."""

HEAD_BYTES = 16_384
"""Longest head of a request."""


@dataclass(frozen=True, slots=True)
class Budget:
    """What a connection may send a second, and at once after a silence; what is over it closes the connection."""

    messages_per_s: float
    messages_burst: float
    bytes_per_s: float
    bytes_burst: float


SERVER = Budget(2000.0, 500.0, 524_288.0, 65_536.0)
"""More than twice the commands and heartbeats of the fastest loop; those take 200 kB a second."""

LINE = Budget(400.0, 300.0, 131_072.0, 65_536.0)
"""Of the line for stops: heartbeats and pongs are 85 a second; what a radio link held back for 3 s comes at once."""

PARSING = 0.2
PARSING_BURST_S = 0.05
"""Share of the time that the parsing of one connection's bytes may take, and at once: ten times what ours take."""

PING_S = 0.02
"""How often the round trip of a connection that drives is measured: by so much more an age is judged too old."""

MOST_PINGS = 256
"""Pings under way: those of a round trip of 5 s. A line that is slower tells no age at all."""

MEASURED = (say.DRIVE_PATH, say.STOP_PATH, "/console/robot")
"""Paths whose messages set a robot in motion or stop it."""

AGE_KEY = "armsight.sent_after_s"
"""What a received message carries besides: it was sent after this time (time.monotonic()), None where not known."""

CONNECTION = "armsight.connection"
"""Where in a request's state the connection stands that it came by."""

ABORT_S = 1.0
"""A caller who does not read why it is closed is cut off after so long."""

AGAINST_THE_RULES = 1008


@dataclass(eq=False)
class _Open:
    """A connection: who it is once that is known, how much it sent lately, and whether it is kept whatever comes."""

    address: str
    who: str = ""
    load: Callable[[], float] = lambda: 0.0
    kept: bool = False


class Connections:
    """All connections of a server, by address. note: is told what was closed, once a minute for each address.

    Where there is no room for one more the busiest goes, and of equal ones the oldest: those that nobody knows first,
    then those of the token that has the most. So whoever speaks little finds room beside a flood, whoever sends it.
    """

    def __init__(self, note: Callable[[str], None], budget: Budget = SERVER) -> None:
        self.budget = budget
        self._note = note
        self._open: dict[asyncio.Transport, _Open] = {}
        self._unknown: dict[tuple[Any, ...], socket.socket] = {}
        self._noted: dict[tuple[str, str], float] = {}

    def accepted(self, line: socket.socket, peer: tuple[Any, ...]) -> None:
        """Take note of a connection before its first byte, and end it where nothing is asked within HEAD_S."""
        self._unknown = {other: its for other, its in self._unknown.items() if its.fileno() >= 0}
        self._unknown[peer[:2]] = line
        asyncio.get_running_loop().call_later(HEAD_S, self._late, peer[:2], line)
        waiting = [other for other in self._unknown if other[0] == peer[0]]
        if len(waiting) > UNKNOWN_PER_ADDRESS:
            self.note(peer[0], f"opened {UNKNOWN_PER_ADDRESS} connections and asked nothing; the oldest are closed")
            _cut(self._unknown.pop(waiting[0]))

    def opened(self, transport: asyncio.Transport) -> None:
        """Take a new connection; where there are too many one of them is cut off."""
        self._open[transport] = _Open(_address(transport))
        counts = Counter(one.address for one in self._open.values())
        address = self._open[transport].address
        if counts[address] > PER_ADDRESS:
            self._make_room([one for one, its in self._open.items() if its.address == address and one is not transport])
            self.note(address, f"has {PER_ADDRESS} connections; the busiest make room")
        elif len(self._open) > IN_ALL:
            most = counts.most_common(1)[0][0]
            self._make_room([one for one, its in self._open.items() if its.address == most and one is not transport])
            self.note(most, f"has most of {IN_ALL} connections; the busiest make room")

    def asked(self, transport: asyncio.Transport) -> None:
        """Take note that a request has come."""
        self._unknown.pop((transport.get_extra_info("peername") or ())[:2], None)

    def speaks(self, transport: asyncio.Transport, load: Callable[[], float]) -> None:
        """Take note of how much a connection sends."""
        if transport in self._open:
            self._open[transport].load = load

    def known(self, transport: asyncio.Transport, who: str, *, keep: bool = False) -> None:
        """Take note of who it is; keep: never cut it off for others, because it drives."""
        if transport in self._open:
            self._open[transport].who, self._open[transport].kept = who, keep

    def closed(self, transport: asyncio.Transport) -> None:
        """Forget a connection."""
        self.asked(transport)
        self._open.pop(transport, None)

    def note(self, address: str, what: str) -> None:
        """Tell what an address did; the same once a minute."""
        now_s = time.monotonic()
        self._noted = {key: t_s for key, t_s in self._noted.items() if now_s - t_s < 60.0}
        if self._noted.setdefault((address, what), now_s) == now_s:
            self._note(f"{address} {what}")

    def _make_room(self, candidates: list[asyncio.Transport]) -> None:
        free = [one for one in candidates if not self._open[one].kept]
        nobodys = [one for one in free if not self._open[one].who]
        if not nobodys and free:
            most = Counter(self._open[one].who for one in free).most_common(1)[0][0]
            nobodys = [one for one in free if self._open[one].who == most]
        if nobodys:
            busiest = max(nobodys, key=lambda one: self._open[one].load())
            del self._open[busiest]  # at once, so that the next one is not made room for by the same
            busiest.abort()

    def _late(self, peer: tuple[Any, ...], line: socket.socket) -> None:
        if self._unknown.get(peer) is line:
            del self._unknown[peer]
            _cut(line)


class Door(socket.socket):
    """A listening socket whose connections are counted from the first moment, before TLS; it takes a few at a time."""

    def __init__(self, listener: socket.socket, connections: Connections) -> None:
        super().__init__(fileno=os.dup(listener.fileno()))
        self._connections = connections
        self._left = PER_TURN

    def accept(self) -> tuple[socket.socket, Any]:
        """Return the next connection. Raises BlockingIOError where there is none, or those taken have their turn."""
        if not self._left:
            self._left = PER_TURN
            raise BlockingIOError
        self._left -= 1
        try:
            line, peer = super().accept()
        except OSError:
            self._left = PER_TURN
            raise
        self._connections.accepted(line, peer)
        return line, peer


def _cut(line: socket.socket) -> None:
    """End a connection whose socket its transport has: that one sees its end and closes it."""
    with contextlib.suppress(OSError):
        line.shutdown(socket.SHUT_RDWR)


def connection_of(scope: Any) -> LimitedHttp | LimitedWebSocket | None:
    """Return the connection that a request came by; None where it came by none of ours."""
    found: LimitedHttp | LimitedWebSocket | None = scope.get("state", {}).get(CONNECTION)
    return found


def known_as(scope: Any, who: str, *, keep: bool = False) -> None:
    """Tell the connection that a request came by who asks; keep: because it drives."""
    found = connection_of(scope)
    if found is not None:
        found.guarded.known(found.transport, who, keep=keep)


class LimitedHttp(H11Protocol):
    """HTTP whose requests' heads come in time."""

    def __init__(self, *, connections: Connections, **uvicorns: Any) -> None:
        super().__init__(**uvicorns)
        self.app_state = {**self.app_state, CONNECTION: self}
        self.guarded = connections
        self._head: asyncio.TimerHandle | None = None

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
        if self._head is None:
            self._head = self.loop.call_later(HEAD_S, self.transport.abort)

    def _head_came(self) -> None:
        self.guarded.asked(self.transport)
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
        now_s, budget = time.monotonic(), connections.budget
        self.app_state = {**self.app_state, CONNECTION: self}
        self.sent_after_s: float | None = None
        self.queue = _Stamping(self)
        self.guarded = connections
        self._messages = TokenBucket(budget.messages_per_s, budget.messages_burst, now_s)
        self._bytes = TokenBucket(budget.bytes_per_s, budget.bytes_burst, now_s)
        self._parsing = TokenBucket(PARSING, PARSING_BURST_S, now_s)
        self._backlog = b""
        self._pings: dict[bytes, float] = {}
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        """Begin, as one of whom it is known how much they send."""
        super().connection_made(transport)
        self.guarded.speaks(transport, self.load)

    def load(self) -> float:
        """Return how many messages it sent lately."""
        return self._messages.lacking(time.monotonic())

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
        """Parse a slice; the next one has its turn behind what others sent meanwhile."""
        part, self._backlog = self._backlog[:SLICE], self._backlog[SLICE:]
        if not part or self.close_sent or self.transport.is_closing():
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
        if frames and not self._messages.pay(time.monotonic(), frames):
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
            self._pings[payload] = time.monotonic()
            self.conn.send_ping(payload)
            self.transport.write(b"".join(self.conn.data_to_send()))
        self._timer = self.loop.call_later(PING_S, self._measure)

    def turn_out(self, what: str, *, code: int = AGAINST_THE_RULES) -> None:
        """Close a caller that sends more than it may, telling it and the log once."""
        if self.close_sent or self.transport.is_closing():
            return
        self.guarded.note(_address(self.transport), f"sent more than {what}: closed")
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


def age_of(message: Any) -> float:
    """Return how old a received message may be, in s; infinite where no round trip tells it yet."""
    sent_after_s = message.get(AGE_KEY)
    return float("inf") if sent_after_s is None else time.monotonic() - sent_after_s


def _address(transport: asyncio.BaseTransport) -> str:
    peer = transport.get_extra_info("peername")
    return str(peer[0]) if peer else "unknown"
