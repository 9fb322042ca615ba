"""The operating system's order of threads: a control loop first, then the line for stops, then all other work; the web
server gives way to it, and pictures to the web server.

Linux allows real-time priorities to root, and to whom limits.conf gives rtprio; elsewhere nothing changes. Niceness
would not do: Linux shares the processors between sessions first.

A thread with such a priority that never sleeps takes its processor from everybody. So the kernel watches it
(RLIMIT_RTTIME): a watchdog in a thread of this process would wait for the interpreter's lock, which the loop may hold,
and the loop now and then for a lock that the watchdog holds.
"""

from __future__ import annotations

import os
import signal
import threading
from contextlib import suppress
from pathlib import Path
from types import FrameType

CONTROL = 10
"""Of SCHED_FIFO: before all usual work, behind the kernel's own threads."""
LISTENS = 5
"""Of SCHED_FIFO: the line for stops, behind every control loop."""
SERVES, BEHIND = 5, 10
"""Niceness of the web server, and of pictures behind it: Linux gives each a third of the time of what is before it."""
WORKS_S = 0.1
"""Longest that a thread works before all others without sleeping: 25 cycles of 4 ms, and a tenth of what tells a loop
that hangs. The kernel counts in its ticks of 1 to 10 ms."""
BACK_S = 2.0
"""Time after which a thread that worked for so long may go first again: loading and compiling before a loop's first
cycle works for seconds. One that goes on has WORKS_S of every BACK_S."""
HANGS_S = 10.0
"""A thread that works on first for so long without running any of Python's code is ended by the kernel, with its
process: compiled code that does not end. Nothing else could take its processor away."""


def control_first() -> bool:
    """Let the calling thread run before all others; return whether the system allows that.

    Threads and processes that it starts run as usual. It sleeps at least every WORKS_S, or runs as usual for BACK_S. Of
    a process whose main thread neither calls this nor bound_control no thread goes first.

    Without it a machine with other work wakes a 4 ms loop 3 ms late at p99; with it 0.01 ms.
    """
    return bound_control() and _schedule(threading.get_native_id(), CONTROL)


def listen_first() -> bool:
    """Let the calling thread run before usual work, behind control loops; else as control_first.

    A flood that keeps it awake for WORKS_S makes it run as usual for BACK_S: nobody outside takes the processors.
    """
    return bound_control() and _schedule(threading.get_native_id(), LISTENS)


def bound_control() -> bool:
    """Bound what threads of this process that go first may work; return whether they are bound.

    To be called in the main thread, which alone may be asked to by Python; another learns whether it has been.
    """
    if not hasattr(os, "SCHED_RESET_ON_FORK"):  # Linux alone has it, and the bound
        return False
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGXCPU, _put_back)
        _limit()
    return signal.getsignal(signal.SIGXCPU) is _put_back


def give_way(niceness: int = BEHIND) -> None:
    """Let the calling thread, and what it starts, run behind usual work, yet not never: for what can wait."""
    if not hasattr(os, "SCHED_RESET_ON_FORK"):  # elsewhere niceness is of a whole process
        return
    thread = threading.get_native_id()
    if os.getpriority(os.PRIO_PROCESS, thread) < niceness:  # who was begun behind more stays there
        os.setpriority(os.PRIO_PROCESS, thread, niceness)


def _limit() -> None:
    """Have the kernel tell of a thread that goes first and works for WORKS_S; it raises that bound as it tells."""
    import resource  # not on Windows

    _, hard = resource.getrlimit(resource.RLIMIT_RTTIME)
    ends = round(1e6 * HANGS_S)
    ends = ends if hard == resource.RLIM_INFINITY else min(ends, hard)
    resource.setrlimit(resource.RLIMIT_RTTIME, (min(round(1e6 * WORKS_S), ends), ends))


def _put_back(number: int, frame: FrameType | None) -> None:
    """Let every thread of this process run as usual, for BACK_S."""
    first = {thread: priority for thread in _threads() if (priority := _goes_first(thread))}
    for thread in first:
        _schedule(thread, 0)
    back = threading.Timer(BACK_S, _give_back, (first,))
    back.daemon = True
    back.start()


def _give_back(threads: dict[int, int]) -> None:
    _limit()
    for thread in threads.keys() & _threads():  # the number of one that has ended may be another process's by now
        _schedule(thread, threads[thread])


def _threads() -> set[int]:
    return {int(thread.name) for thread in Path("/proc/self/task").iterdir()}


def _goes_first(thread: int) -> int:
    """Return the priority of a thread that goes first; 0 of one that runs as usual."""
    with suppress(ProcessLookupError):
        if os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
            return os.sched_getparam(thread).sched_priority
    return 0


def _schedule(thread: int, priority: int) -> bool:
    """Give a thread a priority of SCHED_FIFO; 0: let it run as usual. Return whether the system allows that."""
    policy = os.SCHED_FIFO if priority else os.SCHED_OTHER
    with suppress(OSError):
        os.sched_setscheduler(thread, policy | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        return True
    return False
