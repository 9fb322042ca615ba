"""The frames on the serial line, byte by byte as docs/drivers/alter.md has them: micrometres and microradians."""

from __future__ import annotations

import binascii
import struct
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.defaults import ALTER_CYCLE_S, TOOL_SPEED_M_S, TOOL_SPEED_RAD_S
from armsight.drivers.link_settings import LinkSettings, Positive
from armsight.errors import Inconsistent

STATE_BYTES = 48
ANSWER_BYTES = 26
SEQUENCES = 1 << 16

STATE_START, STATE_KIND = 0xA5, 0x53
ANSWER_START, ANSWER_KIND = 0x5A, 0x43
STATE_HEAD = struct.Struct("<BBBHBHH")
ANSWER_HEAD = struct.Struct("<BBBHB")

CUMULATIVE, TOOL, ON, CORRECTED, HOLD = 1, 2, 4, 8, 4
"""Bits of the flags: of both frames; of both; of the state (path control is on; a way is in force); of the answer."""

MICRO = 1e-6
LARGEST = (1 << 23) - 1
"""Of a signed number of three bytes."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StateFrame:
    """The controller's state: number; last answer it took; late answers; joints and where it is told to be.

    q (6,) in rad or m as the encoders read; T_base_flange: the pose commanded at the beginning of this cycle.
    corrected: a way that is not cumulative is in force.
    """

    sequence: int
    taken: int
    n_late: int
    q: Array
    T_base_flange: RigidTransform
    cumulative: bool
    tool: bool
    on: bool
    corrected: bool


class FrameSplitter:
    """Finds state frames in what comes over the line; what is none is counted and left out."""

    def __init__(self) -> None:
        self._rest = b""
        self.garbage_bytes = 0

    def clear(self) -> bytes:
        """Forget what has come of a frame; return that nothing has."""
        self._rest = b""
        return self._rest

    def feed(self, data: bytes) -> list[StateFrame]:
        """Return the frames that data completes, in their order."""
        self._rest += data
        found: list[StateFrame] = []
        while True:
            start = self._rest.find(STATE_START)
            skipped = len(self._rest) if start < 0 else start
            self.garbage_bytes += skipped
            self._rest = self._rest[skipped:]
            if len(self._rest) < STATE_BYTES:
                return found
            try:
                found.append(parse_state(self._rest[:STATE_BYTES]))
                self._rest = self._rest[STATE_BYTES:]
            except Inconsistent:
                self.garbage_bytes += 1
                self._rest = self._rest[1:]


def parse_state(data: bytes) -> StateFrame:
    """Return the state in one frame of 48 bytes. Raises Inconsistent where it is none."""
    if len(data) != STATE_BYTES:
        raise Inconsistent("a frame has another length")
    start, kind, length, sequence, flags, taken, n_late = STATE_HEAD.unpack_from(data)
    if (start, kind, length) != (STATE_START, STATE_KIND, STATE_BYTES - 5):
        raise Inconsistent("a frame is no state")
    if checksum(data[1:-2]) != int.from_bytes(data[-2:], "little"):
        raise Inconsistent("a frame's checksum does not fit")
    values = [int.from_bytes(data[i : i + 3], "little", signed=True) * MICRO for i in range(STATE_HEAD.size, 46, 3)]
    pose = RigidTransform.from_components(np.array(values[6:9]), Rotation.from_rotvec(values[9:12]))
    return StateFrame(
        sequence=sequence,
        taken=taken,
        n_late=n_late,
        q=np.array(values[:6]),
        T_base_flange=pose,
        cumulative=bool(flags & CUMULATIVE),
        tool=bool(flags & TOOL),
        on=bool(flags & ON),
        corrected=bool(flags & CORRECTED),
    )


def answer(sequence: int, way_m: Array, turn_rad: Array, *, cumulative: bool, tool: bool, hold: bool) -> bytes:
    """Return the frame that answers the state of a number with a way (3,) and a turn (3,)."""
    counts = np.rint(np.concatenate([way_m, turn_rad]) / MICRO)
    if not (np.abs(counts) <= LARGEST).all():  # also where it is not a number
        raise Inconsistent("a way is too long for the line, or not finite", consequence="Nothing was sent")
    flags = CUMULATIVE * cumulative | TOOL * tool | HOLD * hold
    head = ANSWER_HEAD.pack(ANSWER_START, ANSWER_KIND, ANSWER_BYTES - 5, sequence, flags)
    body = head + b"".join(int(count).to_bytes(3, "little", signed=True) for count in counts)
    return body + checksum(body[1:]).to_bytes(2, "little")


def checksum(data: bytes) -> int:
    """Return the CRC-16 with polynomial 0x1021 and start 0xFFFF."""
    return binascii.crc_hqx(data, 0xFFFF)


BITS_A_BYTE = 10
"""Start bit, eight bits, stop bit."""


class AlterSettings(LinkSettings):
    """Settings of a link of real-time path control.

    baud, cycle_s: the controller's. cumulative: an answer's way adds to those before; otherwise it is the whole way
    from where path control began. axes: world or tool, those the way is told in. Without arm the robot takes poses
    alone. max_speed_rad_s, lower_rad, upper_rad: of each joint; speed_m_s, speed_rad_s: of
    the flange.
    """

    link: ClassVar[str] = "the serial link"

    baud: Annotated[int, Field(ge=1200)] = 38400
    cycle_s: Positive = ALTER_CYCLE_S
    cumulative: bool = True
    axes: Literal["world", "tool"] = "world"
    lower_rad: Annotated[list[float], Field(min_length=6, max_length=6)] | None = None
    upper_rad: Annotated[list[float], Field(min_length=6, max_length=6)] | None = None
    speed_m_s: Positive = TOOL_SPEED_M_S
    speed_rad_s: Positive = TOOL_SPEED_RAD_S

    @model_validator(mode="after")
    def _fits(self) -> AlterSettings:
        needed_s = (STATE_BYTES + ANSWER_BYTES) * BITS_A_BYTE / self.baud
        if needed_s >= self.cycle_s:
            raise ValueError(f"a state and its answer take {needed_s:.4f} s at {self.baud} baud, longer than a cycle")
        return self
