"""An emulated controller with real-time path control over a serial line, which is a pseudo terminal here.

Each cycle it sends its state and takes the answer that names the state's number. The line's speed is kept: a state is
there when its last byte would have come, and an answer counts only where its last byte would be there within the cycle.
"""

from __future__ import annotations

import contextlib
import os
import tty
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.clock import Clock
from armsight.errors import Inconsistent, UsageError
from armsight_sim.arms import Drive, Servo, SimArm
from armsight_sim.twins.base import RIGHT, SerialTwin, Wrong, note_silence, twin_arm, twin_drive, twin_home

CYCLE_S = 0.028
BYTE_S = 10 / 38400
STATE_BYTES, ANSWER_BYTES = 48, 26

LATE_LIMIT = 10
"""Answers late in a row after which path control ends."""

PAUSE_CYCLES = 10
"""So long the program takes to start path control again."""

LONGEST = (0.05, 0.2)
"""Longest way in m and turn in rad within one cycle that the controller takes."""


class AlterFault(StrEnum):
    """What can be made to go wrong."""

    SILENT = "silent"
    FROZEN = "frozen"
    """The same frame goes out again and again."""


@dataclass(slots=True)
class AlterTwinCounts:
    """Answers taken, refused, with a wrong number; cycles without an answer; how often path control ended."""

    taken: int = 0
    refused: int = 0
    mismatched: int = 0
    late: int = 0
    ended: int = 0


class AlterController:
    """One controller on a pseudo terminal; each cycle is `hear`, `move` and `speak`."""

    def __init__(
        self, *, arm: SimArm, drive: Drive, home: ArrayLike, cumulative: bool = True, tool: bool = False
    ) -> None:
        if arm.n != 6:
            raise UsageError(f"real-time path control is for six axes, the arm has {arm.n}", cure="Take another arm")
        self.arm = arm
        self.counts = AlterTwinCounts()
        self.messages: list[str] = []
        self._drive = drive
        self._modes = cumulative | tool << 1
        self.wrong: Wrong = RIGHT
        self._servo = Servo(drive, home, keep=1000)
        self._faults: set[AlterFault] = set()
        self._cycles = 0
        self._number = self._taken = 0
        self._data = b""
        self._frame = b""
        self._late_row = self._pause = 0
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._begin()

    @property
    def q(self) -> Array:
        """Where the joints are, (6,) in rad."""
        return np.asarray(self._servo.at(self._servo.t_s)[0])

    @property
    def commanded(self) -> Array:
        """The flange's pose (4, 4) in base that the motors are told to go to."""
        return np.asarray(self._pose)

    @property
    def link(self) -> int:
        """The line's own end, to wait for an answer or to put anything on it."""
        return self._master

    def close(self) -> None:
        """Take the line away."""
        for end in (self._master, self._slave):
            with contextlib.suppress(OSError):
                os.close(end)

    def fault(self, fault: AlterFault | str, *, on: bool = True) -> None:
        """Make something go wrong, or right again."""
        (self._faults.add if on else self._faults.discard)(AlterFault(fault))

    def reboot(self) -> None:
        """Start anew: the numbering begins at zero, and the arm stays where it is."""
        self._number = 0
        self._begin()

    def push(self, by: ArrayLike) -> None:
        """Move the arm by (6,) in rad without path control, and start that there."""
        self._servo = Servo(self._drive, self.q + np.asarray(by, dtype=float), self._servo.t_s, keep=1000)
        self._begin()

    def cycle(self) -> None:
        """Do all of a cycle at once."""
        self.hear()
        self.move()
        self.speak()

    def hear(self) -> None:
        """Take what has come; the arm is told to go there when the cycle ends."""
        answered = False
        with contextlib.suppress(OSError):
            while piece := os.read(self._master, 4096):
                self._data += piece
        while (start := self._data.find(b"\x5a\x43")) >= 0 and len(self._data) - start >= ANSWER_BYTES:
            frame, good = self._data[start : start + ANSWER_BYTES], False
            if _crc(frame[1:-2]) == frame[-2] + 256 * frame[-1]:
                good = True
                answered = self._take(frame) or answered
            else:
                self.counts.refused += 1
            self._data = self._data[start + (ANSWER_BYTES if good else 1) :]
        self._data = self._data[-ANSWER_BYTES:]
        self._note(answered)

    def move(self) -> None:
        """Let the motors run for one cycle, and write the state down."""
        self._cycles += 1
        self._servo.advance(self._cycles * self._drive.cycle_s)
        if self._pause:
            self._pause -= 1
            if not self._pause:
                self._begin()
        if AlterFault.FROZEN not in self._faults or not self._frame:
            self._number = (self._number + 1) % 65536
            self._frame = self._state()

    def speak(self) -> None:
        """Send the state."""
        if AlterFault.SILENT not in self._faults:
            with contextlib.suppress(OSError):  # nobody reads, and the line is full
                os.write(self._master, self._frame)
                self._asked = True

    def _begin(self) -> None:
        """Start path control where the arm stands."""
        self._servo.halt()
        self._home = self._reached = self._servo.goal
        self._start = self._pose = self.arm.frames(self._home)[-1]
        self._connected = self._asked = False
        self._late_row = 0

    def _note(self, answered: bool) -> None:
        """Count a late answer; end path control after too many in a row."""
        if answered:
            self._connected, self._late_row = True, 0
        elif self._asked and self._connected and not self._pause:
            self.counts.late += 1
            self._late_row += 1
            if self._late_row >= LATE_LIMIT:
                self.counts.ended += 1
                self.messages.append(f"path control ended and begins anew: {LATE_LIMIT} answers in a row were late")
                self._servo.halt()
                self._pause = PAUSE_CYCLES

    def _take(self, frame: bytes) -> bool:
        """Take one answer; tell whether it was one to this cycle."""
        number, flags = frame[3] + 256 * frame[4], frame[5]
        if number != self._number:
            self.counts.mismatched += 1
            return False
        if frame[2] != ANSWER_BYTES - 5 or (flags & 3) != self._modes or self._pause:
            self.counts.refused += 1
            return False
        values = 1e-6 * np.array([_signed(frame[i : i + 3]) for i in range(6, 24, 3)])
        try:
            pose, q = self._goal(values[:3], values[3:])
        except Inconsistent:
            self.counts.refused += 1
            return False
        self.counts.taken += 1
        self._taken = number
        self._pose = pose
        self._servo.command(self._servo.t_s, q)
        return True

    def _goal(self, way: Array, turn: Array) -> tuple[Array, Array]:
        """Return the pose (4, 4) and the joints (6,) that an answer asks for. Raises Inconsistent where it cannot."""
        way, turn = np.split(self.wrong.of(np.concatenate([way, turn])), 2)
        start = self._pose if bool(self._modes & 1) is not self.wrong.adds else self._start
        R = Rotation.from_rotvec(turn).as_matrix()
        pose = start.copy()
        if self._modes & 2:
            pose[:3, 3] += start[:3, :3] @ way
            pose[:3, :3] = start[:3, :3] @ R
        else:
            pose[:3, 3] += way
            pose[:3, :3] = R @ start[:3, :3]
        far = np.linalg.norm(pose[:3, 3] - self._pose[:3, 3])
        wide = np.linalg.norm(Rotation.from_matrix(pose[:3, :3] @ self._pose[:3, :3].T).as_rotvec())
        if far > LONGEST[0] or wide > LONGEST[1]:
            raise Inconsistent("an answer asks for more than a cycle's way")
        q = self.arm.reach(pose, self._reached)
        self._reached = q
        if any(not joint.lower <= value <= joint.upper for joint, value in zip(self.arm.joints, q, strict=True)):
            raise Inconsistent("an answer asks for joints beyond their range")
        return pose, self.wrong.joints(q, self._home)

    def _state(self) -> bytes:
        """Return the frame of the controller's state."""
        corrected = not self._modes & 1 and not np.array_equal(self._pose, self._start)
        flags = self._modes | (0 if self._pause else 4) | corrected << 3
        numbers = b"".join(_low_high(value) for value in (self._taken, self.counts.late % 65536))
        turn = Rotation.from_matrix(self._pose[:3, :3]).as_rotvec()
        values = np.concatenate([self._servo.read(self._servo.t_s)[0], self._pose[:3, 3], turn])
        body = bytes([0x53, STATE_BYTES - 5]) + _low_high(self._number) + bytes([flags]) + numbers
        body += b"".join(_three_bytes(value) for value in values)
        return b"".join((b"\xa5", body, _low_high(_crc(body))))


