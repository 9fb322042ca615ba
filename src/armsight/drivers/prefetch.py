"""Work ahead of the reader in threads, in order and with bounded memory."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import repeat
from typing import TypeVar

In = TypeVar("In")
Out = TypeVar("Out")

AHEAD = 8
"""Results kept ready: hides the time of one slow file, and is under 10 MB of 720p images."""


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def ordered_map(
    function: Callable[[In], Out], items: Iterable[In], *, workers: int | None = None, ahead: int = AHEAD
) -> Generator[Out, None, None]:
    """Yield function(item) for each item in order, computed in threads at most `ahead` items before they are asked for.

    Pays where the function releases the interpreter's lock (decoding, file reading, OpenCV). An error is
    raised at its own item. Closing the iterator cancels what has not begun.
    """
    with ThreadPoolExecutor(workers or cores(), thread_name_prefix="ahead") as pool:
        pending: deque[Future[Out]] = deque()
        try:
            for item in items:
                pending.append(pool.submit(function, item))
                if len(pending) > ahead:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()


def read_ahead(items: Iterable[Out], *, ahead: int = AHEAD) -> Generator[Out, None, None]:
    """Yield the items of an iterator that one thread of its own pulls, at most `ahead` before they are asked for."""
    iterator = iter(items)
    end = object()
    for item in ordered_map(lambda _: next(iterator, end), repeat(None), workers=1, ahead=ahead):
        if item is end:
            return
        yield item  # type: ignore[misc]  # end, the only other type, has just been excluded
