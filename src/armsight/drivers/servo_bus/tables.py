"""What the two families of servos keep where: control tables, alarms, models.

Sources: Feetech's memory table of the STS series; Robotis' e-Manual of the X series; the models' numbers as LeRobot's
tables have them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from armsight.drivers.servo_bus.packets import DynamixelPackets, Packets, StsPackets
from armsight.units import DEG

STEPS = 4096
"""Of a turn: both families' encoders have 12 bits."""
STEP_RAD = 360.0 / STEPS * DEG


@dataclass(frozen=True, slots=True)
class Field:
    """A number in a servo's table: where, of how many bytes. sign: its bit where not two's complement; None: none."""

    at: int
    size: int
    signed: bool = False
    sign_bit: int | None = None

    def of(self, data: bytes, start: int) -> int:
        """Return its value in a part of the table that begins at start."""
        value = int.from_bytes(data[self.at - start : self.at - start + self.size], "little", signed=self.signed)
        if self.sign_bit is None:
            return value
        size = value & ~(1 << self.sign_bit)
        return -size if value >> self.sign_bit & 1 else size

    def bytes(self, value: int) -> bytes:
        """Return a value as it is written."""
        if self.sign_bit is not None and value < 0:
            value = -value | 1 << self.sign_bit
        return value.to_bytes(self.size, "little", signed=self.signed)


@dataclass(frozen=True, slots=True, kw_only=True)
class Family:
    """One family. state: start and size of what is read each cycle; fixed: ... when it is opened; watched: where torque
    and alarms stand, where those are no part of the state. tick: a counter of the servo's own milliseconds. alarms: by
    bit of the alarm field. reversed_by_file: whether a calibration file's drive_mode is not applied by the servo.
    told: what an error byte says, in words.
    """

    called: str
    packets: Packets
    models: Mapping[int, str]
    bauds: tuple[int, ...]
    fixed: tuple[int, int]
    state: tuple[int, int]
    model: Field
    mode: Field
    lowest: Field
    highest: Field
    offset: Field
    least_volts: Field
    most_heat: Field
    torque: Field
    goal: Field
    position: Field
    voltage: Field
    heat: Field
    alarm: Field
    tick: Field | None
    watched: tuple[int, int] | None
    modes: Mapping[int, str]
    right_modes: tuple[int, ...]
    alarms: Mapping[int, str]
    reversed_by_file: bool
    told: Callable[[int], str]


STS_ALARMS = {0: "voltage", 1: "encoder", 2: "overheating", 3: "overcurrent", 5: "overload"}
X_ALARMS = {0: "voltage", 2: "overheating", 3: "encoder", 4: "electrical shock", 5: "overload"}
X_ERRORS = {1: "result", 2: "instruction", 3: "crc", 4: "range", 5: "length", 6: "limit", 7: "access"}
ALERT = 0x80
"""Bit of a Dynamixel's error byte: an alarm stands in its hardware error status."""


def _sts_told(error: int) -> str:
    return " and ".join(text for bit, text in STS_ALARMS.items() if error >> bit & 1)


def _x_told(error: int) -> str:
    """An alert is read from the alarm field; the number says what was wrong with the question."""
    return f"error {error & ~ALERT} ({X_ERRORS.get(error & ~ALERT, 'unknown')})" if error & ~ALERT else ""


STS = Family(
    called="feetech",
    packets=StsPackets(),
    models={777: "STS3215", 2825: "STS3250"},
    bauds=(1_000_000, 500_000, 250_000, 128_000, 115_200, 57_600, 38_400, 19_200),
    fixed=(3, 36),
    state=(40, 26),
    model=Field(3, 2),
    mode=Field(33, 1),
    lowest=Field(9, 2),
    highest=Field(11, 2),
    offset=Field(31, 2, sign_bit=11),
    least_volts=Field(15, 1),
    most_heat=Field(13, 1),
    torque=Field(40, 1),
    goal=Field(42, 2, sign_bit=15),
    position=Field(56, 2, sign_bit=15),
    voltage=Field(62, 1),
    heat=Field(63, 1),
    alarm=Field(65, 1),
    tick=None,
    watched=None,
    modes={0: "position", 1: "speed", 2: "PWM", 3: "step, a relative mode"},
    right_modes=(0,),
    alarms=STS_ALARMS,
    reversed_by_file=True,
    told=_sts_told,
)
"""A step of the STS's voltages is 0.1 V. Its state holds torque, acceleration, goal, lock, position, voltage, heat and
alarms: one answer tells all that is checked."""

X = Family(
    called="dynamixel",
    packets=DynamixelPackets(),
    models={
        1190: "XL330-M077",
        1200: "XL330-M288",
        1060: "XL430-W250",
        1020: "XM430-W350",
        1120: "XM540-W270",
        1070: "XC430-W150",
    },
    bauds=(57_600, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 115_200, 9_600),
    fixed=(0, 56),
    state=(116, 31),
    model=Field(0, 2),
    mode=Field(11, 1),
    lowest=Field(52, 4),
    highest=Field(48, 4),
    offset=Field(20, 4, signed=True),
    least_volts=Field(34, 2),
    most_heat=Field(31, 1),
    torque=Field(64, 1),
    goal=Field(116, 4, signed=True),
    position=Field(132, 4, signed=True),
    voltage=Field(144, 2),
    heat=Field(146, 1),
    alarm=Field(70, 1),
    tick=Field(120, 2),
    watched=(64, 7),
    modes={0: "current", 1: "speed", 3: "position", 4: "extended position", 5: "current-based position", 16: "PWM"},
    right_modes=(3, 4),
    alarms=X_ALARMS,
    reversed_by_file=False,
    told=_x_told,
)
"""Torque and alarms stand far from goal and position: they are read from one servo in each cycle, in turn. The servo
itself applies the direction of its drive mode, so that a calibration file's is not applied again."""

TICKS = 32768
"""A Dynamixel's counter of milliseconds begins anew here."""