class AlterTwin(SerialTwin[AlterController]):
    """`armsight twin alter`: a pseudo terminal, under the name in port where one is given."""

    kind = "alter"

    def __init__(
        self,
        *,
        port: str | None = None,
        connect: str | None = None,
        arm: Mapping[str, Any] | None = None,
        cycle_s: float | None = None,
        clock: Clock,
    ) -> None:
        if connect is not None:
            raise UsageError("alter's twin is a serial line and connects to nothing", cure="Leave --connect out")
        super().__init__(port)
        self._arm = twin_arm(arm)
        self._drive = twin_drive(self._arm, cycle_s or CYCLE_S)
        if self._drive.cycle_s <= (STATE_BYTES + ANSWER_BYTES) * BYTE_S:
            raise UsageError(
                f"a cycle of {self._drive.cycle_s} s is too short for the line", cure="Give 0.028, as controllers have"
            )
        self._clock = clock

    @property
    def messages(self) -> list[str]:
        """Why it ended path control or fell silent."""
        return [] if self.controller is None else self.controller.messages

    def _begin(self) -> AlterController:
        return AlterController(arm=self._arm, drive=self._drive, home=twin_home(self._arm))

    def run(self, on: Callable[[], bool]) -> None:
        """Work in real time as long as on() holds."""
        next_s = self._clock.now_s()
        while on() and self.controller is not None:
            next_s = max(next_s + self._drive.cycle_s, self._clock.now_s())
            self._clock.sleep_until(next_s - ANSWER_BYTES * BYTE_S)
            self.controller.hear()
            self._clock.sleep_until(next_s)
            self.controller.move()
            self._clock.sleep_until(next_s + STATE_BYTES * BYTE_S)
            self.controller.speak()
            note_silence(self.messages, self._clock.now_s() - next_s)


def _crc(data: bytes) -> int:
    """Return the CRC-16 of data, bit by bit: polynomial x^16 + x^12 + x^5 + 1, from all ones."""
    value = 0xFFFF
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1) ^ (0x11021 if value & 0x8000 else 0)
    return value


def _low_high(value: int) -> bytes:
    return bytes([value & 255, value >> 8])


def _three_bytes(value: float) -> bytes:
    """Return a number of micrometres or microradians, low byte first, of two's complement."""
    count = round(value * 1e6) & 0xFFFFFF
    return bytes([count & 255, count >> 8 & 255, count >> 16])


def _signed(data: bytes) -> int:
    count = data[0] | data[1] << 8 | data[2] << 16
    return count - (1 << 24) if count & 0x800000 else count
