"""All that a process which serves a robot shares: the control authority, the loop's host, the log, and who listens."""

from __future__ import annotations

import secrets
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from threading import RLock
from typing import Any, Protocol

from armsight.control.session.authority import AuthorityLog, ControlAuthority
from armsight.control.session.loop_host import LoopCommand, LoopEvent, LoopHost, synchronized
from armsight.records import JointReading


class TokenBucket:
    """Holds burst tokens at most, and gets per_s of them a second. Times in s, of one clock that does not run back."""

    def __init__(self, per_s: float, burst: float, now_s: float) -> None:
        self._per_s, self._burst = per_s, burst
        self._tokens, self._filled_s = burst, now_s

    def pay(self, now_s: float, tokens: float = 1.0) -> bool:
        """Take tokens and return True; where there are too few take none."""
        self._tokens = min(self._burst, self._tokens + max(0.0, now_s - self._filled_s) * self._per_s)
        self._filled_s = now_s
        if self._tokens < tokens:
            return False
        self._tokens -= tokens
        return True


EVENTS = 100
"""Events that wait for a client; of a client that is slower the oldest are dropped."""

OUTSIDE = "the arm stands outside"
"""How the guard begins what it tells of an arm that it took over beyond a limit."""

WARNINGS_PER_S = 20.0
BURST = 100.0
"""Warnings kept: more of them a second come from a flood, are counted, and must not fill the disk."""


class Log(AuthorityLog, Protocol):
    """Where all is kept."""

    @property
    def dropped(self) -> int:
        """How many commands and readings were not kept."""

    @property
    def failed(self) -> str:
        """Why nothing is kept any more; empty while it is."""

    def joints(self, reading: JointReading) -> None:
        """Keep a reading."""


class Subscription:
    """The events for one client."""

    def __init__(self) -> None:
        self._waiting: deque[LoopEvent] = deque(maxlen=EVENTS)

    def add(self, event: LoopEvent) -> None:
        """Add an event; the oldest is dropped where the client is too slow."""
        self._waiting.append(event)

    def take(self) -> list[LoopEvent]:
        """Return those that came since this was last asked."""
        events = list(self._waiting)
        self._waiting.clear()
        return events


class Watcher(Protocol):
    """A client that watches."""

    @property
    def address(self) -> str:
        """Where it comes from."""

    @property
    def load(self) -> float:
        """How many messages it sent lately."""

    def turn_out(self) -> None:
        """End it, because another one has to find room."""


class Service:
    """A robot as it is served. Any thread may call it; the host itself is spoken to under the same lock only."""

    def __init__(self, host: LoopHost, log: Log) -> None:
        self.lock = RLock()
        self.host = host
        self.watchers: list[Watcher] = []
        """The clients that watch, the oldest first."""
        self.stop_port: int | None = None
        """Of the line for stops; None where there is none."""
        self.outside = ""
        """Which limits the arm stood outside of when the loop took it over, in words; empty within."""
        self._log = log
        self._subscriptions: set[Subscription] = set()
        self._warnings, self._left_out = TokenBucket(WARNINGS_PER_S, BURST, host.now_s()), 0
        self._note_dropped_at, self._noted_failed = 1, False
        self.authority = ControlAuthority(host, self, instance=secrets.token_hex(8), lock=self.lock)

    @property
    def recording_failed(self) -> str:
        """Why nothing is recorded any more; empty while it is."""
        return self._log.failed

    @contextmanager
    def events(self) -> Iterator[Subscription]:
        """Subscribe to events."""
        mine = Subscription()
        self._subscriptions.add(mine)
        try:
            yield mine
        finally:
            self._subscriptions.discard(mine)

    @synchronized
    def pump(self) -> None:
        """Fetch what the loop did, keep it and tell it; to be called some times a second."""
        for record in self.host.records():
            if isinstance(record, LoopEvent):
                if record.message.startswith(OUTSIDE):
                    self.outside = record.message
                self._keep(record.t_s, record.level, record.message)
            elif isinstance(record, LoopCommand):
                self._log.command(record.t_s, "loop", record.kind, record.values)
            else:
                self._log.joints(record)
        self._look_at_the_log()

    @synchronized
    def event(self, t_s: float, level: str, message: str) -> None:
        """Keep something that happened, and tell it to who listens; of a flood of warnings only their number."""
        # errors and infos are few by themselves; warnings are as many as whoever attacks sends messages
        if level == "warning" and not self._warnings.pay(t_s):
            self._left_out += 1
            return
        if self._left_out:
            self._keep(t_s, "warning", f"{self._left_out} more warnings were left out")
            self._left_out = 0
        self._keep(t_s, level, message)

    @synchronized
    def command(self, t_s: float, who: str, kind: str, values: dict[str, Any]) -> None:
        """Keep a command."""
        self._log.command(t_s, who, kind, values)

    def _keep(self, t_s: float, level: str, message: str) -> None:
        self._log.event(t_s, level, message)
        event = LoopEvent(t_s=t_s, level=level, message=message)
        for subscription in self._subscriptions:
            subscription.add(event)

    def _look_at_the_log(self) -> None:
        """Note where records were dropped, ten times as many as noted before, and where the disk failed."""
        now_s, dropped = self.host.now_s(), self._log.dropped
        if dropped >= self._note_dropped_at:
            self._note_dropped_at = 10 * dropped
            self._keep(now_s, "warning", f"{dropped} commands and readings were not recorded: too slow a disk")
        if self._log.failed and not self._noted_failed:
            self._noted_failed = True
            self._keep(now_s, "error", f"nothing is recorded any more: {self._log.failed}")
