"""Emulated buses of Feetech's and of Robotis' servos, and what runs them: `armsight twin feetech` or `dynamixel`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any, ClassVar

from armsight.clock import Clock
from armsight.errors import UsageError
from armsight_sim.arms import Drive, SimArm
from armsight_sim.twins.base import SerialTwin, twin_arm, twin_drive, twin_home
from armsight_sim.twins.servo_bus import OneServo, ServoBus

CYCLE_S = 0.005
"""Of the motors' own control."""
POLL_S = 0.05

STS3215 = (
    "0:1:3 1:1:10 3:2:777 7:1:0 9:2:0 11:2:4095 13:1:70 14:1:80 15:1:40 16:2:1000 21:1:16 22:1:32 "
    "41:1:254 48:2:1000 55:1:1 62:1:74 63:1:31 "
)
XL430 = (
    "0:2:1060 6:1:45 8:1:3 9:1:0 11:1:3 13:1:2 31:1:72 32:2:160 34:2:60 48:4:4095 52:4:0 63:1:52 68:1:2 "
    "144:2:118 146:1:33 "
)
"""Tables as they leave their makers: at:size:value."""


class FeetechBus(ServoBus):
    """STS3215, as Feetech's memory table has it; numbers below zero have a sign bit."""

    kind, torque_at = "feetech", 40

    def _factory(self, servo: OneServo) -> None:
        servo.put(5, 1, servo.id)
        servo.fill(STS3215)

    def _next_question(self) -> tuple[int, int, bytes] | None:
        while True:
            start = self._data.find(b"\xff\xff")
            if start < 0 or len(self._data) < start + 4:
                return None
            size = self._data[start + 3] + 4
            packet = self._data[start : start + size]
            if len(packet) < size:
                return None
            self._data = self._data[start + size :]
            if (sum(packet[2:]) & 255) == 255:
                return packet[2], packet[4], packet[5:-1]

    def _status(self, servo: OneServo, data: bytes) -> bytes:
        inner = [servo.id, len(data) + 2, servo.error, *data]
        return bytes([255, 255, *inner, 255 - sum(inner) % 256])

    def _pinged(self, servo: OneServo) -> bytes:
        return b""

    def _span(self, body: bytes) -> tuple[int, int]:
        return body[0], body[1]

    def _written(self, body: bytes) -> tuple[int, bytes]:
        return body[0], body[1:]

    def _spread(self, body: bytes) -> tuple[int, int, bytes]:
        return body[0], body[1], body[2:]

    def _goal(self, servo: OneServo) -> int:
        return _from_sign_bit(servo.get(42, 2))

    def _tell_goal(self, servo: OneServo, steps: int) -> None:
        servo.put(42, 2, _sign_bit(steps))

    def _tell_position(self, servo: OneServo, steps: int) -> None:
        servo.put(56, 2, _sign_bit(steps))
        servo.put(65, 1, servo.error)


class DynamixelBus(ServoBus):
    """XL430-W250, as Robotis' control table has it; numbers below zero are two's complement, packets are stuffed."""

    kind, torque_at = "dynamixel", 64

    def _factory(self, servo: OneServo) -> None:
        servo.put(7, 1, servo.id)
        servo.fill(XL430)

    def _next_question(self) -> tuple[int, int, bytes] | None:
        while True:
            start = self._data.find(b"\xff\xff\xfd\x00")
            if start < 0 or len(self._data) < start + 7:
                return None
            size = self._data[start + 5] + 256 * self._data[start + 6] + 7
            packet = self._data[start : start + size]
            if len(packet) < size:
                return None
            self._data = self._data[start + size :]
            if _remainder(packet[:-2]) == packet[-2] + 256 * packet[-1]:
                return packet[4], packet[7], packet[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")

    def _status(self, servo: OneServo, data: bytes) -> bytes:
        body = bytes([0x55, servo.error]) + data
        body = body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        n = len(body) + 2
        packet = bytes([255, 255, 253, 0, servo.id, n & 255, n >> 8]) + body
        return packet + bytes(divmod(_remainder(packet), 256)[::-1])

    def _pinged(self, servo: OneServo) -> bytes:
        return bytes(servo.table[0:2]) + bytes([servo.table[6]])

    def _span(self, body: bytes) -> tuple[int, int]:
        return body[0] + 256 * body[1], body[2] + 256 * body[3]

    def _written(self, body: bytes) -> tuple[int, bytes]:
        return body[0] + 256 * body[1], body[2:]

    def _spread(self, body: bytes) -> tuple[int, int, bytes]:
        return body[0] + 256 * body[1], body[2] + 256 * body[3], body[4:]

    def _goal(self, servo: OneServo) -> int:
        return _from_complement(servo.get(116, 4))

    def _tell_goal(self, servo: OneServo, steps: int) -> None:
        servo.put(116, 4, steps)

    def _tell_position(self, servo: OneServo, steps: int) -> None:
        servo.put(132, 4, steps)
        servo.put(120, 2, int(self._clock.now_s() * 1000.0) % 32768)
        servo.put(126, 2, -1)  # a current of -1 before a speed of -3: the bytes that are stuffed
        servo.put(128, 4, -3)

    def restart(self, servo: OneServo) -> None:
        """As ServoBus says."""
        super().restart(servo)
        self._tell_goal(servo, 0)


def _sign_bit(value: int) -> int:
    return value if value >= 0 else 0x8000 - value


def _from_sign_bit(value: int) -> int:
    return value if value < 0x8000 else 0x8000 - value


def _from_complement(value: int) -> int:
    return value if value < 1 << 31 else value - (1 << 32)


def _remainder(data: bytes) -> int:
    """Return the remainder of data, times x^16, by x^16 + x^15 + x^2 + 1, bit by bit."""
    value = 0
    for byte in data:
        for bit in range(7, -1, -1):
            carry = (value >> 15 ^ byte >> bit) & 1
            value = (value << 1 & 0xFFFF) ^ (0x8005 if carry else 0)
    return value


class BusTwin(SerialTwin[ServoBus]):
    """`armsight twin feetech` or `dynamixel`: a pseudo terminal, under the name in port where one is given."""

    bus: ClassVar[type[ServoBus]]

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
            raise UsageError("a bus of servos is a serial line and connects to nothing", cure="Leave --connect out")
        if cycle_s is not None:
            raise UsageError("a bus of servos has no cycle: it answers when it is asked", cure="Leave --cycle out")
        super().__init__(port)
        self.kind = self.bus.kind
        self._arm, self._clock = twin_arm(arm), clock

    @property
    def messages(self) -> list[str]:
        """Nothing: servos say nothing by themselves."""
        return []

    def _begin(self) -> ServoBus:
        arm = self._arm
        weighed = find_spec("mujoco") is not None
        return self.bus(
            arm=arm,
            drive=bus_drive(arm),
            home=twin_home(arm),
            clock=self._clock,
            sag=0.0 if weighed else SAG_RAD,
            weighed=weighed,
        )

    def run(self, on: Callable[[], bool]) -> None:
        """Answer as long as on() holds."""
        while on() and self.controller is not None:
            self.controller.serve(POLL_S)


SAG_RAD = 0.01
"""A servo with the gain that LeRobot sets hangs by half a degree under an arm's weight; without MuJoCo each does."""


def bus_drive(arm: SimArm) -> Drive:
    """Return the motors of servos."""
    return twin_drive(arm, CYCLE_S, lag_s=0.03)


class FeetechTwin(BusTwin):
    """`armsight twin feetech`."""

    bus = FeetechBus


class DynamixelTwin(BusTwin):
    """`armsight twin dynamixel`."""

    bus = DynamixelBus
