"""Memory that two processes share: the newest of something, and a queue; neither side ever waits for the other.

One process writes a channel and one reads it. What is torn by a write at the same time is seen by its checksum and
left out, so that no lock is needed and a process that dies holds nobody up.
"""

from __future__ import annotations

import json
import pickle
import zlib
from dataclasses import dataclass, field
from enum import IntEnum
from multiprocessing import RawArray
from typing import Any, NamedTuple

import numpy as np

from armsight.arrays import Array
from armsight.clock import StandStill
from armsight.errors import ArmsightError, StaleData, UsageError, rebuilt

FAILED = "failed"
_HEAD = 16
"""Bytes before a slot's content: its number (8), its length (4), its checksum (4)."""


class _Slots:
    """Numbered slots of equal size; counts at the front tell how much was written and read."""

    def __init__(self, slots: int, size: int) -> None:
        self.slots = slots
        self.size = size
        self._memory: Any = RawArray("B", 16 + slots * (_HEAD + size))

    def written(self) -> int:
        """Return how many were written."""
        return int.from_bytes(self._bytes()[0:8], "little")

    def taken(self) -> int:
        """Return how many the reader took."""
        return int.from_bytes(self._bytes()[8:16], "little")

    def set_taken(self, count: int) -> None:
        """Let the writer use the slots before number count again."""
        self._bytes()[8:16] = count.to_bytes(8, "little")

    def put(self, number: int, data: bytes) -> None:
        """Write slot number, then count it."""
        if len(data) > self.size:
            raise UsageError(f"a message of {len(data)} bytes does not fit into {self.size}")
        memory, at = self._bytes(), self._at(number)
        memory[at + _HEAD : at + _HEAD + len(data)] = data
        memory[at : at + _HEAD] = _head(number, data)
        memory[0:8] = (number + 1).to_bytes(8, "little")

    def get(self, number: int) -> bytes | None:
        """Return what slot number holds; None where that was overwritten, or is being written."""
        memory, at = self._bytes(), self._at(number)
        head = bytes(memory[at : at + _HEAD])
        length = int.from_bytes(head[8:12], "little")
        if length > self.size:
            return None
        data = bytes(memory[at + _HEAD : at + _HEAD + length])
        return data if head == _head(number, data) else None

    def _at(self, number: int) -> int:
        return 16 + (number % self.slots) * (_HEAD + self.size)

    def _bytes(self) -> memoryview:
        return memoryview(self._memory).cast("B")


class Newest:
    """The newest of something: written as often as one likes, read by any number at any time."""

    def __init__(self, size: int = 4096) -> None:
        self._slots = _Slots(4, size)  # a reader has three writes' time to take its copy

    def write(self, data: bytes) -> None:
        """Replace what is there."""
        self._slots.put(self._slots.written(), data)

    def read(self) -> bytes | None:
        """Return the newest; None before the first was written, or where every copy was overwritten meanwhile."""
        for _ in range(10):
            count = self._slots.written()
            data = self._slots.get(count - 1) if count else None
            if data is not None:
                return data
        return None


class Queue:
    """Messages in their order; a full queue takes no more."""

    def __init__(self, slots: int = 256, size: int = 1024) -> None:
        self._slots = _Slots(slots, size)
        self.size = size

    def put(self, data: bytes, *, spare: int = 0) -> bool:
        """Add a message; False where the queue is full but for spare slots, which are for what is more urgent."""
        number = self._slots.written()
        if number - self._slots.taken() >= self._slots.slots - spare:
            return False
        self._slots.put(number, data)
        return True

    def get(self) -> bytes | None:
        """Take the oldest message; None where there is none."""
        number = self._slots.taken()
        while number < self._slots.written():
            data = self._slots.get(number)
            if data is None:
                return None  # counted, yet not all of it is to be seen: a moment later it is
            number += 1
            self._slots.set_taken(number)
            return data
        return None


def put_error(queue: Queue, error: ArmsightError) -> None:
    """Write an error's kind and texts, cut to what a message holds; `error_of` reads it.

    Not the error itself: where tblib is loaded (Dask does), pickle takes its traceback along, which no message holds.
    """
    for letters in (400, 150, 40):
        texts = [text[:letters] for text in (error.cause, error.consequence, error.cure)]
        data = pickle.dumps((FAILED, type(error), *texts))
        if len(data) <= queue.size:
            break
    queue.put(data)


def error_of(record: Any) -> ArmsightError | None:
    """Return the error that a message of put_error tells, None of any other."""
    return rebuilt(*record[1:]) if isinstance(record, tuple) and record[0] == FAILED else None


SESSION_BYTES = 1 << 17
"""Of the log-ins of browsers."""


