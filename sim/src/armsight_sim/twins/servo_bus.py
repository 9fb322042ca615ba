"""Emulated buses of servos on a pseudo terminal: Feetech's STS and Robotis' X, with their tables, motors and faults.

A bus speaks only when it is asked. Its motors hang a little below their goals and turn in steps of 12 bits.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import termios
import tty
from collections import deque
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import zip_longest
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from armsight.arrays import Array
from armsight.clock import Clock
from armsight_sim.arms import Drive, Servo, SimArm

TURN = 4096
MIDDLE = 2048
KEEP = 4000
"""Steps of the past that motors remember."""
SPEEDS = {termios.B1000000: 1_000_000, termios.B500000: 500_000, termios.B57600: 57_600, termios.B115200: 115_200}


class BusFault(StrEnum):
    """What can be made to go wrong; those from LOST on are planted, each in one question to all."""

    SILENT = "silent"
    """No servo answers."""
    LOST = "lost"
    LATE = "late"
    """An answer comes while a later question is answered."""
    SWAPPED = "swapped"
    """Two answers come in each other's place."""
    BROKEN = "broken"
    DOUBLED = "doubled"


@dataclass(slots=True)
class OneServo:
    """One servo's table of 256 bytes, and whether it hears and answers."""

    id: int
    table: bytearray = field(default_factory=lambda: bytearray(256))
    there: bool = True
    error: int = 0

    def put(self, at: int, size: int, value: int) -> None:
        """Write a number, low byte first."""
        self.table[at : at + size] = (value & (1 << 8 * size) - 1).to_bytes(size, "little")

    def fill(self, words: str) -> None:
        """Write numbers that are told as at:size:value."""
        for word in words.split():
            at, size, value = map(int, word.split(":"))
            self.put(at, size, value)

    def get(self, at: int, size: int) -> int:
        """Read a number."""
        return int.from_bytes(self.table[at : at + size], "little")


