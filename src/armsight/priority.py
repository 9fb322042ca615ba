"""The operating system's order of threads: a robot's loop, measuring, pictures of it, and all usual work last.

Linux allows real-time priorities to root, and to whom limits.conf gives rtprio; elsewhere nothing changes. Niceness
would not do: Linux shares the processors between sessions first.
"""

from __future__ import annotations

import os
from contextlib import suppress

CONTROL = 10
"""Of SCHED_FIFO: before all usual work, behind the kernel's own threads."""
MEASURING = 2
"""Of SCHED_RR: before all usual work, such as browsers, behind a robot's loop."""
BESIDE_MEASURING = 1


def control_first() -> bool:
    """Let the calling thread, and those it starts, run before all others; return whether the system allows that.

    Without it a machine with other work wakes a 4 ms loop 3 ms late at p99; with it 0.01 ms.
    """
    if not hasattr(os, "sched_setscheduler"):
        return False
    return _schedule(os.SCHED_FIFO, CONTROL)


def measure_first() -> None:
    """Let the calling thread, and those it starts, run before usual work.

    Those too, for a thread that other work keeps from running may hold the interpreter's lock, or a camera's frame,
    and measuring then waits for both. Not on a single processor: one is left for what is the page's.
    """
    if hasattr(os, "sched_setscheduler") and (os.cpu_count() or 1) > 1:
        _schedule(os.SCHED_RR, MEASURING)


def beside_measuring() -> None:
    """Let the calling thread run behind the one that measures, yet before usual work where that one does.

    For what shares its interpreter and works little; who works long leaves processors to usual work by resting.
    """
    if hasattr(os, "sched_getscheduler") and os.sched_getscheduler(0) == os.SCHED_RR:
        _schedule(os.SCHED_RR, BESIDE_MEASURING)


def as_usual() -> None:
    """Let the calling thread run as all usual work does, whoever started it: for long work that can wait."""
    if hasattr(os, "sched_setscheduler"):
        _schedule(os.SCHED_OTHER, 0)


def _schedule(policy: int, priority: int) -> bool:
    with suppress(OSError):
        os.sched_setscheduler(0, policy, os.sched_param(priority))
        return True
    return False
