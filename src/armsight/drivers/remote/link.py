"""A client's link to a robot server: its connection, and beside it the line for stops."""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any
from urllib.parse import urlsplit

from armsight.clock import StandStill, monotonic_s
from armsight.drivers.remote import protocol as say
from armsight.drivers.remote.wire import Answer, ServerAddress, Wire
from armsight.errors import ArmsightError, DeviceFailed

EVENTS = 1000
"""Events kept for the program that does not fetch them."""

BEATS = 5.0
"""Heartbeats within the time after which an enable is too old: some of them may be late."""


class Link:
    """A connection to a robot server, for several threads; stop and beat also go by its line for stops, if any."""

    def __init__(self, address: ServerAddress, path: str) -> None:
        self.address = address
        self._wire = Wire(address, path, self._take)
        self._line: Wire | None = None
        self._welcome: say.Welcome | None = None
        self._events: deque[say.EventMessage] = deque(maxlen=EVENTS)
        self._beating = threading.Lock()
        self._beats = 0

    @property
    def welcome(self) -> say.Welcome:
        """What the server said first. Raises DeviceFailed where the link is not open."""
        if self._welcome is None:
            raise DeviceFailed(f"{self.address.url} is not open", consequence="Nothing is known", cure="Open it first")
        return self._welcome

    @property
    def ended(self) -> str:
        """Why the connection ended, in words; empty while it lives."""
        return self._wire.ended

    @property
    def awaited(self) -> bool:
        """Whether the program waits for an answer of the server."""
        return self._wire.awaited

    def open(self) -> say.Welcome:
        """Connect and return the server's welcome. Raises as Wire.open."""
        first = self._wire.open()
        if not isinstance(first, say.Welcome):
            self._wire.close()
            raise DeviceFailed(f"{self.address.url} is a line for stops", cure="Give the port of the server itself")
        self._welcome, self._beats = first, 0
        if first.stop_port is not None:
            self._open_line(first.stop_port)
        return first

    def ask(self, make: Callable[..., say.Command], **fields: Any) -> Answer:
        """Send a message and return its answer. Raises the refusal's error, DeviceLost without a connection."""
        return self._wire.ask(make, **fields)

    def beat(self, *, enable: bool, waits: bool) -> None:
        """Say by both ways that the program lives, and whether motion is allowed. Raises as ask.

        waits: for the answers, as who asks for it wants to know; a regular beat must not wait behind others.
        """
        # the thread that beats and the program that asks for a beat share one count: a number given twice would not
        # count
        with self._beating:
            self._beats += 1
            number = self._beats
        if self._line is not None and not self._line.ended:
            with contextlib.suppress(ArmsightError):  # the other way has the same beat
                deliver = self._line.ask if waits else self._line.send
                deliver(say.Heartbeat, enable=enable, number=number, key=self.welcome.enable_key)
        (self._wire.ask if waits else self._wire.send)(say.Heartbeat, enable=enable, number=number)

    def stop(self) -> None:
        """Stop the robot until it is reset, by the line that nothing else shares. Raises as ask."""
        if self._line is not None and not self._line.ended:
            # if the line fails in between, the stop goes the other way below; a stop twice is a stop
            with contextlib.suppress(ArmsightError):
                self._line.ask(say.StopMessage)
                self._wire.send(say.StopMessage)  # what is asked after it finds it stopped
                return
        self._wire.ask(say.StopMessage)

    def take_events(self) -> list[say.EventMessage]:
        """Return what the server told of events since this was last asked."""
        events = []
        with contextlib.suppress(IndexError):
            while True:
                events.append(self._events.popleft())
        return events

    def cut(self) -> None:
        """End the connections as a pulled cable does: without a word to the server."""
        for wire in (self._wire, self._line):
            if wire is not None:
                wire.cut()

    def close(self) -> None:
        """End the connections; legal always."""
        # taken out before it is closed: the thread that beats looks at it meanwhile
        line, self._line = self._line, None
        if line is not None:
            line.close()
        self._wire.close()

    def _open_line(self, port: int) -> None:
        """Open the line for stops; where a network keeps it shut the connection has to do alone, which is told."""
        parts = urlsplit(self.address.url)
        host = f"[{parts.hostname}]" if ":" in (parts.hostname or "") else parts.hostname
        line = Wire(replace(self.address, url=f"{parts.scheme}://{host}:{port}"), say.STOP_PATH, lambda _: None)
        try:
            line.open()
        except ArmsightError as error:
            warning = f"the line for stops cannot be reached, stops share the way of all else: {error.cause}"
            self._events.append(say.EventMessage(t_s=0.0, level="warning", message=warning))
            return
        self._line = line

    def _take(self, message: say.ServerMessage) -> None:
        if isinstance(message, say.EventMessage):
            self._events.append(message)


class Heart:
    """Sends heartbeats from a thread of its own while the program that drives is alive.

    Motion stays enabled only while the program calls beat or touch at least every quiet_s of time_s: a program that
    hangs stops enabling, though this thread runs on. Where all of the program stood still what it enabled before counts
    no more: it has to enable anew.
    """

    def __init__(self, link: Link, *, quiet_s: float = 1.0, time_s: Callable[[], float] = monotonic_s) -> None:
        self._link = link
        self._quiet_s = quiet_s
        self._time_s = time_s
        self._touched_s = time_s()
        self._enable = False
        self._stood_s = 0.0
        self._turns, self._turning = StandStill(0.0), threading.Lock()
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin to beat."""
        self._thread = threading.Thread(target=self._run, name="armsight-heartbeat", daemon=True)
        self._thread.start()

    def touch(self) -> None:
        """The program is alive."""
        self._turn()
        self._touched_s = self._time_s()

    def check(self) -> None:
        """Raise DeviceFailed where the program stood still since it enabled motion."""
        self.touch()
        if self._stood_s:
            raise DeviceFailed(
                f"this program stood still for {self._stood_s:.2f} s, which ended its enable",
                consequence="Nothing was sent",
                cure="Enable motion anew; longer work beside a motion belongs into another process",
            )

    def beat(self, enable: bool | None = None) -> None:
        """Tell the server now that the program lives, and set whether motion is allowed. Raises as Link.ask."""
        self.touch()
        if enable is not None:
            self._enable, self._stood_s = enable, 0.0
        self._link.beat(enable=self._enable, waits=True)

    def end(self) -> None:
        """Beat no more; legal always."""
        self._over.set()
        if self._thread is not None:
            self._thread.join()
        self._thread = None

    def _turn(self) -> None:
        """Note a turn of the program, by whichever thread; an enable from before a stand-still is let go of."""
        with self._turning:
            stood_s = self._turns.turn(self._time_s())
            if stood_s and self._enable:
                self._enable, self._stood_s = False, stood_s

    def _run(self) -> None:
        pause_s = self._link.welcome.heartbeat_s / BEATS
        while not self._over.wait(pause_s):
            self._turn()
            if self._link.awaited:
                # a program that waits for a server that stands still is alive: an enable that is let go of and given
                # again once the server goes on would be one given anew
                self._touched_s = self._time_s()
            alive = self._time_s() - self._touched_s <= self._quiet_s
            try:
                self._link.beat(enable=self._enable and alive, waits=False)
            except ArmsightError:
                if self._link.ended:
                    return
