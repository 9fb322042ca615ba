"""The log-ins of browsers: a random id each, which stands for a token as long as that counts, and for a day at most."""

from __future__ import annotations

import hashlib
import json
import secrets
from collections import Counter

from armsight.clock import Clock, SystemClock
from armsight.control.session.channels import SESSION_BYTES, Newest

DAY_S = 86_400
"""So long a log-in lasts."""

MOST = 400
"""Log-ins at a time; one more, and the oldest of the token that has most of them ends. Each takes 160 bytes."""

ID_BYTES = 32
"""An id is 256 random bits, as a token is: it needs no salt."""


class BrowserSessions:
    """Which token the log-in of a browser stands for. Hashes alone are kept, and no file.

    memory: where they are, which the line for stops reads from its own process; one process writes it. Times are of
    the machine's monotonic clock, which both have.
    """

    def __init__(self, memory: Newest | None = None, *, clock: Clock | None = None) -> None:
        self._memory = memory or Newest(SESSION_BYTES)
        self._clock = clock or SystemClock()
        self._read: bytes | None = None
        self._kept: dict[str, tuple[str, float]] = {}

    @staticmethod
    def digest(session: str) -> str:
        """Return the SHA-256 of an id, in hexadecimal digits."""
        return hashlib.sha256(session.encode("utf-8", "surrogatepass")).hexdigest()

    def begin(self, token: str) -> str:
        """Return the id of a new log-in; token: the SHA-256 of the one that was given."""
        kept = {login: its for login, its in self._now().items() if its[1] > self._clock.now_s()}
        if len(kept) >= MOST:
            most = Counter(its[0] for its in kept.values()).most_common(1)[0][0]
            del kept[next(login for login, its in kept.items() if its[0] == most)]
        made = secrets.token_urlsafe(ID_BYTES)
        self._write({**kept, self.digest(made): (token, self._clock.now_s() + DAY_S)})
        return made

    def token(self, login: str) -> str:
        """Return the SHA-256 of the token that a log-in, by its id's digest, stands for; empty where it has ended."""
        token, until_s = self._now().get(login, ("", 0.0))
        return token if self._clock.now_s() < until_s else ""

    def end(self, session: str) -> None:
        """End the log-in with this id; nothing where there is none."""
        kept, login = self._now(), self.digest(session)
        if login in kept:
            self._write({other: its for other, its in kept.items() if other != login})

    def _now(self) -> dict[str, tuple[str, float]]:
        data = self._memory.read()
        if data != self._read:
            self._read = data
            self._kept = {login: (str(its[0]), float(its[1])) for login, its in json.loads(data or b"{}").items()}
        return self._kept

    def _write(self, kept: dict[str, tuple[str, float]]) -> None:
        self._memory.write(json.dumps(kept).encode())
