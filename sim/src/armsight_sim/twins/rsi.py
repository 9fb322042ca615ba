"""An emulated KUKA controller that runs RSI: each cycle it sends its state over UDP and takes a correction.

Corrections are absolute, from where RSI was started, and hold until another comes. An answer that does not carry the
cycle's IPOC within the cycle is late; after so many in a row the controller ends RSI, and its program starts it again.
So it does where a correction asks an axis for more than its largest speed.
"""

from __future__ import annotations

import contextlib
import math
import re
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from armsight.arrays import Array
from armsight.clock import Clock
from armsight.errors import Inconsistent, UsageError
from armsight_sim.arms import Drive, Servo, SimArm
from armsight_sim.twins.base import RIGHT, Wrong, clipped, host_port, note_silence, twin_arm, twin_drive, twin_home

LATE_LIMIT = 100
"""Late answers in a row after which RSI ends: the ETHERNET object's Timeout."""

PAUSE_CYCLES = 25
"""So long the program takes to start RSI again."""

CYCLE_S = 0.004
DRIVER = "127.0.0.1:49152"
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


class RsiFault(StrEnum):
    """What can be made to go wrong."""

    SILENT = "silent"
    FROZEN = "frozen"
    """The same packet goes out again and again."""


@dataclass(slots=True)
class RsiTwinCounts:
    """Answers taken, refused (no correction), with a wrong IPOC; cycles late in this session; how often RSI ended."""

    taken: int = 0
    refused: int = 0
    mismatched: int = 0
    late: int = 0
    ended: int = 0


class RsiController:
    """One controller; `cycle` is what it does each cycle. It sends to driver (address, port)."""

    def __init__(
        self, driver: tuple[str, int], *, arm: SimArm, drive: Drive, home: ArrayLike, sen_type: str = "ImFree"
    ) -> None:
        if arm.n != 6:
            raise UsageError(f"RSI is for six axes, the arm has {arm.n}", cure="Take another arm")
        self.arm = arm
        self.counts = RsiTwinCounts()
        self.messages: list[str] = []
        self.late_limit = LATE_LIMIT
        self.wrong: Wrong = RIGHT
        self._late_row = 0
        self._driver = driver
        self._drive = drive
        self._sen = re.compile(rf'\s*<Sen\s+Type="{re.escape(sen_type)}"\s*>(.*)</Sen>\s*', re.DOTALL)
        self._servo = Servo(drive, home, keep=1000)
        self._faults: set[RsiFault] = set()
        self._cycles = 0
        self._ms = round(drive.cycle_s * 1000)
        self._ipoc = 4_208_163_000
        self._pause = 0
        self._last_packet = b""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._begin()

    @property
    def q(self) -> Array:
        """Where the joints are, (6,) in rad."""
        return np.asarray(self._servo.at(self._servo.t_s)[0])

    @property
    def link(self) -> socket.socket:
        """Its socket, to wait for an answer."""
        return self._socket

    def close(self) -> None:
        """Close its socket."""
        self._socket.close()

    def fault(self, fault: RsiFault | str, *, on: bool = True) -> None:
        """Make something go wrong, or right again."""
        (self._faults.add if on else self._faults.discard)(RsiFault(fault))

    def reboot(self) -> None:
        """Start anew: the IPOC begins near zero, and the arm stays where it is."""
        self._ipoc = 1000
        self._begin()

    def push(self, by: ArrayLike) -> None:
        """Move the arm by (6,) in rad without RSI, and start RSI there."""
        self._servo = Servo(self._drive, self.q + np.asarray(by, dtype=float), self._servo.t_s, keep=1000)
        self._begin()

    def cycle(self) -> None:
        """Take what has come, move for one cycle, and send."""
        self._listen()
        self._cycles += 1
        self._servo.advance(self._cycles * self._drive.cycle_s)
        if self._pause:
            self._pause -= 1
            if not self._pause:
                self._begin()
            return
        if RsiFault.SILENT in self._faults:
            return
        if RsiFault.FROZEN not in self._faults or not self._last_packet:
            self._ipoc += self._ms
            self._last_packet = self._packet()
        with contextlib.suppress(OSError):  # nobody listens there yet
            self._socket.sendto(self._last_packet, self._driver)
            self._asked = True

    def _begin(self) -> None:
        """Start RSI where the arm stands."""
        self._servo.halt()
        self._start = self._servo.goal
        self._connected = self._asked = False
        self.counts.late = self._late_row = 0
        with contextlib.suppress(OSError):
            while True:  # what is still under way was meant for the session before
                self._socket.recv(4096)

    def _listen(self) -> None:
        answered = False
        while True:
            try:
                data, sender = self._socket.recvfrom(4096)
            except OSError:  # nothing more, or the report that nobody listens
                break
            if sender[1] != self._driver[1] or self._pause:
                self.counts.refused += 1
                continue
            answered = self._take(data) or answered
        if self._asked and self._connected and not answered:
            self.counts.late += 1
            self._late_row += 1
            if self._late_row >= self.late_limit:
                self._end(f"{self._late_row} answers in a row were late")
        elif answered:
            self._late_row = 0
        self._connected = self._connected or answered

    def _end(self, why: str) -> None:
        """End RSI; the arm stays where it is."""
        self.messages.append(f"RSI ended and begins anew: {why}")
        self.counts.ended += 1
        self._servo.halt()
        self._pause = PAUSE_CYCLES
        self._asked = False

    def _take(self, data: bytes) -> bool:
        """Take one answer; tell whether it was one to this cycle."""
        try:
            ipoc, goal = self._goal(data.decode("ascii"))
        except (ValueError, LookupError, Inconsistent):
            self.counts.refused += 1
            return False
        if ipoc != self._ipoc:
            self.counts.mismatched += 1
            return False
        if (np.abs(goal - self._servo.goal) > 1.001 * self._drive.max_speed * self._drive.cycle_s).any():
            self._end("a correction asked an axis for more than its largest speed")
            return False
        self.counts.taken += 1
        self._servo.command(self._servo.t_s, goal)
        return True

    def _goal(self, text: str) -> tuple[int, Array]:
        """Return IPOC and joint goal (6,) in rad of an answer; raises where it holds none."""
        whole = self._sen.fullmatch(text)
        if whole is None:
            raise ValueError("no Sen of this type")
        ipocs = re.findall(r"<IPOC>\s*(\d+)\s*</IPOC>", whole[1])
        joint, pose = (_attributes(whole[1], *what) for what in (("AK", "A1 A2 A3 A4 A5 A6"), ("RKorr", "X Y Z A B C")))
        start = q = self._servo.goal if self.wrong.adds else self._start
        if joint is not None:
            q = q + np.deg2rad(self.wrong.of(joint))
        if pose is not None:
            q = self.arm.reach(_corrected(self.arm.frames(start)[-1], self.wrong.of(pose)), self._servo.goal)
        return int(ipocs[-1]), clipped(self.arm, self.wrong.joints(q, start))

    def _packet(self) -> bytes:
        """Return the controller's state."""
        q = self._servo.read(self._servo.t_s)[0]
        rows = (
            ("RIst", "X Y Z A B C", _xyzabc(self.arm.frames(q)[-1])),
            ("RSol", "X Y Z A B C", _xyzabc(self.arm.frames(self._start)[-1])),
            ("AIPos", "A1 A2 A3 A4 A5 A6", np.rad2deg(q)),
            ("ASPos", "A1 A2 A3 A4 A5 A6", np.rad2deg(self._start)),
        )
        text = "".join(
            f"<{tag} " + " ".join(f'{n}="{v:.6f}"' for n, v in zip(names.split(), values, strict=True)) + " />"
            for tag, names, values in rows
        )
        return f'<Rob Type="KUKA">{text}<Delay D="{self.counts.late}" /><IPOC>{self._ipoc}</IPOC></Rob>'.encode()


