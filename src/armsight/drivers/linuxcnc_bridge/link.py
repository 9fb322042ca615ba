"""The link itself: UDP to the one program that drives, and the sessions of its motion."""

from __future__ import annotations

import contextlib
import json
import math
import os
import secrets
import socket
import struct
import time
from pathlib import Path
from typing import Any

from .feed import Feed
from .ini import describe
from .pins import MAY, OFFSETS, READS, Pins, Switching

LEAD = 16
"""Samples that wait for the streamer when the next goal comes: an answer that is so late is not noticed."""

STRETCH = 2
"""By so many samples a goal takes longer where fewer wait: the line was late, and nothing is caught up."""

SILENT_S = 0.064
"""A program that does not answer for so long has let the arm go."""

GONE_S = 1.0
"""... and is no longer the one that drives."""

STILL_S = 0.1
"""Counts that were not taken show where nothing was asked for so long, and the time to brake twice."""

LOST = 5e-4
"""By so much, in degrees or the length unit, the commanded position is then off."""

FAR = 4
"""A goal that is farther than the way at full speed in so many cycles is none of one step: it moves nothing."""

TURN_S = 0.001

HELLO = struct.Struct("<4sI")
BEGIN = struct.Struct("<4sIHH")
STATE = struct.Struct("<4sIIIQIHBB")
GOAL = struct.Struct("<4sIIIIHH")
"""Little-endian. HELLO, a sign of life, and the END: magic, the program's token. BEGIN: samples of a state, what may be
switched. STATE: token, session, number, sample, the newest goal taken, flags, why the session began, joints; then
measured, commanded and asked positions, and, where offsets are driven, those in force. GOAL: token, session, the
state's number, its own, flags, joints; then positions, of joints or of axes' offsets. Positions are doubles, in degrees
or the INI's length unit."""

STOP = 1
BEGUN, LET_GO, STOPPED, NOT_TAKEN = range(4)
"""Why a session began: motion is taken (again); the program was silent; it stopped; counts were not taken."""


class Client:
    """The program that drives, or only reads: where it is, its token, and what is under way."""

    def __init__(self, where: tuple[str, int], token: int, samples: int, now_s: float, *, reads: bool = False) -> None:
        self.where, self.token, self.samples, self.reads = where, token, samples, reads
        self.heard_s = self.answered_s = now_s
        self.number = self.taken = 0


