"""One connection: which of its messages are taken. Replayed, malformed and too many are refused and counted."""

from __future__ import annotations

import secrets

from armsight.drivers.remote import protocol as say
from armsight.errors import Inconsistent, UsageError

VIOLATIONS = 5
"""After so many messages that no client of ours sends, the connection is closed."""

MESSAGES_PER_S = 2000.0
"""More than twice the commands and heartbeats of the fastest loop; more of them only keep the server busy."""

BURST = 500.0


class Session:
    """Admits a connection's messages. nonce: new for each connection; what was said on another one is refused."""

    def __init__(self, role: str, now_s: float) -> None:
        self.nonce = secrets.token_hex(16)
        self.violations = 0
        self._role = role
        self._seq = 0
        self._budget, self._filled_s = BURST, now_s

    @property
    def spent(self) -> bool:
        """Whether it broke the rules so often that it is closed."""
        return self.violations >= VIOLATIONS

    def admit(self, text: str | bytes, now_s: float) -> say.Command:
        """Return the message that came at now_s (s, monotonic).

        Raises Inconsistent where it is malformed, replayed, of another connection or one too many, UsageError where
        this role may not send it; each is a violation.
        """
        try:
            self._pay(now_s)
            command = say.parse_command(text)
            self._check(command)
        except (Inconsistent, UsageError):
            self.violations += 1
            raise
        self._seq = command.seq
        return command

    def _pay(self, now_s: float) -> None:
        self._budget = min(BURST, self._budget + (now_s - self._filled_s) * MESSAGES_PER_S) - 1.0
        self._filled_s = now_s
        if self._budget < 0.0:
            self._budget = 0.0
            raise Inconsistent(f"more than {MESSAGES_PER_S:g} messages a second", consequence="This one was not read")

    def _check(self, command: say.Command) -> None:
        if not secrets.compare_digest(command.session.encode(), self.nonce.encode()):
            raise Inconsistent(
                "a message of another connection", consequence="Nothing was done", cure="Send this one's session"
            )
        if command.seq <= self._seq:
            raise Inconsistent(
                f"message {command.seq} came after message {self._seq}: a replay",
                consequence="Nothing was done",
                cure="Number the messages of a connection upwards",
            )
        if self._role == "watch" and not isinstance(command, say.WATCHING):
            raise UsageError(
                f"{command.type} is not for watchers", consequence="Nothing was done", cure="Connect to drive"
            )
