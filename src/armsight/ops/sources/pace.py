"""How live pictures are measured: in time, and the views side by side where this process has two cores."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

from armsight.drivers import cores, is_live
from armsight.measure.settings import BATCH, LIVE_S, Pace, T


class SideBySide:
    """Does the work of views in a thread of its own, the second first, and meanwhile that of the first and the last.

    All in turn where no core is free.

    Kernels and OpenCV, three quarters of the work before a room, leave the interpreter's lock to the other thread;
    numpy's small steps, the records and the calls of kernels keep it.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="other views")

    def __call__(self, work: Callable[[int], T], n: int, /) -> list[T]:
        """Return [work(0), work(1), ...]; raises as the first view's does, else as another one's."""
        others = [self._pool.submit(work, s) for s in range(1, n)]
        done = [work(0)]
        for s in range(n - 1, 0, -1):
            done.insert(1, work(s) if others[s - 1].cancel() else others[s - 1].result())
        return done


@cache
def live_pace() -> Pace:
    """Return the pace of live pictures; one thread serves all of a process."""
    return Pace(deadline_s=LIVE_S, each=SideBySide()) if cores() > 1 else Pace(deadline_s=LIVE_S)


def pace_of(*sources: str | None) -> Pace:
    """Return the pace of live pictures where one of the sources is a camera, else that of files."""
    return live_pace() if any(source is not None and is_live(source) for source in sources) else BATCH
