"""The packets of both buses: Feetech's (an 8-bit sum) and Dynamixel's protocol 2 (CRC-16, stuffed), as bytes.

Sources: Feetech, "Communication protocol manual" of the STS and SMS series; Robotis, "DYNAMIXEL Protocol 2.0".
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

PING, READ, WRITE, SYNC_READ, SYNC_WRITE, STATUS = 0x01, 0x02, 0x03, 0x82, 0x83, 0x55
EVERYBODY = 0xFE
HEAD_1, HEAD_2 = b"\xff\xff", b"\xff\xff\xfd\x00"
BITS_A_BYTE = 10
"""Start bit, eight bits, stop bit."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What one servo said: its id, its error byte, and what was asked for."""

    id: int
    error: int
    data: bytes


class Packets(ABC):
    """How questions are written and answers read. extra: bytes of an answer beside its data."""

    extra: ClassVar[int]
    number_size: ClassVar[int]
    """Bytes of a place in a servo's table, and of a size."""

    def ping(self, id: int) -> bytes:
        """Ask whether a servo is there."""
        return self._packet(id, bytes([PING]))

    def read(self, id: int, start: int, size: int) -> bytes:
        """Ask one servo for so many bytes of its table from start on."""
        return self._packet(id, bytes([READ]) + self._numbers(start, size))

    def write(self, id: int, start: int, data: bytes) -> bytes:
        """Tell one servo, which answers."""
        return self._packet(id, bytes([WRITE]) + self._numbers(start) + data)

    def sync_read(self, ids: Sequence[int], start: int, size: int) -> bytes:
        """Ask several servos, who answer in this order."""
        return self._packet(EVERYBODY, bytes([SYNC_READ]) + self._numbers(start, size) + bytes(ids))

    def sync_write(self, start: int, data: Mapping[int, bytes]) -> bytes:
        """Tell several servos, none of whom answers."""
        numbers = self._numbers(start, len(next(iter(data.values()))))
        rows = b"".join(bytes([id]) + value for id, value in data.items())
        return self._packet(EVERYBODY, bytes([SYNC_WRITE]) + numbers + rows)

    def answers(self, line: bytes) -> tuple[list[Answer], int]:
        """Return the whole, sound answers on a line, in their order, and how many bytes belong to none."""
        found, at, foreign = [], 0, 0
        while at < len(line):
            answer, size = self._answer(line, at)
            if answer is None:
                foreign += 1
            else:
                found.append(answer)
            at += size
        return found, foreign

    def _numbers(self, *values: int) -> bytes:
        return b"".join(value.to_bytes(self.number_size, "little") for value in values)

    @abstractmethod
    def _packet(self, id: int, body: bytes) -> bytes: ...

    @abstractmethod
    def _answer(self, line: bytes, at: int) -> tuple[Answer | None, int]:
        """Return the answer that begins at a place of a line and its size; None and 1 where none does."""


class StsPackets(Packets):
    """Feetech's: FF FF id length instruction-or-error data, and the inverted sum of all between."""

    extra, number_size = 6, 1

    def _packet(self, id: int, body: bytes) -> bytes:
        inner = bytes([id, len(body) + 1]) + body
        return HEAD_1 + inner + bytes([~sum(inner) & 0xFF])

    def _answer(self, line: bytes, at: int) -> tuple[Answer | None, int]:
        size = line[at + 3] + 4 if len(line) - at >= self.extra and line.startswith(HEAD_1, at) else 0
        body = line[at + 2 : at + size]
        if self.extra <= size <= len(line) - at and ~sum(body[:-1]) & 0xFF == body[-1]:
            return Answer(body[0], body[2], body[3:-1]), size
        return None, 1


class DynamixelPackets(Packets):
    """Protocol 2: FF FF FD 00 id length(2) instruction data crc(2); FF FF FD within is followed by one FD more."""

    extra, number_size = 11, 2

    def _packet(self, id: int, body: bytes) -> bytes:
        stuffed = body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        whole = HEAD_2 + bytes([id]) + self._numbers(len(stuffed) + 2) + stuffed
        return whole + self._numbers(crc16(whole))

    def _answer(self, line: bytes, at: int) -> tuple[Answer | None, int]:
        whole = len(line) - at >= self.extra and line.startswith(HEAD_2, at)
        size = int.from_bytes(line[at + 5 : at + 7], "little") + 7 if whole else 0
        packet = line[at : at + size]
        if not self.extra <= size <= len(line) - at or packet[7] != STATUS:
            return None, 1
        if crc16(packet[:-2]) != int.from_bytes(packet[-2:], "little"):
            return None, 1
        body = packet[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        return Answer(packet[4], body[0], body[1:]), size


def _table() -> tuple[int, ...]:
    """Return the 256 steps of the CRC-16 with polynomial 0x8005, highest bit first."""
    rows = []
    for byte in range(256):
        value = byte << 8
        for _ in range(8):
            value = (value << 1) ^ (0x18005 if value & 0x8000 else 0)
        rows.append(value)
    return tuple(rows)


_CRC = _table()


def crc16(data: bytes) -> int:
    """Return the CRC-16 of protocol 2: polynomial 0x8005, start 0, not reflected."""
    value = 0
    for byte in data:
        value = (value << 8 & 0xFFFF) ^ _CRC[value >> 8 ^ byte]
    return value
