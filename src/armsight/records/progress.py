"""How long work tells of itself and hears that it should stop."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Told by the work how far it is; asked by the work whether to go on."""

    def update(self, done: float, total: float, note: str = "") -> None:
        """Say that done of total is finished; total 0 means unknown."""
        ...

    def cancelled(self) -> bool:
        """Tell whether the person wants the work to stop."""
        ...


class Silent:
    """A Progress that says nothing and never cancels."""

    def update(self, done: float, total: float, note: str = "") -> None:
        """Say nothing."""

    def cancelled(self) -> bool:
        """Never."""
        return False


class TrackedProgress:
    """How far work is, for every page that shows it; each of them may end it. Any thread may call this.

    newest: done, total and note as they were told last.
    """

    def __init__(self) -> None:
        self.newest: tuple[float, float, str] = (0.0, 0.0, "")
        self._cancelled = False

    def update(self, done: float, total: float, note: str = "") -> None:
        """Take how far it is."""
        self.newest = (done, total, note)

    def cancelled(self) -> bool:
        """Return whether somebody ended it."""
        return self._cancelled

    def cancel(self) -> None:
        """End it as soon as it can."""
        self._cancelled = True
