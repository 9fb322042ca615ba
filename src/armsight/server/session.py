"""One connection: which of its messages are taken. Replayed and malformed ones are refused and counted."""

from __future__ import annotations

import secrets

from armsight.drivers.remote import protocol as say
from armsight.errors import Inconsistent, UsageError

VIOLATIONS = 5
"""After so many messages that no client of ours sends, the connection is closed."""


class Session:
    """Admits a connection's messages. nonce: new for each connection; what was said on another one is refused."""

    def __init__(self, role: str) -> None:
        """role: of say.ALLOWED."""
        self.nonce = secrets.token_hex(16)
        self.violations = 0
        self._role = role
        self._seq = 0

    @property
    def spent(self) -> bool:
        """Whether it broke the rules so often that it is closed."""
        return self.violations >= VIOLATIONS

    def admit(self, text: str | bytes) -> say.Command:
        """Return a message.

        Raises Inconsistent where it is malformed, replayed or of another connection, UsageError where this role may
        not send it; each is a violation.
        """
        try:
            command = say.parse_command(text)
            self._check(command)
        except (Inconsistent, UsageError):
            self.violations += 1
            raise
        self._seq = command.seq
        return command

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
        if not isinstance(command, say.ALLOWED[self._role]):
            raise UsageError(
                f"{command.type} is not for this connection", consequence="Nothing was done", cure="Connect to drive"
            )
