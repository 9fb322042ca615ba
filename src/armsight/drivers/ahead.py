"""What is read or computed in threads before it is asked for; sources of frames in files are read so, and only here."""

from __future__ import annotations

import os
import warnings
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from itertools import repeat
from typing import Any, TypeVar, cast

from armsight.records import Frame

In = TypeVar("In")
Out = TypeVar("Out")

AHEAD = 8
"""Results kept ready: hides the time of one slow file, and is under 10 MB of 720p images."""

CORES = "ARMSIGHT_CORES"
"""Environment variable: how many cores a process may use that shares the machine with others like it."""


def cores() -> int:
    """Return how many cores this process may use."""
    given = os.environ.get(CORES, "")
    if given.isdecimal() and int(given):
        return int(given)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


STALLED_S = 30.0
"""Wait for one result after which a person hears of it: a picture takes milliseconds, a disk that wakes up seconds."""

_END = object()


class Ahead(Iterator[Out]):
    """function(item) of each item in order, computed in threads, from now on, at most `ahead` before it is asked for.

    Pays where the function releases the interpreter's lock (decoding, file reading, OpenCV). What function or items
    raise is raised where its result would come. name: of what is read: of a file that stalls there is a warning. To be
    closed: what has not begun is then cancelled, and what has begun is waited for.
    """

    def __init__(
        self,
        function: Callable[[In], Out],
        items: Iterable[In],
        name: str = "",
        *,
        workers: int | None = None,
        ahead: int = AHEAD,
    ) -> None:
        self._function, self._items, self._ahead, self._name = function, iter(items), ahead, name
        self._pool = ThreadPoolExecutor(workers or cores(), thread_name_prefix="ahead")
        self._pending: deque[Future[Out]] = deque()
        self._failed: BaseException | None = None
        self._begin()

    def _begin(self) -> None:
        while len(self._pending) <= self._ahead:
            try:
                item = next(self._items)
            except StopIteration:
                return
            except Exception as error:  # comes behind the results of the items before it
                self._failed, self._items = error, iter(())
                return
            self._pending.append(self._pool.submit(self._function, item))

    def __next__(self) -> Out:
        try:
            if not self._pending:
                raise self._failed or StopIteration
            result = self._awaited(self._pending.popleft())
            if result is _END:
                raise StopIteration
            self._begin()
        except BaseException:
            self.close()
            raise
        return result

    def _awaited(self, future: Future[Out]) -> Out:
        if self._name and not future.done() and not wait((future,), STALLED_S).done:
            warnings.warn(
                f"{self._name}: nothing could be read for {STALLED_S:.0f} s. It is waited for, and no picture is "
                "lost. Check the disk or the network that it is on",
                stacklevel=2,
            )
            self._name = ""
        return future.result()

    def close(self) -> None:
        """Compute nothing more; a second call does nothing."""
        self._items, self._failed = iter(()), None
        self._pending.clear()
        self._pool.shutdown(cancel_futures=True)


def read_ahead(items: Iterable[Out], name: str = "") -> Ahead[Out]:
    """Return the items of an iterator that one thread of its own pulls before they are asked for."""
    iterator = iter(items)
    return Ahead(lambda _: next(iterator, cast(Out, _END)), repeat(None), name, workers=1)


class FileSource(ABC):
    """A source of frames in files, which are read ahead from `iter` on and no longer than it is open."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._ahead: Ahead[Any] | None = None

    @abstractmethod
    def _frames(self) -> Iterator[Frame]:
        """Yield the frames, in a thread of its own."""

    @abstractmethod
    def _close(self) -> None:
        """Close the file; nothing is read from it then."""

    def stamps_s(self) -> Iterator[float]:
        """Yield the frames' times, once it is open; no picture is decoded where the times stand beside them."""
        return (frame.t_s for frame in self)

    def __iter__(self) -> Iterator[Frame]:
        self._end()
        self._ahead = read = read_ahead(self._frames(), self.name)
        return read

    def __exit__(self, *_: object) -> None:
        self._end()
        self._close()

    def _end(self) -> None:
        if self._ahead is not None:
            self._ahead.close()
            self._ahead = None