class ServoBus:
    """Servos behind one end of a pseudo terminal; `serve` answers what has been asked."""

    kind: ClassVar[str]
    torque_at: ClassVar[int]

    def __init__(
        self,
        *,
        arm: SimArm,
        drive: Drive,
        home: ArrayLike,
        clock: Clock,
        baud: int = 1_000_000,
        sag: float = 0.0,
        weighed: bool = False,
    ) -> None:
        """sag: how far each joint hangs below its goal, rad. weighed: MuJoCo moves the motors under the arm's weight,
        from a start where they hold it; else they go to their goals less the sag."""
        self.arm, self.baud = arm, baud
        self.servos = [OneServo(i + 1) for i in range(arm.n)]
        self.messages: list[str] = []
        self.wrong_answers = 0
        self.told: list[tuple[int, ...]] = []
        self._twins: list[OneServo] = []
        self._clock, self._drive, self._sag, self._weighed = clock, drive, sag, weighed
        self._faults: set[BusFault] = set()
        self._planted: deque[tuple[BusFault, int, np.random.Generator]] = deque()
        self._late: list[tuple[int, bytes]] = []
        self._motors = self._motors_at(home, clock.now_s())
        self._data = b""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        attributes = termios.tcgetattr(self._slave)
        attributes[4] = attributes[5] = termios.B1000000
        termios.tcsetattr(self._slave, termios.TCSANOW, attributes)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        for servo, q in zip(self.servos, self.q, strict=True):
            self._factory(servo)
            self._tell_goal(servo, self._step(q))
            servo.table[self.torque_at] = weighed

    @property
    def q(self) -> Array:
        """Where the joints are, (n,) in rad."""
        self._motors.advance(self._clock.now_s())
        return np.asarray(self._motors.at(self._motors.t_s)[0])

    def close(self) -> None:
        """Take the line away."""
        for end in (self._master, self._slave):
            with contextlib.suppress(OSError):
                os.close(end)

    def fault(self, fault: BusFault | str, *, on: bool = True) -> None:
        """Make something go wrong, or right again."""
        (self._faults.add if on else self._faults.discard)(BusFault(fault))

    def plant(self, fault: BusFault, place: int, rng: np.random.Generator) -> None:
        """Spoil one answer, of the servo at a place, to the next question to all."""
        self._planted.append((fault, place, rng))

    def push(self, by: ArrayLike) -> None:
        """Move the arm by (n,) in rad as a hand does, and let it be held there where it is held."""
        q = self.q + np.asarray(by, dtype=float)
        self._motors = self._motors_at(q, self._motors.t_s)
        for servo, value in zip(self.servos, q, strict=True):
            self._tell_goal(servo, self._step(value))

    def _motors_at(self, q: ArrayLike, t_s: float) -> Servo:
        if not self._weighed:
            return Servo(self._drive, q, t_s, keep=KEEP)
        from armsight_sim.twins.servo_physics import WeighedServo

        return WeighedServo(self.arm, self._drive, q, t_s, keep=KEEP)

    def restart(self, servo: OneServo) -> None:
        """Take a servo's supply away for a moment: its torque is off then, and its own clock begins anew."""
        servo.table[self.torque_at] = 0
        self._hold()

    def double(self, id: int) -> None:
        """Let another servo of the same id hang on the line, at another place."""
        other = OneServo(id)
        self._factory(other)
        self._twins.append(other)

    def serve(self, wait_s: float = 0.0) -> None:
        """Answer what has been asked, or comes within wait_s; the motors run on meanwhile, asked or not."""
        self._motors.advance(self._clock.now_s())
        if not select.select([self._master], [], [], wait_s)[0]:
            return
        data = b""
        with contextlib.suppress(OSError):
            while piece := os.read(self._master, 4096):
                data += piece
        self.feed(data)

    def feed(self, data: bytes) -> None:
        """Take what has come over the line, and answer the whole questions in it."""
        self._data += data
        while (question := self._next_question()) is not None:
            self._hear(*question)

    def _speed(self) -> int:
        return SPEEDS.get(termios.tcgetattr(self._slave)[5], 0)

    def _hear(self, id: int, instruction: int, body: bytes) -> None:
        """Do what a packet says; who is asked at another speed hears nothing."""
        if self._speed() != self.baud or BusFault.SILENT in self._faults:
            return
        self._read_motors()
        if instruction == 0x83:
            self._write_all(body)
        elif instruction == 0x82:
            self._say(self._read_all(body))
        else:
            self._one(id, instruction, body)

    def _one(self, id: int, instruction: int, body: bytes) -> None:
        said = []
        for servo in [*self.servos, *self._twins]:
            if servo.id != id or not servo.there:
                continue
            if instruction == 1:
                said.append(self._status(servo, self._pinged(servo)))
            elif instruction == 2:
                at, size = self._span(body)
                said.append(self._status(servo, bytes(servo.table[at : at + size])))
            elif instruction == 3:
                self._write(servo, *self._written(body))
                said.append(self._status(servo, b""))
        if said:
            # two servos pull the line low at once: who is low wins
            line = bytes(a & b for a, b in zip_longest(said[0], said[-1], fillvalue=255))
            self._send(line)

    def _say(self, answers: list[tuple[OneServo, bytes]]) -> None:
        """Send the answers of all, spoilt as planted; late ones come before those."""
        out = [line for _, line in answers]
        due = [line for left, line in self._late if left <= 0]
        self._late = [(left - 1, line) for left, line in self._late if left > 0]
        for fault, place, rng in [self._planted.popleft() for _ in range(len(self._planted))]:
            self.wrong_answers += 1
            line = out[place]
            if fault is BusFault.LOST:
                out[place] = b""
            elif fault is BusFault.LATE:
                out[place] = b""
                self._late.append((int(rng.integers(0, 3)), line))
            elif fault is BusFault.DOUBLED:
                out[place] = line + line
            elif fault is BusFault.SWAPPED:
                other = (place + 1) % len(out)
                out[place], out[other] = out[other], out[place]
            elif fault is BusFault.BROKEN:
                out[place] = _broken(line, rng)
        if due:  # among the others, as a slow adapter does
            at = int(self._rng_place(len(out)))
            out[at:at] = due
        self._send(b"".join(out))

    def _rng_place(self, n: int) -> int:
        return self.wrong_answers % (n + 1)

    def _send(self, line: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._master, line)

    def _read_motors(self) -> None:
        """Bring what the motors did into the tables."""
        for servo, q in zip(self.servos, self.q, strict=True):
            self._tell_position(servo, self._step(q))

    def _write_all(self, body: bytes) -> None:
        at, size, rest = self._spread(body)
        for i in range(0, len(rest), 1 + size):
            for servo in self.servos:
                if servo.id == rest[i] and servo.there:
                    self._write(servo, at, rest[i + 1 : i + 1 + size])

    def _read_all(self, body: bytes) -> list[tuple[OneServo, bytes]]:
        at, size, ids = self._spread(body)
        asked = [servo for id in ids for servo in self.servos if servo.id == id and servo.there]
        return [(servo, self._status(servo, bytes(servo.table[at : at + size]))) for servo in asked]

    def _write(self, servo: OneServo, at: int, data: bytes) -> None:
        """Take what is written, and let the motors go where their goals are."""
        servo.table[at : at + len(data)] = data
        goals, now = self._motors.goal, self.q
        for i, one in enumerate(self.servos):
            if one.table[self.torque_at]:
                goals[i] = (self._goal(one) - MIDDLE) * math.tau / TURN - self._sag
            elif one is servo:
                goals[i] = now[i]
        if servo is self.servos[-1] or at == self.torque_at:
            self.told.append(tuple(self._goal(one) for one in self.servos))
        self._hold()
        self._motors.command(self._motors.t_s, goals)

    def _hold(self) -> None:
        self._motors.hold([bool(one.table[self.torque_at]) for one in self.servos])

    def _step(self, q: float) -> int:
        return MIDDLE + round(q * TURN / math.tau)

    def _factory(self, servo: OneServo) -> None:
        """Fill a table as the maker does, and as who built the arm set it."""
        raise NotImplementedError

    def _next_question(self) -> tuple[int, int, bytes] | None:
        """Take the next sound packet off the line: id, instruction, body."""
        raise NotImplementedError

    def _status(self, servo: OneServo, data: bytes) -> bytes:
        """Return a servo's packet that holds data."""
        raise NotImplementedError

    def _pinged(self, servo: OneServo) -> bytes:
        """Return what a servo says to a ping."""
        raise NotImplementedError

    def _span(self, body: bytes) -> tuple[int, int]:
        """Return what is to be read: from where, how much."""
        raise NotImplementedError

    def _written(self, body: bytes) -> tuple[int, bytes]:
        """Return what is to be written: where, what."""
        raise NotImplementedError

    def _spread(self, body: bytes) -> tuple[int, int, bytes]:
        """Return what a packet to all is about: from where, how much each, and the rest."""
        raise NotImplementedError

    def _goal(self, servo: OneServo) -> int:
        raise NotImplementedError

    def _tell_goal(self, servo: OneServo, steps: int) -> None:
        raise NotImplementedError

    def _tell_position(self, servo: OneServo, steps: int) -> None:
        raise NotImplementedError


def _broken(line: bytes, rng: np.random.Generator) -> bytes:
    """Return a packet with one to four bytes changed, or with its end cut off."""
    if rng.random() < 0.2:
        return line[: int(rng.integers(1, len(line)))]
    made, n = bytearray(line), int(rng.integers(1, 5))
    for at in rng.choice(len(line), n, replace=False):
        made[at] ^= int(rng.integers(1, 256))
    return bytes(made)
