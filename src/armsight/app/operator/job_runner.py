"""Work that moves the robot while a page only watches it: one at a time, and a page loaded anew finds it again."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from armsight.errors import ArmsightError, DeviceFailed
from armsight.records import TrackedProgress


class BackgroundJob(TrackedProgress):
    """One piece of work in a thread of its own; the Progress of what it does. Any thread may call this.

    failure: why it ended early, empty where it did not. question: what is asked before it goes on, empty for nothing.
    """

    def __init__(self, name: str, browser: str) -> None:
        """browser: the one that began it, whose enable it moves with."""
        super().__init__()
        self.name, self.browser = name, browser
        self.result: Any = None
        self.failure = ""
        self.question = ""
        self._answer: bool | None = None
        self._asked = threading.Condition()
        self._thread: threading.Thread | None = None

    def begin(self, act: Callable[[BackgroundJob], Any]) -> None:
        """Do it in a thread."""
        self._thread = threading.Thread(target=self._run, args=(act,), name=self.name, daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self._thread is not None and self._thread.is_alive()

    def cancel(self) -> None:
        """End it as soon as it can."""
        super().cancel()
        with self._asked:
            self._asked.notify_all()

    def ask(self, question: str) -> bool:
        """Wait for the person's yes or no; no where the work is cancelled."""
        with self._asked:
            self.question, self._answer = question, None
            self._asked.wait_for(lambda: self._answer is not None or self.cancelled())
            self.question = ""
            return bool(self._answer)

    def answer(self, yes: bool, browser: str) -> None:
        """Answer what is asked; the work then moves with this browser's enable."""
        with self._asked:
            self.browser, self._answer = browser, yes
            self._asked.notify_all()

    def wait(self, timeout_s: float | None = None) -> None:
        """Wait for its end."""
        if self._thread is not None:
            self._thread.join(timeout_s)

    def _run(self, act: Callable[[BackgroundJob], Any]) -> None:
        try:
            self.result = act(self)
        except ArmsightError as error:
            self.failure = str(error)
        except Exception as error:  # a page has to tell it, whatever it was
            self.failure = f"{type(error).__name__}: {error}"


class JobRunner:
    """Where work is done: one at a time; the last one stays until the next begins."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.current: BackgroundJob | None = None

    def begin(self, name: str, browser: str, act: Callable[[BackgroundJob], Any]) -> BackgroundJob:
        """Begin work. Raises DeviceFailed where other work runs."""
        with self._lock:
            if self.current is not None and self.current.running:
                raise DeviceFailed(
                    f"{self.current.name} is still under way",
                    consequence=f"{name} is not begun",
                    cure="Wait for its end, or end it",
                )
            self.current = BackgroundJob(name, browser)
            self.current.begin(act)
            return self.current

    def named(self, name: str) -> BackgroundJob | None:
        """Return the work of this name, under way or ended; None where there is none."""
        return self.current if self.current is not None and self.current.name == name else None

    def close(self) -> None:
        """End what is under way."""
        if self.current is not None:
            self.current.cancel()
            self.current.wait(10.0)