@dataclass(frozen=True, slots=True)
class LineChannels:
    """What the line for stops shares.

    orders: to the loop. grant: whose enable counts, written by the server. notes: for the server's log. sessions: the
    log-ins of browsers, written by the server. turns: of the processes that serve the robot.
    """

    orders: Queue = field(default_factory=lambda: Queue(256, 512))
    grant: Newest = field(default_factory=lambda: Newest(256))
    notes: Queue = field(default_factory=lambda: Queue(256, 512))
    sessions: Newest = field(default_factory=lambda: Newest(SESSION_BYTES))
    turns: Turns = field(default_factory=lambda: Turns())


class Grant(NamedTuple):
    """Whose enable the line for stops takes: the lease's number, its key (empty: nobody's), and the driver's name."""

    lease: int = 0
    key: str = ""
    person: str = ""

    def encoded(self) -> bytes:
        """Return it as `granted` reads it."""
        return json.dumps(self).encode()


TURN_S = 0.02
"""How often each of the processes that serve a robot tells that it has its turn: often, as the least age of an enable
is what they are judged by."""


class Serves(IntEnum):
    """A process that serves a robot beside its loop."""

    WEB = 0
    LINE = 1


SERVERS = ("the web server", "the line for stops")


class Turns:
    """When each of the processes that serve a robot last had its turn; one that has not begun yet is not missed.

    The line for stops finds itself, at its next turn, where it stood still for less than the loop waits for. The web
    server does not: it gives way to all other work, and waits for a tenth of a second on a busy computer.
    """

    def __init__(self) -> None:
        self._memory: Any = RawArray("d", 2 * len(SERVERS))
        self._still = StandStill(TURN_S)

    def turn(self, who: Serves, t_s: float) -> None:
        """Note a turn at t_s, on the loop's clock."""
        if who is Serves.LINE and self._still.turn(t_s):
            self._memory[len(SERVERS) + who] = t_s
        self._memory[who] = t_s

    def missed(self, now_s: float, longest_s: float, since_s: float) -> str:
        """Return which had no turn for longer than longest_s, or stood still until after since_s; empty where none."""
        n = len(SERVERS)
        late = (t_s and now_s - t_s > longest_s for t_s in self._memory[:n])
        stood = (t_s > since_s for t_s in self._memory[n:])
        return next((name for name, *why in zip(SERVERS, late, stood, strict=True) if any(why)), "")


def granted(grant: Newest) -> Grant:
    """Return whose enable counts now."""
    return Grant(*json.loads(grant.read() or b"[]"))


class JointTrack:
    """The last joint values of an arm, with their times: written once a cycle by one, read by any number."""

    def __init__(self, n: int, slots: int = 512) -> None:
        """n: joints. slots: values kept; what is older is forgotten."""
        self._n, self._count = n, slots
        self._memory: Any = RawArray("d", 1 + slots * (1 + n))

    def write(self, t_s: float, q: Array) -> None:
        """Add the values q (n,) of t_s; those that are no newer than the last are left out."""
        rows, written = self._rows()
        number = int(written[0])
        if number and t_s <= rows[(number - 1) % self._count, 0]:
            return
        rows[number % self._count] = (t_s, *q)
        written[0] = number + 1

    def reaches(self, t_s: float) -> bool:
        """Tell whether values of t_s or later were written."""
        rows, written = self._rows()
        number = int(written[0])
        return number > 0 and t_s <= float(rows[(number - 1) % self._count, 0])

    def at(self, t_s: float) -> Array:
        """Return the values (n,) at t_s, between two that were written. Raises StaleData beyond those that are kept."""
        rows, written = self._rows()
        number = int(written[0])
        kept = min(number, self._count - SPARE)
        table = rows[np.arange(number - kept, number) % self._count]
        if not kept or not table[0, 0] <= t_s <= table[-1, 0]:
            known = f"they are known from {table[0, 0]:.3f} to {table[-1, 0]:.3f} s" if kept else "none came yet"
            raise StaleData(
                f"joint values at {t_s:.3f} s of the clock are not known: {known}",
                consequence="Where the arm stood then is not known",
            )
        return np.array([np.interp(t_s, table[:, 0], column) for column in table[:, 1:].T])

    def _rows(self) -> tuple[Array, Array]:
        memory = np.frombuffer(self._memory)
        return memory[1:].reshape(self._count, 1 + self._n), memory[:1]


SPARE = 64
"""Rows that may be overwritten while somebody reads: half a second of cycles."""


def _head(number: int, data: bytes) -> bytes:
    checksum = zlib.crc32(data, number & 0xFFFFFFFF)
    return number.to_bytes(8, "little") + len(data).to_bytes(4, "little") + checksum.to_bytes(4, "little")
