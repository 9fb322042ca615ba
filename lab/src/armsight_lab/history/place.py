"""Where a history is: a file, or a PostgreSQL database by its URL. A password is never printed."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from armsight.errors import UsageError

VARIABLE = "ARMSIGHT_HISTORY"
FILE_NAME = "history.sqlite"
POSTGRESQL = "postgresql+pg8000"
SCHEMES = {"postgresql": POSTGRESQL, "postgres": POSTGRESQL, POSTGRESQL: POSTGRESQL}
EXTRAS = {"sqlalchemy": "history", "alembic": "history", "pg8000": "postgresql"}
"""Packages by the extra that brings them."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a history is: path of a file, or url of a server, one of the two."""

    path: Path | None = None
    url: str = ""

    def __str__(self) -> str:
        return str(self.path) if self.path is not None else without_password(self.url)


def place_of(given: str | None, environment: Mapping[str, str] | None = None) -> Place:
    """Return the place of a flag, else of $ARMSIGHT_HISTORY, else history.sqlite in the user's data folder.

    That is $XDG_DATA_HOME/armsight, or ~/.local/share/armsight. Raises UsageError for a URL of another kind.
    """
    environ = os.environ if environment is None else environment
    text = given or environ.get(VARIABLE) or ""
    if not text:
        home = environ.get("XDG_DATA_HOME", "")  # only an absolute path counts there, says the standard
        base = Path(home) if Path(home).is_absolute() else Path(environ.get("HOME", "~")).expanduser() / ".local/share"
        return Place(path=base / "armsight" / FILE_NAME)
    scheme, found, rest = text.partition("://")
    if not found:
        return Place(path=Path(text))
    if scheme in ("sqlite", "file"):
        return Place(path=Path("/" + rest.lstrip("/") if rest.startswith("//") else rest.removeprefix("/")))
    if scheme not in SCHEMES:
        raise UsageError(
            f"a history cannot be kept at {without_password(text)}: {scheme!r} is no kind of database that is known",
            consequence="Nothing was done",
            cure="Give a file (SQLite), or postgresql://USER:PASSWORD@HOST/DATABASE",
        )
    return Place(url=f"{SCHEMES[scheme]}://{rest}")


def without_password(url: str) -> str:
    """Return a URL as people may read it."""
    shown = re.sub(r"(://[^:@/]*):.*@", r"\1:***@", url)
    return re.sub(r"(?i)(password=)[^&]*", r"\1***", shown).replace(POSTGRESQL, "postgresql")


def require_packages(place: Place) -> None:
    """Raise UsageError, which names the extra, where a package is missing."""
    wanted = ["sqlalchemy", "alembic", *(["pg8000"] if place.path is None else [])]
    missing = [name for name in wanted if find_spec(name) is None]
    if missing:
        extra = EXTRAS[missing[-1]]
        raise UsageError(
            f"a history needs the package {' and '.join(missing)}, which is not installed",
            consequence="Nothing was done",
            cure=f"Install the extra: pip install 'armsight[{extra}]'",
        )
