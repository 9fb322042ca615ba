"""What comes back from the publishers to the process that measures or serves: notes, and acknowledgements."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass

LONGEST = 400
"""Characters of a note, at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Note:
    """Something for the log; level: info, warning or error."""

    level: str
    message: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Acknowledge:
    """Somebody has seen the alarm of this id; from_: their address."""

    id: str
    who: str
    address: str


Request = Note | Acknowledge
Tell = Callable[[Request], bool]
"""Sends a request; returns whether there was room for it."""


def encode(request: Request) -> bytes:
    """Return a request as bytes; a note that is too long is cut."""
    values = {name: value[:LONGEST] for name, value in asdict(request).items()}
    return json.dumps({"kind": type(request).__name__, **values}).encode()


def decode(data: bytes) -> Request:
    """Return the request again."""
    values = json.loads(data)
    kind = values.pop("kind")
    return Note(**values) if kind == "Note" else Acknowledge(**values)