class RsiTwin:
    """`armsight twin rsi`: sends to connect (127.0.0.1:49152 where none is given), from port where one is given."""

    def __init__(
        self,
        *,
        port: str | None = None,
        connect: str | None = None,
        arm: Mapping[str, Any] | None = None,
        cycle_s: float | None = None,
        clock: Clock,
    ) -> None:
        if port is not None:
            raise UsageError("rsi's twin sends to its driver and needs no port", cure="Give --connect HOST:PORT")
        self._driver = host_port(connect or DRIVER)
        self._arm = twin_arm(arm)
        self._drive = twin_drive(self._arm, cycle_s or CYCLE_S)
        self._clock = clock
        self.controller: RsiController | None = None

    @property
    def address(self) -> str:
        """What opens its driver."""
        return f"rsi:{self._driver[1]}"

    @property
    def messages(self) -> list[str]:
        """Why it ended RSI or fell silent."""
        return [] if self.controller is None else self.controller.messages

    def __enter__(self) -> Self:
        self.controller = RsiController(self._driver, arm=self._arm, drive=self._drive, home=twin_home(self._arm))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.controller is not None:
            self.controller.close()

    def run(self, on: Callable[[], bool]) -> None:
        """Work in real time as long as on() holds."""
        next_s = self._clock.now_s()
        while on() and self.controller is not None:
            self.controller.cycle()
            next_s = max(next_s + self._drive.cycle_s, self._clock.now_s())
            self._clock.sleep_until(next_s)
            note_silence(self.messages, self._clock.now_s() - next_s)


def _attributes(text: str, tag: str, names: str) -> Array | None:
    """Return the numbers of one element; None where it is not there."""
    found = re.findall(rf"<{tag}\b([^>]*)/>", text)
    if not found:
        return None
    values = dict(re.findall(rf'\b([A-Z]\d?)="({NUMBER})"', found[-1]))
    row = np.array([float(values[name]) for name in names.split()])
    if not np.isfinite(row).all() or np.abs(row).max() > 1e5:
        raise ValueError("a correction cannot be")
    return row


def _corrected(start: Array, pose: Array) -> Array:
    """Return the pose (4, 4) away from start by X Y Z in mm and A B C in degrees, in base axes."""
    goal = start.copy()
    goal[:3, 3] += pose[:3] / 1000.0
    goal[:3, :3] = _abc_matrix(np.deg2rad(pose[3:])) @ start[:3, :3]
    return goal


def _abc_matrix(abc: Array) -> Array:
    """Return Rz(A) Ry(B) Rx(C) (3, 3)."""
    (ca, cb, cc), (sa, sb, sc) = np.cos(abc), np.sin(abc)
    return np.array(
        [
            [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc],
            [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc],
            [-sb, cb * sc, cb * cc],
        ]
    )


def _xyzabc(pose: Array) -> Array:
    """Return X Y Z in mm and A B C in degrees of a pose (4, 4)."""
    R = pose[:3, :3]
    b = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    a, c = math.atan2(R[1, 0], R[0, 0]), math.atan2(R[2, 1], R[2, 2])
    return np.concatenate([1000.0 * pose[:3, 3], np.rad2deg([a, b, c])])
