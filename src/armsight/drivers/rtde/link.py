"""The way to a controller: where it is, whether RTDE answers there, and ur-rtde's connections to it."""

from __future__ import annotations

import contextlib
import ctypes
import os
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from armsight.errors import DeviceFailed, DeviceNotFound, UsageError

PORT = 30004
"""RTDE's port on a controller."""

OTHERS = {"dashboard": -5, "program": -1}
"""The other ports that are needed, by their distance to RTDE's."""

PROTOCOL = 2

VARIABLES = ["timestamp", "actual_q", "runtime_state", "safety_status_bits"]
"""What is received each cycle."""

TRIES = 20
"""Own loopback addresses tried for a relay."""


def address(device: str) -> tuple[str, int]:
    """Return host and port of HOST[:PORT]. Raises UsageError."""
    host, colon, port = device.rpartition(":") if ":" in device else (device, "", str(PORT))
    if host and "/" not in host and " " not in host and port.isascii() and port.isdigit() and 5 < int(port) < 65536:
        return host, int(port)
    raise UsageError(
        f"{device!r} is not HOST or HOST:PORT", consequence="There is no robot", cure="Give for instance rtde:10.0.0.5"
    )


def check_answers(host: str, port: int, wait_s: float) -> None:
    """Make sure that RTDE 2 answers and the other ports are open. Raises DeviceNotFound.

    ur-rtde waits without end, and with the interpreter's lock held, for a controller that does not answer.
    """
    try:
        with socket.create_connection((host, port), wait_s) as link:
            link.settimeout(wait_s)
            link.sendall(struct.pack(">HBH", 5, ord("V"), PROTOCOL))
            answer = link.recv(4, socket.MSG_WAITALL)
        for distance in OTHERS.values():
            socket.create_connection((host, port + distance), wait_s).close()
    except (OSError, UnicodeError) as error:
        raise DeviceNotFound(
            f"no controller answers at {host}:{port}: {error}",
            consequence="The robot is not opened",
            cure="Check address and cable, that the controller has started, and that remote control is on",
        ) from error
    if answer != struct.pack(">HBB", 4, ord("V"), 1):
        raise DeviceNotFound(
            f"what answers at {host}:{port} does not speak RTDE 2",
            consequence="The robot is not opened",
            cure="Give the controller's address; PolyScope 3.4 or later is needed",
        )


class Connections:
    """ur-rtde's receiver and controller. Raises DeviceFailed where they cannot be had, with what ur-rtde says."""

    def __init__(self, host: str, port: int, frequency_hz: float, wait_s: float) -> None:
        receive, control = library()
        check_answers(host, port, wait_s)
        self._relay = Relay(host, port) if port != PORT else None
        self.receiver: Any = None
        self.controller: Any = None
        near = self._relay.own if self._relay else host
        try:
            self.receiver = receive.RTDEReceiveInterface(near, frequency_hz, VARIABLES)
            self.controller = control.RTDEControlInterface(near, frequency_hz)
        except Exception as error:
            self.close()
            raise DeviceFailed(
                f"the controller at {host}:{port} cannot be driven: {error}",
                consequence="The robot is not opened",
                cure="Look at the controller: remote control on, brakes released, no other client, no fieldbus that "
                "uses the same registers",
            ) from error

    def close(self) -> None:
        """Close both. ur-rtde sleeps half a second behind each; nobody waits for that."""
        ends = [end for end in (self.controller, self.receiver) if end is not None]
        for end in ends:
            # its destructor would sleep once more, then with the interpreter's lock held: it is never destroyed
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(end))
            threading.Thread(target=_disconnect, args=(end,)).start()
        deadline_s = time.monotonic() + 1.0
        while any(end.isConnected() for end in ends) and time.monotonic() < deadline_s:
            time.sleep(0.001)
        if self._relay:
            self._relay.close()


class Relay:
    """A process that carries connections to a controller behind another port than RTDE's own; own: its address."""

    def __init__(self, host: str, port: int) -> None:
        program = Path(__file__).with_name("relay.py")
        said = ""
        for i in range(TRIES):
            number = os.getpid() * TRIES + i
            self.own = f"127.{64 + (number >> 16) % 128}.{(number >> 8) % 256}.{1 + number % 250}"
            command = [sys.executable, "-I", str(program), self.own, host, str(port)]
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
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
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        self._process.wait()


def library() -> tuple[Any, Any]:
    """Return ur-rtde's modules. Raises DeviceNotFound where it is not installed."""
    try:
        import rtde_control
        import rtde_receive
    except ImportError as error:
        raise DeviceNotFound(
            "the library ur-rtde is not installed",
            consequence="Universal Robots cannot be driven",
            cure="Install armsight with the extra rtde: pip install 'armsight[rtde]'",
        ) from error
    return rtde_receive, rtde_control


def _disconnect(end: Any) -> None:
    with contextlib.suppress(Exception):
        end.disconnect()
