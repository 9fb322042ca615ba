"""How live pictures are measured: in time, and both views side by side where this process has two cores."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

from armsight.drivers import cores, is_live
from armsight.measure.settings import BATCH, LIVE_S, Pace, T


class SideBySide:
    """Does the right view's work in a thread of its own, meanwhile the left one's; both in turn where no core is free.

    Kernels and OpenCV, three quarters of the work before a room, leave the interpreter's lock to the other thread;
    numpy's small steps, the records and the calls of kernels keep it.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="right view")

    def __call__(self, work: Callable[[int], T], /) -> tuple[T, T]:
        """Return (work(0), work(1)); raises as the left view's does, else as the right one's."""
        right = self._pool.submit(work, 1)
        left = work(0)
        return left, work(1) if right.cancel() else right.result()


@cache
def live_pace() -> Pace:
    """Return the pace of live pictures; one thread serves all of a process."""
    return Pace(deadline_s=LIVE_S, both=SideBySide()) if cores() > 1 else Pace(deadline_s=LIVE_S)


def pace_of(*sources: str | None) -> Pace:
    """Return the pace of live pictures where one of the sources is a camera, else that of files."""
    return live_pace() if any(source is not None and is_live(source) for source in sources) else BATCH
