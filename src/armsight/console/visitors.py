"""Who looks at a page: their role, asked anew each time, and the name of the page that they opened."""

from __future__ import annotations

import secrets
from typing import Any

from nicegui import Client, ui
from starlette.requests import HTTPConnection

from armsight.control.session.operator_session import Person
from armsight.errors import UsageError

IDENTITY = "armsight.identity"
"""Where the server that lets callers in puts who they are into a request's scope."""

NAME = "armsight.page"
"""Where a page's name is kept: not NiceGUI's own, which stands in the address of its socket."""


def person_of(connection: HTTPConnection | None) -> Person:
    """Return who asks, as it is now; where nobody is checked, because only this machine is served, its operator."""
    return person_in({} if connection is None else connection.scope)


def person_in(scope: Any) -> Person:
    """Return who asked in a request with this scope, and what they may do now."""
    found: Any = scope.get(IDENTITY)
    return Person() if found is None else Person(who=found.who, role=found.role)


def require_login(person: Person) -> None:
    """Raise UsageError where what somebody came in by has ended."""
    if person.role == "none":
        raise UsageError(
            f"the token or the log-in of {person.who} has ended", consequence="Nothing was done", cure="Log in again"
        )


def logged_in(connection: HTTPConnection) -> bool:
    """Return whether somebody came by a log-in, which they can end."""
    return bool(getattr(connection.scope.get(IDENTITY), "logged_in", False))


def page_name() -> str:
    """Return the name of the page that is being built, made where it has none: its robot's connection speaks in it."""
    name: str = ui.context.client.storage.setdefault(NAME, secrets.token_urlsafe(16))
    return name


def opener_of(name: str) -> Person | None:
    """Return who opened the page of this name, and what they may do now; None where no such page is open."""
    found = next((client for client in Client.instances.values() if client.storage.get(NAME) == name), None)
    return None if found is None else opened_by(found)


def opened_by(page: Client) -> Person | None:
    """Return who opened a page, and what they may do now; None where nobody did."""
    return None if page._request is None else person_in(page._request.scope)
