"""Keys of the terminal beside a running loop: each does one thing, at once."""

from __future__ import annotations

import os
import select
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from armsight.drivers.jog_inputs import single_keys

LOOK_S = 0.1


@contextmanager
def listening(actions: Mapping[str, Callable[[], object]]) -> Iterator[None]:
    """Call the action of each key that is pressed, from a thread, until it ends. Without a terminal nothing happens."""
    if not sys.stdin.isatty():
        yield
        return
    end = threading.Event()

    def look(fd: int) -> None:
        while not end.is_set():
            if not select.select([fd], [], [], LOOK_S)[0]:
                continue
            for key in os.read(fd, 64).decode("ascii", "ignore"):
                action = actions.get(key)
                if action is not None:
                    action()

    with single_keys() as fd:
        thread = threading.Thread(target=look, args=(fd,), name="keys", daemon=True)
        thread.start()
        try:
            yield
        finally:
            end.set()
            thread.join()
