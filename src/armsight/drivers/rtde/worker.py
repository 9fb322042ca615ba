"""Keeps ur-rtde's connections in a process of its own, and passes states and goals on.

ur-rtde holds the interpreter's lock while it connects and while it cleans up, connects again by itself after a loss,
and may crash when a controller goes away: none of that may touch the process that guards the arm. This program needs
ur-rtde and the standard library only. Arguments: host, cycle in s, servoj's lookahead in s and gain, watchdog in Hz,
number of the open socket to the driver.

To the driver: one STATE for each state of the controller; last, where it fails, a STATE of time "not a number" and the
reason as text. From the driver: GOALS of joint
values in rad; its end, or a goal that is not finite, ends the program on the controller and this one.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import socket
import struct
import sys
import time
from typing import Any

STATE = struct.Struct("<d6d6diI")
"""Controller's clock in s, joint values and where they are meant to be in rad, runtime_state, safety_status_bits."""

GOAL = struct.Struct("<6d")

VARIABLES = ["timestamp", "actual_q", "target_q", "runtime_state", "safety_status_bits"]

PLAYING = 2
"""runtime_state of a controller whose program runs."""

START_S = 3.0
"""Time for the uploaded program to run."""

FIRST = 10
"""Of SCHED_FIFO: as the loop's thread."""

WORKS_US = 500_000
"""Longest work without a pause, in microseconds: 250 cycles."""

POLL_S = 1e-4
"""How often a new state is looked for once it is due."""

WAIT_SHARE = 0.25
"""Share of a cycle for which the driver's answer to a state is waited for; then the last goal holds on."""

STOP_M_S2 = 1.0
"""Deceleration of the tool when the link is closed."""


def main() -> None:
    """Run until the driver or the controller ends it."""
    host, *numbers, descriptor = sys.argv[1:]
    cycle_s, lookahead_s, gain, watchdog_hz = map(float, numbers)
    link = socket.socket(fileno=int(descriptor))
    go_first()
    try:
        import rtde_control
        import rtde_receive

        receiver = rtde_receive.RTDEReceiveInterface(host, 1.0 / cycle_s, VARIABLES)
        controller = rtde_control.RTDEControlInterface(host, 1.0 / cycle_s)
        set_going(receiver, controller, watchdog_hz)
        keep_going(link, receiver, controller, cycle_s, (lookahead_s, gain))
        controller.servoStop(STOP_M_S2)
        controller.stopScript()
    except Exception as error:
        text = f"{type(error).__name__}: {error}".encode()
        with contextlib.suppress(OSError):
            link.setblocking(True)
            link.sendall(STATE.pack(math.nan, *[0.0] * 12, 0, 0) + text)
    os._exit(0)  # ur-rtde's destructors sleep, and there is nothing left for them to do


def go_first() -> None:
    """Run before all other work where the system allows that, as the loop that waits for the states does.

    The kernel ends this program where it works for WORKS_US without a pause: then the link is lost, and the arm stops.
    """
    with contextlib.suppress(ImportError, AttributeError, OSError, ValueError):  # Linux has it, with the right to it
        import resource

        resource.setrlimit(resource.RLIMIT_RTTIME, (WORKS_US, WORKS_US))
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(FIRST))


def set_going(receiver: Any, controller: Any, watchdog_hz: float) -> None:
    """Wait until the program runs by both connections and has set its watchdog. Raises RuntimeError.

    ur-rtde takes an old state for the new program's where a program ran before: what counts is that it obeys.
    """
    end_s = time.monotonic() + START_S
    while time.monotonic() < end_s:
        runs = receiver.getRuntimeState() == PLAYING and controller.isProgramRunning()
        if runs and controller.setWatchdog(watchdog_hz) and receiver.getRuntimeState() == PLAYING:
            return
        time.sleep(POLL_S)
    raise RuntimeError("the control program does not run on the controller")


def keep_going(link: socket.socket, receiver: Any, controller: Any, cycle_s: float, servo: tuple[float, float]) -> None:
    """Pass states on and send goals; return where the driver wants an end."""
    last_s, goal = -math.inf, None
    link.setblocking(False)
    while True:
        stamp_s = receiver.getTimestamp()
        if stamp_s == last_s:
            if not receiver.isConnected():
                raise ConnectionError("the controller has closed the connection")
            if ended(link):
                return
            time.sleep(POLL_S)
            continue
        last_s = stamp_s
        q = [*receiver.getActualQ(), *receiver.getTargetQ()]
        runtime, safety = int(receiver.getRuntimeState()), int(receiver.getSafetyStatusBits())
        if select.select([], [link], [], 0.0)[1]:  # a driver that stands still takes none: its goal is held meanwhile
            link.sendall(STATE.pack(stamp_s, *q, runtime, safety))
        select.select([link], [], [], WAIT_SHARE * cycle_s)
        goal = newest(link, goal)
        if goal is not None and not all(map(math.isfinite, goal)):
            return
        # speed and acceleration are not used by servoj
        if goal is not None and not controller.servoJ(goal, 0.5, 0.5, cycle_s, *servo):
            raise RuntimeError("the controller took no goal")
        time.sleep(0.5 * cycle_s)


def newest(link: socket.socket, goal: list[float] | None) -> list[float] | None:
    """Return the newest goal that the driver has sent, or the one before."""
    data = b""
    with contextlib.suppress(BlockingIOError):
        data = link.recv(100 * GOAL.size, socket.MSG_PEEK)
        if not data:
            return [math.nan] * 6
    complete = len(data) // GOAL.size * GOAL.size
    if complete:
        link.recv(complete)
        return list(GOAL.unpack(data[complete - GOAL.size : complete]))
    return goal


def ended(link: socket.socket) -> bool:
    """Tell whether the driver is gone or has asked for the end."""
    goal = None
    with contextlib.suppress(BlockingIOError):
        data = link.recv(GOAL.size, socket.MSG_PEEK)
        goal = list(GOAL.unpack(data)) if len(data) == GOAL.size else None
        if not data:
            return True
    return goal is not None and not all(map(math.isfinite, goal))


if __name__ == "__main__":
    main()
