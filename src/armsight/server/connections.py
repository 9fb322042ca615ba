"""What callers may cost: connections, time for a handshake and a request's head, messages and bytes a second.

Who is over a limit is told once and closed, so that no caller keeps the server from the others.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import socket
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from armsight.errors import DeviceFailed

HEAD_S = 3.0
"""A connection whose TLS handshake and first head are not there after so long is a slow attack, or a line that no robot
is driven over."""

LAST_TURN_S = 0.5
"""Of HEAD_S, kept for what has come already: a server that stood still itself finds its timers due before it has read,
and reads first."""

UNKNOWN_PER_ADDRESS = 16
"""Connections of an address that have asked nothing yet; one more, and the oldest of them is closed."""

PER_ADDRESS = 128
"""Connections of an address: a page of the console takes up to ten, and a few browsers may share an address."""

IN_ALL = 512
"""Connections of all addresses, where the process may have so many files open: half of what is usual."""

UNKNOWN_IN_ALL = 128
"""Connections of all addresses that have asked nothing yet, where there is room for them."""

SPARE = 64
"""Descriptors left for all else that a server opens while it runs: files of pages, recordings, cameras."""

FEWEST = 32
"""With room for fewer connections nothing is served: a page takes ten."""

PER_TURN = 4
"""Connections that are taken before those that are there have their turn: the system keeps up to 128 waiting, and the
heads of so many together would keep a stop waiting for 0.2 s."""

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

    def __init__(self, note: Callable[[str], None], budget: Budget = SERVER, *, room: int | None = None) -> None:
        """room: connections that find descriptors, by default those left now. Raises DeviceFailed for too few."""
        room = _room() if room is None else room
        if room < FEWEST:
            raise DeviceFailed(
                f"this process may open {room + SPARE} more files, of which connections need {FEWEST + SPARE}",
                consequence="Nothing is served",
                cure="Let it open more: ulimit -n 1024",
            )
        self._most_unknown = min(UNKNOWN_IN_ALL, room // 4)
        self._most = min(IN_ALL, room - self._most_unknown)
        self.budget = budget
        self._note = note
        self._open: dict[asyncio.Transport, _Open] = {}
        self._unknown: dict[tuple[Any, ...], socket.socket] = {}
        self._noted: dict[tuple[str, str], float] = {}

    def accepted(self, line: socket.socket, peer: tuple[Any, ...]) -> None:
        """Take note of a connection before its first byte, and end it where nothing is asked within HEAD_S."""
        self._unknown = {other: its for other, its in self._unknown.items() if its.fileno() >= 0}
        # before TLS and before any protocol: a connection that says nothing has no transport yet
        self._unknown[peer[:2]] = line
        after_turns(HEAD_S, self._late, peer[:2], line)
        waiting = [other for other in self._unknown if other[0] == peer[0]]
        if len(waiting) > UNKNOWN_PER_ADDRESS:
            self.note(peer[0], f"opened {UNKNOWN_PER_ADDRESS} connections and asked nothing; the oldest are closed")
            _cut(self._unknown.pop(waiting[0]))
        elif len(self._unknown) > self._most_unknown:
            most = Counter(other[0] for other in self._unknown).most_common(1)[0][0]
            self.note(most, f"has most of {self._most_unknown} connections that asked nothing; its oldest is closed")
            _cut(self._unknown.pop(next(other for other in self._unknown if other[0] == most)))

    def opened(self, transport: asyncio.Transport) -> None:
        """Take a new connection; where there are too many one of them is cut off."""
        self._open[transport] = _Open(address_of_line(transport))
        counts = Counter(one.address for one in self._open.values())
        address = self._open[transport].address
        if counts[address] > PER_ADDRESS:
            self._make_room([one for one, its in self._open.items() if its.address == address and one is not transport])
            self.note(address, f"has {PER_ADDRESS} connections; the busiest make room")
        elif len(self._open) > self._most:
            most = counts.most_common(1)[0][0]
            self._make_room([one for one, its in self._open.items() if its.address == most and one is not transport])
            self.note(most, f"has most of {self._most} connections; the busiest make room")

    def refused(self, peer: tuple[Any, ...]) -> None:
        """Take note of a connection that found no descriptor, and make room for the next one."""
        self.note(peer[0], "was turned away: this process has no more descriptors")
        if self._open:
            most = Counter(its.address for its in self._open.values()).most_common(1)[0][0]
            self._make_room([one for one, its in self._open.items() if its.address == most])

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
        # who drives is never cut off for others: the arm would be held by a flood
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


class ListeningSocket(socket.socket):
    """A listening socket whose connections are counted from the first moment, before TLS; it takes a few at a time.

    It holds a descriptor in reserve: a connection that finds none is taken with it and closed. Left waiting it would
    call this again and again, and asyncio write a traceback each time.
    """

    def __init__(self, listener: socket.socket, connections: Connections) -> None:
        super().__init__(fileno=os.dup(listener.fileno()))
        self._connections = connections
        self._left = PER_TURN
        self._reserve = os.open(os.devnull, os.O_RDONLY)

    def close(self) -> None:
        """Close it, and the reserve."""
        super().close()
        with contextlib.suppress(OSError):
            os.close(self._reserve)

    def accept(self) -> tuple[socket.socket, Any]:
        """Return the next connection. Raises BlockingIOError where there is none, or those taken have their turn."""
        if not self._left:
            self._left = PER_TURN
            raise BlockingIOError
        self._left -= 1
        try:
            line, peer = super().accept()
        except OSError as error:
            self._left = PER_TURN
            if error.errno not in (errno.EMFILE, errno.ENFILE):
                raise
            self._turn_away()
            raise BlockingIOError from error
        self._connections.accepted(line, peer)
        return line, peer

    def _turn_away(self) -> None:
        with contextlib.suppress(OSError):
            os.close(self._reserve)
            try:
                line, peer = super().accept()
                line.close()
                self._connections.refused(peer)
            finally:
                self._reserve = os.open(os.devnull, os.O_RDONLY)


def _room() -> int:
    """Return how many more descriptors this process may open, but for SPARE; IN_ALL where that is not known."""
    try:
        from resource import RLIM_INFINITY, RLIMIT_NOFILE, getrlimit

        allowed, used = getrlimit(RLIMIT_NOFILE)[0], len(list(Path("/dev/fd").iterdir()))
    except (ImportError, OSError):
        return IN_ALL + UNKNOWN_IN_ALL
    return IN_ALL + UNKNOWN_IN_ALL if allowed == RLIM_INFINITY else allowed - used - SPARE


def after_turns(delay_s: float, act: Callable[..., None], *args: Any) -> None:
    """Call act after delay_s, and not before the loop has read what came until LAST_TURN_S before that."""
    loop = asyncio.get_running_loop()
    loop.call_later(delay_s - LAST_TURN_S, loop.call_later, LAST_TURN_S, act, *args)


def _cut(line: socket.socket) -> None:
    """End a connection whose socket its transport has: that one sees its end and closes it."""
    with contextlib.suppress(OSError):
        line.shutdown(socket.SHUT_RDWR)


def address_of_line(transport: asyncio.BaseTransport) -> str:
    """Return the address that a connection comes from."""
    peer = transport.get_extra_info("peername")
    return str(peer[0]) if peer else "unknown"
