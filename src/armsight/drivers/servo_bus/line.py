"""One question on the bus and its answers, each of which must be one to this question: of no other, whole, in turn."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

import serial

from armsight.drivers.pace import LinkCounts
from armsight.drivers.servo_bus.packets import BITS_A_BYTE, Answer, Packets
from armsight.errors import DeviceFailed, DeviceLost

T = TypeVar("T")

ANSWERS_S = 0.006
"""A servo answers within 0.5 ms and an adapter hands bytes on within 1 (5 where the machine is busy); what has not come
then is late, and an answer to none."""
OPENING_S = 0.03
"""... of a question while the link is opened: an adapter that nobody has set holds bytes back for 16 ms."""


def open_port(port: str, baud: int) -> serial.Serial:
    """Return a serial port, open for this program alone. Raises DeviceFailed."""
    try:
        line = serial.Serial(port, baud, timeout=0.0, write_timeout=0.1, exclusive=True)
    except (serial.SerialException, ValueError, OSError) as error:
        raise DeviceFailed(
            f"the serial port {port} cannot be opened: {error}",
            consequence="The robot is not opened: one program at a time may drive it",
            cure="Check its name and your rights to it, or stop the other program",
        ) from error
    with contextlib.suppress(Exception):  # not every adapter can; without it some hold bytes back for 16 ms
        line.set_low_latency_mode(True)
    return line


class Line:
    """An open serial port with servos on it. One thread asks at a time."""

    def __init__(self, line: serial.Serial, baud: int, packets: Packets) -> None:
        self.counts = LinkCounts()
        self._line, self._baud, self._packets = line, baud, packets

    def close(self) -> None:
        """Close the port; the servos go on as they are."""
        with contextlib.suppress(OSError, serial.SerialException):
            self._line.close()

    def at(self, baud: int) -> None:
        """Talk at another speed."""
        self._baud = baud
        self._line.baudrate = baud

    def tell(self, question: bytes) -> None:
        """Send what nobody answers. Raises DeviceLost where the port is gone."""
        self._guarded(lambda: self._line.write(question))

    def heard(self, question: bytes, ids: Sequence[int], size: int, wait_s: float = ANSWERS_S) -> dict[int, Answer]:
        """Return the answers to a question, by id: from as many servos as gave a sound one of so many data bytes.

        What came before is cleared. The line is read until all bytes are there or wait_s beyond their own time passes.
        An answer of another size is one to an earlier question. Where a servo answers twice or out of turn, one of its
        answers is old, and none counts. Raises DeviceLost where the port is gone.
        """
        line = self._guarded(lambda: self._ask(question, len(ids), size, wait_s))
        answers, foreign = self._packets.answers(line)
        self.counts.garbage_bytes += foreign
        good: dict[int, Answer] = {}
        turn = -1
        spoilt: set[int] = set()
        for answer in answers:
            if answer.id not in ids or len(answer.data) != size:
                self.counts.late += 1
                continue
            place = ids.index(answer.id)
            if place <= turn:
                self.counts.repeated += 1
                spoilt.update(ids[place : turn + 1])
            turn = max(turn, place)
            good[answer.id] = answer
        self.counts.missed += len(ids) - len(good)
        return {id: answer for id, answer in good.items() if id not in spoilt}

    def garbled(self, question: bytes, size: int) -> bool:
        """Tell whether something answers a question to one servo, and nothing sound: two servos at once, or noise."""
        line = self._guarded(lambda: self._ask(question, 1, size, OPENING_S))
        answers, foreign = self._packets.answers(line)
        return bool(foreign) or len(answers) > 1

    def _ask(self, question: bytes, n: int, size: int, wait_s: float) -> bytes:
        line, expected = self._line, n * (size + self._packets.extra)
        line.reset_input_buffer()
        line.write(question)
        end_s = time.monotonic() + wait_s + (len(question) + expected) * BITS_A_BYTE / self._baud
        got = b""
        while (rest_s := end_s - time.monotonic()) > 0.0:
            line.timeout = rest_s
            if not (piece := line.read(max(1, line.in_waiting))):
                break
            got += piece
            if len(got) >= expected and len(self._packets.answers(got)[0]) >= n:
                break
        return got

    def _guarded(self, act: Callable[[], T]) -> T:
        try:
            return act()
        except (serial.SerialException, OSError, TypeError) as error:
            raise DeviceLost("its serial port is gone") from error
