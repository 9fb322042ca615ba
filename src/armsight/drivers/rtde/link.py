"""The way to a controller: its address, the process that holds ur-rtde's connections, a relay for other ports."""

from __future__ import annotations

import contextlib
import importlib.util
import math
import os
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from armsight.drivers.rtde.worker import GOAL, PLAYING, STATE
from armsight.errors import DeviceFailed, DeviceLost, DeviceNotFound, UsageError

PORT = 30004
"""RTDE's port on a controller."""

DASHBOARD_BELOW = 5
LEAST_PORT = 1 + DASHBOARD_BELOW
"""The dashboard is at 29999: behind other numbers the controller's three ports keep their distances (relay.py)."""

PROBE_S = 2.0
"""Time that is given a connection which only tells why none could be made."""

MODULES = ("rtde_control", "rtde_receive")
"""ur-rtde's modules."""

TRIES = 20
"""Own loopback addresses tried for a relay."""

LONGEST_TEXT = 1000
"""Bytes of ur-rtde's reason at most."""

END_S = 2.0
"""Time for the controller's program to come to its end before the connections are cut."""


def address(device: str) -> tuple[str, int]:
    """Return host and port of HOST[:PORT]. Raises UsageError."""
    host, _, port = device.rpartition(":") if ":" in device else (device, "", str(PORT))
    if not (host and "/" not in host and " " not in host and port.isascii() and port.isdigit()):
        raise UsageError(f"{device!r} is not HOST or HOST:PORT", cure="Give for instance rtde:10.0.0.5")
    if not LEAST_PORT <= int(port) < 65536:
        raise UsageError(
            f"a controller cannot be at port {int(port)}: the dashboard is {DASHBOARD_BELOW} ports below RTDE's",
            cure=f"Give a port from {LEAST_PORT} to 65535, or leave it out for {PORT}",
        )
    return host, int(port)


def unreachable(host: str, port: int) -> str:
    """Return why nothing takes a connection there, in the system's words; "" where something does."""
    try:
        socket.create_connection((host, port), PROBE_S).close()
    except OSError as error:
        return error.strerror or str(error)
    return ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ControllerState:
    """What the controller told in one cycle: its clock in s, joints and where they are meant to be, what it can do."""

    stamp_s: float
    q: tuple[float, ...]
    q_planned: tuple[float, ...]
    runtime: int
    safety: int


class Worker:
    """A process with ur-rtde's connections; numbers: cycle s, lookahead s, gain, watchdog Hz. Raises DeviceNotFound."""

    def __init__(self, host: str, port: int, numbers: Sequence[float]) -> None:
        if not all(_there(name) for name in MODULES):
            raise DeviceNotFound(
                "the library ur-rtde is not installed",
                consequence="Universal Robots cannot be driven",
                cure="Install armsight with the extra rtde: pip install 'armsight[rtde]'",
            )
        self._relay = Relay(host, port) if port != PORT else None
        near = self._relay.own if self._relay else host
        self._link, far = socket.socketpair()
        try:
            program = str(Path(__file__).with_name("worker.py"))
            command = [sys.executable, "-P", program, near, *map(repr, numbers), str(far.fileno())]
            self._process = subprocess.Popen(
                command, pass_fds=[far.fileno()], stdin=subprocess.DEVNULL, start_new_session=True
            )
        finally:
            far.close()

    def receive(self, wait_s: float) -> ControllerState | None:
        """Return the newest state; None where none comes within wait_s. Raises DeviceLost where ur-rtde has ended.

        Those before it are left out: the cycles in which they could be answered are over.
        """
        self._link.settimeout(wait_s)
        try:
            data = self._link.recv(STATE.size, socket.MSG_WAITALL)
        except TimeoutError:
            return None
        except OSError:
            data = b""
        self._link.settimeout(0.0)
        with contextlib.suppress(OSError, struct.error):  # no more, or the reason of an end behind it
            while _goes_on(data) and STATE.unpack(self._link.recv(STATE.size, socket.MSG_PEEK))[0] >= 0.0:
                data = self._link.recv(STATE.size)
        if len(data) < STATE.size:
            raise DeviceLost(f"ur-rtde has ended{self._how()}")
        stamp_s, *q, runtime, safety = STATE.unpack(data)
        n = len(q) // 2
        if math.isnan(stamp_s):
            self._link.settimeout(END_S)
            text = self._link.recv(LONGEST_TEXT).decode("utf-8", "replace")
            raise DeviceLost(f"ur-rtde says: {text}")
        return ControllerState(stamp_s=stamp_s, q=tuple(q[:n]), q_planned=tuple(q[n:]), runtime=runtime, safety=safety)

    def _how(self) -> str:
        """Return by what signal ur-rtde's process was ended, in brackets; empty where by none."""
        with contextlib.suppress(subprocess.TimeoutExpired, ValueError):
            return f" ({signal.Signals(-self._process.wait(END_S)).name})"
        return ""

    def send(self, q: Sequence[float]) -> None:
        """Send a goal (6,) in rad."""
        with contextlib.suppress(OSError):  # that it has ended is told by receive
            self._link.sendall(GOAL.pack(*q))

    def cut(self) -> None:
        """End the connections at once: ur-rtde would open them again by itself."""
        self._process.kill()

    def close(self, *, at_once: bool) -> None:
        """End the controller's program and the connections; at_once: only the connections."""
        if not at_once:
            self.send([math.nan] * 6)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(END_S)
        self._process.kill()
        self._process.wait()
        self._link.close()
        if self._relay:
            self._relay.close()
            self._relay = None


class Relay:
    """A process that carries connections to a controller behind another port than RTDE's own; own: its address."""

    def __init__(self, host: str, port: int) -> None:
        program = Path(__file__).with_name("relay.py")
        said = ""
        for i in range(TRIES):
            number = os.getpid() * TRIES + i
            self.own = f"127.{64 + (number >> 16) % 128}.{(number >> 8) % 256}.{1 + number % 250}"
            command = [sys.executable, "-P", str(program), self.own, host, str(port)]
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
            )
            said = self._process.stdout.readline().strip() if self._process.stdout else ""
            if said == "ready":
                return
            self.close()
        raise DeviceFailed(
            f"port {port} of {host} cannot be reached: {said}",
            consequence="ur-rtde knows no other port than 30004, and a relay to it cannot be set up",
            cure="Forward 30004, 30003 and 29999 under their own numbers",
        )

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()


def _goes_on(data: bytes) -> bool:
    """Tell whether a state is one of a program that runs; one that tells an end is not passed over."""
    stamp_s, *_, runtime, _ = STATE.unpack(data)
    return bool(stamp_s >= 0.0 and runtime == PLAYING)


def _there(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ValueError:  # imported already, or kept from being imported
        return sys.modules.get(name) is not None