class Bridge:
    """Between one program and HAL. machine: of describe; pins: Pins; link: a UDP socket that is bound."""

    def __init__(self, machine: dict[str, Any], pins: Any, link: socket.socket) -> None:
        self._machine, self._pins, self._link = machine, pins, link
        self._feed, self._offsets, self._leaves = Feed(machine), False, False
        self._client: Client | None = None
        self._switching = Switching(0, 0.0)
        self._session, self._why = secrets.randbelow(1 << 30), BEGUN
        self._may = self._beat = self._rest = False
        self._next_why = BEGUN
        self._sample = self._due = 0
        self._still_s = 0.0
        self._measured = self._commanded = self._joints = [0.0] * self._feed.n
        link.setblocking(False)

    def turn(self, now_s: float) -> None:
        """Take what has come, and tell the state where that is due."""
        self._beat = not self._beat
        self._pins.put("heartbeat", self._beat)
        newest = self._pins.sample()
        if newest is not None:
            before = self._commanded
            self._sample, self._joints, self._measured, offsets = newest
            self._commanded = offsets if self._offsets else self._joints
            self._rest = before == self._commanded
        flags = self._pins.flags(self._offsets)
        self._look(flags, now_s)
        self._hold_program()
        self._receive(now_s)
        client = self._client
        if client is None:
            return
        flags = self._pins.flags(self._offsets)  # of what a program that has just come drives
        self._switching.turn(self._pins, flags, now_s)
        if now_s - client.heard_s > GONE_S:
            self._leave()
        elif newest is not None and self._sample >= self._due:
            self._due = self._sample - self._sample % client.samples + client.samples
            self._tell(client, flags)

    def _look(self, flags: int, now_s: float) -> None:
        """Begin a session where motion is taken again, or where what was asked is not what came of it."""
        client = self._client
        if client is None or client.reads or not flags & MAY:
            self._end(BEGUN)
        elif not self._may:
            self._feed.at = list(self._commanded)
            if self._rest and not self._pins.waiting:
                self._feed.start(self._commanded, self._pins.counts[self._driven])
                self._begin(self._next_why)
                self._may, self._still_s, client.answered_s = True, now_s, now_s
                self._pins.put("session", True)
                self._pins.put("offsets" if self._offsets else "jog-enable", True)
        elif self._feed.lost(self._commanded):
            self._end(NOT_TAKEN)
        else:
            self._check_taken(client, now_s)

    def _check_taken(self, client: Client, now_s: float) -> None:
        if now_s - client.answered_s > SILENT_S:
            left, self._leaves = self._leaves, self._offsets and self._pins.get("running")
            if self._feed.let_go() or self._leaves > left:
                self._begin(LET_GO)
        off = max(abs(a - b) for a, b in zip(self._commanded, self._feed.target))  # noqa: B905
        if self._feed.moves or off <= LOST:
            self._still_s = now_s
        elif now_s - self._still_s > STILL_S + 2.0 * self._feed.braking_s:
            self._feed.start(self._commanded)
            self._begin(NOT_TAKEN)

    @property
    def _driven(self) -> slice:
        """Which of a row's counts are driven: the joints' or those of the axes' offsets behind them."""
        n = len(self._machine["joints"])
        return slice(n, None) if self._offsets else slice(n)

    def _hold_program(self) -> None:
        """Pause the program that runs with corrections in force which nobody watches any more."""
        self._leaves = self._leaves and self._pins.get("running")
        for name in ("inhibit", "pause"):
            self._pins.put(name, self._leaves)

    def _begin(self, why: int) -> None:
        """Begin a session: answers to the one before move nothing."""
        self._session, self._why = (self._session + 1) & 0xFFFFFFFF, why

    def _end(self, next_why: int) -> None:
        """Take no more goals; the next session begins where the arm has come to rest."""
        if self._may:
            self._next_why = next_why
            self._feed.let_go()
            # the machine must not fall off by the watchdog that is not needed any more
            self._pins.put("free", True)
            self._pins.put("session", False)
            self._pins.put("jog-enable", False)
            self._pins.put("offsets", False)
            self._leaves = self._offsets
        self._may = False
        self._feed.at = list(self._commanded)

    def _receive(self, now_s: float) -> None:
        while True:
            try:
                data, where = self._link.recvfrom(2048)
            except OSError:  # nothing more, or the report that nobody listens any more
                return
            magic = data[:4]
            if magic == b"ASLH" and len(data) == HELLO.size:
                self._send(b"ASLD" + data[4:8] + json.dumps(self._told()).encode(), where)
            elif magic == b"ASLB" and len(data) == BEGIN.size:
                self._take_up(data, where, now_s)
            elif len(data) >= HELLO.size:
                self._take(data, where, now_s)

    def _take(self, data: bytes, where: tuple[str, int], now_s: float) -> None:
        magic, token = HELLO.unpack_from(data)
        client = self._client
        if client is None or (where, token) != (client.where, client.token):
            self._send(b"ASLN" + data[4:8], where)  # who was forgotten, or is of a bridge before this one, learns it
            return
        client.heard_s = now_s
        if magic == b"ASLE" and len(data) == HELLO.size:
            self._leave()
        elif magic == b"ASLG" and len(data) == GOAL.size + 8 * self._feed.n:
            self._goal(client, data, now_s)

    def _told(self) -> dict[str, Any]:
        driver = "" if self._client is None else "{}:{}".format(*self._client.where)
        return {**self._machine, "driver": driver, "watchdog": "ok" in self._pins.signals}

    def _take_up(self, data: bytes, where: tuple[str, int], now_s: float) -> None:
        """Let a program drive, where none does."""
        _, token, samples, what = BEGIN.unpack(data)
        offsets = bool(what & OFFSETS)
        may = not offsets or all(one["speed"] > 0.0 for one in self._machine["offsets"] or [{"speed": 0.0}])
        if self._client is None and 0 < samples <= 1000 and may:
            self._offsets, self._feed = offsets, Feed(self._machine, offsets=offsets)
            self._client = Client(where, token, samples, now_s, reads=bool(what & READS))
            self._switching = Switching(what, now_s)
            self._next_why, self._due = BEGUN, 0

    def _leave(self) -> None:
        """Let nobody drive; the arm comes to rest by itself."""
        self._client = None
        self._end(BEGUN)

    def _goal(self, client: Client, data: bytes, now_s: float) -> None:
        """Take a goal that answers the newest state, or the one before."""
        _, _, session, answered, given, flags, n = GOAL.unpack_from(data)
        goal = list(struct.unpack_from(f"<{self._feed.n}d", data, GOAL.size))
        fits = n == self._feed.n and all(map(math.isfinite, goal)) and client.number - answered in (0, 1)
        if not self._may or session != self._session or not fits or self._feed.far(goal, FAR * client.samples):
            return
        client.answered_s = now_s
        if flags & STOP:
            client.taken = given
            self._leaves = self._offsets
            if self._feed.let_go():
                self._begin(STOPPED)
        elif given != client.taken and (waiting := self._pins.waiting) <= LEAD + client.samples:
            client.taken = given
            late = max(0, LEAD - waiting)
            samples = client.samples + (min(STRETCH, late) if self._feed.asks(goal) else late)
            row = list(self._pins.counts)
            for counts in self._feed.step(goal, samples, client.samples):
                row[self._driven] = counts
                self._pins.feed([tuple(row)])

    def _tell(self, client: Client, flags: int) -> None:
        client.number = (client.number + 1) & 0xFFFFFFFF
        if self._may:  # from now on the machine is on as long as this program lives
            self._pins.put("free", not self._pins.get("ok"))
        n = self._feed.n
        flags = flags if self._may else flags & ~MAY
        counted = (client.token, self._session, client.number, self._sample, client.taken)
        head = STATE.pack(b"ASLS", *counted, flags, self._why, n)
        rows = [*self._measured, *self._joints, *self._feed.at, *(self._commanded if self._offsets else ())]
        self._send(head + struct.pack(f"<{len(rows)}d", *rows), client.where)

    def _send(self, data: bytes, where: tuple[str, int]) -> None:
        with contextlib.suppress(OSError):  # who is gone is told by silence
            self._link.sendto(data, where)


def run(ini: Path, bind: str, port: int) -> None:
    """Be the bridge until HAL ends it."""
    machine = describe(ini)
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind((bind, port))
    with contextlib.suppress(OSError):  # where the system allows it, before other work of this computer
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    try:
        pins = Pins(len(machine["joints"]), len(machine["offsets"]))
    except Exception as error:  # HAL has types of its own
        raise SystemExit(
            f"the bridge finds not what it needs in HAL ({error}): load the lines of `hal {ini}`"
        ) from error
    bridge = Bridge(machine, pins, link)
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            bridge.turn(time.monotonic())
            time.sleep(TURN_S)
