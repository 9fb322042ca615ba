"""How long work tells of itself and hears that it should stop."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Told by the work how far it is; asked by the work whether to go on."""

    def update(self, done: float, total: float, note: str = "") -> None:
        """Say that done of total is finished; total 0 means unknown."""

    def cancelled(self) -> bool:
        """Tell whether the person wants the work to stop."""


class Silent:
    """A Progress that says nothing and never cancels."""

    def update(self, done: float, total: float, note: str = "") -> None:
        """Say nothing."""

    def cancelled(self) -> bool:
        """Never."""
        return False
