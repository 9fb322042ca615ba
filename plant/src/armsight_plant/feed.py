"""From what runs to the publishers: a thread that looks at it some times a second, keeps the alarms, takes answers."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

from armsight.errors import ArmsightError, UsageError
from armsight_plant.options import PlantOptions
from armsight_plant.process import PlantProcess
from armsight_plant.state import AlarmBook, Note, PlantState, Request, conditions

FEED_S = 0.02
"""How often the newest state is handed on."""
AGAIN_S = 5.0
"""Publishers that ended by themselves are started anew after so long."""

Source = Callable[[], PlantState]
"""Returns the newest state without alarms; never waits, never raises."""
Log = Callable[[str, str], None]
"""Takes a level (info, warning, error) and a message."""


class Feed:
    """The alarms of a source, and what is done with what comes back. Pure but for the log; for one thread."""

    def __init__(self, log: Log, stale_s: float) -> None:
        self._log, self._stale_s = log, stale_s
        self._book = AlarmBook()

    def with_alarms(self, state: PlantState) -> PlantState:
        """Return the state with the alarms that are there now; what became of them is logged."""
        for text in self._book.update(conditions(state, self._stale_s), state.made_unix_s):
            self._log("info", text)
        return replace(state, alarms=self._book.alarms)

    def take(self, request: Request) -> None:
        """Log a note; acknowledge an alarm, and log who did."""
        if isinstance(request, Note):
            self._log(request.level, request.message)
            return
        by = f"{request.who} at {request.address}"
        try:
            alarm = self._book.acknowledge(request.id, request.who)
        except UsageError as error:
            self._log("warning", f"{by}: {error.cause}")
            return
        self._log("info", f"alarm {alarm.id} was acknowledged by {by}")


class _FeedThread(threading.Thread):
    """Feeds a process until told to end."""

    def __init__(self, process: PlantProcess, source: Source, log: Log, stale_s: float) -> None:
        super().__init__(name="armsight-plant", daemon=True)
        self._process, self._source, self._log = process, source, log
        self._feed = Feed(log, stale_s)
        self._end = threading.Event()
        self._ended_s: float | None = None
        self._said = ""

    def run(self) -> None:
        """Hand on what is new."""
        while not self._end.wait(FEED_S):
            self._process.show(self._feed.with_alarms(self._source()))
            for request in self._process.requests():
                self._feed.take(request)
            self._look_after()

    def end(self) -> None:
        """End it and wait."""
        self._end.set()
        self.join()

    def _look_after(self) -> None:
        came = self._process.came
        if self._process.alive:
            if self._said and isinstance(came, dict):
                self._said = ""
                self._log("info", f"published again{''.join(f', {name}: port {port}' for name, port in came.items())}")
            return
        now_s = time.monotonic()
        if self._ended_s is None:
            self._ended_s = now_s
            why = came.cause if isinstance(came, ArmsightError) else "that process has ended"
            if why != self._said:  # once, not with every try
                self._said = why
                self._log("error", f"nothing is published: {why}; it is started anew every {AGAIN_S:g} s")
        elif now_s - self._ended_s > AGAIN_S:
            self._ended_s = None
            self._process.restart()


@contextlib.contextmanager
def published(options: PlantOptions, source: Source, log: Log) -> Iterator[dict[str, int]]:
    """Publish a source while the block runs; gives the ports that are listened at, by name.

    Raises DeviceNotFound for a package that is missing, BadFile for certificates, DeviceFailed for a port in use.
    """
    with PlantProcess(options) as process:
        thread = _FeedThread(process, source, log, options.stale_s)
        thread.start()
        try:
            yield process.ports
        finally:
            thread.end()


def addresses(options: PlantOptions, ports: Mapping[str, int]) -> list[str]:
    """Return where the plant's systems find what is published, a line each."""
    lines = []
    if options.opcua is not None:
        lines.append(f"OPC UA: opc.tcp://{_host(options.opcua.host)}:{ports['opcua']}")
    if options.mqtt is not None:
        lines.append(f"MQTT: {options.mqtt.prefix}/state at {options.mqtt.host}:{options.mqtt.port}")
    if options.foxglove is not None:
        lines.append(f"Foxglove: ws://{_host(options.foxglove.host)}:{ports['foxglove']}")
    return lines


def _host(host: str) -> str:
    return f"[{host}]" if ":" in host else host
