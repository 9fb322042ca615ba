"""Makes the page of the robot server's messages from their models; `make docs` builds it."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import get_args

from pydantic import BaseModel

from armsight.drivers.remote import protocol as say

HEAD = """\
# Messages of the robot server

Every message and key of [the protocol](protocol.md). Each message has `type`; those of a client also carry `session`
and `seq`. Lengths are in m, angles in rad, times in s on the clock of the robot's loop.
"""


def page() -> str:
    """Return the page."""
    parts = [HEAD]
    for title, kinds in (("From a client", get_args(say.Command)), ("From the server", get_args(say.ServerMessage))):
        parts.append(f"\n## {title}\n")
        parts += [message(kind) for kind in kinds]
    return "\n".join(parts)


def message(kind: type[BaseModel]) -> str:
    """Return the section of one message."""
    name = kind.model_fields["type"].default
    lines = [f"### {name}\n", f"{inspect.cleandoc(str(kind.__doc__))}\n"]
    keys = [f"| `{key}` | {meaning} |" for key, meaning in keys_of(kind)]
    return "\n".join([*lines, *(["| key | meaning |", "|---|---|", *keys] if keys else []), ""])


def keys_of(kind: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield every key with its meaning, those of the objects inside it after it."""
    everywhere = {"type", "session", "seq"} if kind in get_args(say.Command) else {"type"}
    for key in [key for key in kind.model_fields if key not in everywhere]:
        field = kind.model_fields[key]
        inner = [one for one in parts_of(field.annotation) if inspect.isclass(one) and issubclass(one, BaseModel)]
        yield f"{prefix}{key}", field.description or next((str(one.__doc__) for one in inner), "")
        for one in inner:
            yield from keys_of(one, f"{prefix}{key}.")


def parts_of(hint: object) -> Iterator[object]:
    """Yield a type and all that it is made of."""
    yield hint
    for one in get_args(hint):
        yield from parts_of(one)


if __name__ == "__main__":
    print(page())
