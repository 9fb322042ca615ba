"""What the operating system runs first: measuring before the pictures of it that people look at."""

from __future__ import annotations

import os
import threading
from contextlib import suppress

REAL_TIME = 1
"""The least of the real-time priorities: before all usual work, such as browsers, behind a robot's loop."""
PICTURES = 5
"""Niceness of what only people look at; browsers on the same machine have 0."""


def measure_first() -> None:
    """Let the calling thread run before usual work, where the system knows and allows that.

    Linux allows it to root, and to whom limits.conf gives rtprio. Niceness does not do: Linux shares the processors
    between sessions first. It is this one thread alone, and not on a single processor, so that whatever it has to do,
    a processor is left for a robot's stop and for what is the page's.
    """
    if hasattr(os, "sched_setscheduler") and (os.cpu_count() or 1) > 1:
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(REAL_TIME))


def pictures_last() -> None:
    """Let the calling thread wait for others."""
    if hasattr(os, "setpriority"):
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), PICTURES)
