"""RTDE's frames and variables by hand: a twin shares no protocol code with the driver it tests.

Source: Universal Robots, "Real-Time Data Exchange (RTDE) Guide": a frame is its size (two bytes, big end first), a
letter, and what belongs to it.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from enum import IntEnum

LARGEST = 0xFFFF

FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
"""struct's letters by RTDE's names of types."""


class Kind(IntEnum):
    """What a frame is."""

    PROTOCOL = ord("V")
    VERSION = ord("v")
    TEXT = ord("M")
    DATA = ord("U")
    OUTPUTS = ord("O")
    INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


class BadFrame(ValueError):
    """Bytes that are no frame, or a frame that says something impossible."""


class Recipe:
    """The variables of one kind of data frame, in their order."""

    def __init__(self, number: int, names: Sequence[str], types: Sequence[str]) -> None:
        self.number = number
        self.names = tuple(names)
        self.counts = [int(FORMATS[kind][0]) if kind.startswith("VECTOR") else 1 for kind in types]
        self._struct = struct.Struct(">" + "".join(FORMATS[kind] for kind in types))

    def pack(self, values: Sequence[float]) -> bytes:
        """Return the data frame of all numbers in one row."""
        return frame(Kind.DATA, bytes([self.number]) + self._struct.pack(*values))

    def unpack(self, data: bytes) -> list[list[float]]:
        """Return the numbers of each variable. Raises BadFrame for another size."""
        if len(data) != self._struct.size:
            raise BadFrame(f"{len(data)} bytes for a recipe of {self._struct.size}")
        numbers, out = list(self._struct.unpack(data)), []
        for count in self.counts:
            out.append(numbers[:count])
            del numbers[:count]
        return out


def frame(kind: int, data: bytes = b"") -> bytes:
    """Return one frame."""
    return struct.pack(">HB", 3 + len(data), kind) + data


def frames(buffer: bytearray) -> list[tuple[int, bytes]]:
    """Return the whole frames of a buffer and take them out of it. Raises BadFrame where it makes no sense."""
    found = []
    while len(buffer) >= 3:
        size, kind = struct.unpack_from(">HB", buffer)
        if size < 3:
            raise BadFrame(f"a frame of {size} bytes")
        if len(buffer) < size:
            break
        found.append((kind, bytes(buffer[3:size])))
        del buffer[:size]
    return found


def names_of(data: bytes) -> list[str]:
    """Return a recipe's names. Raises BadFrame where they are no text."""
    try:
        return [name for name in data.decode("ascii").split(",") if name]
    except UnicodeDecodeError as error:
        raise BadFrame("names that are no text") from error


OUTPUTS = {
    name: kind
    for kind, names in {
        "DOUBLE": "timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum "
        "actual_main_voltage actual_robot_voltage actual_robot_current standard_analog_input0 standard_analog_input1 "
        "standard_analog_output0 standard_analog_output1 payload",
        "VECTOR6D": "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current "
        "joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose target_TCP_speed "
        "joint_temperatures actual_joint_voltage ft_raw_wrench payload_inertia",
        "VECTOR3D": "actual_tool_accelerometer payload_cog",
        "VECTOR6INT32": "joint_mode",
        "INT32": "robot_mode safety_mode",
        "UINT32": "runtime_state robot_status_bits safety_status_bits",
        "UINT64": "actual_digital_input_bits actual_digital_output_bits",
    }.items()
    for name in names.split()
}
"""Type of each variable that can be received; beside them the registers."""

INPUTS = {
    name: kind
    for kind, names in {
        "UINT8": "standard_digital_output_mask standard_digital_output configurable_digital_output_mask "
        "configurable_digital_output tool_digital_output_mask tool_digital_output standard_analog_output_mask "
        "standard_analog_output_type",
        "UINT32": "speed_slider_mask input_bit_registers0_to_31 input_bit_registers32_to_63",
        "DOUBLE": "speed_slider_fraction standard_analog_output_0 standard_analog_output_1",
        "VECTOR6D": "external_force_torque",
    }.items()
    for name in names.split()
}
"""Type of each variable that can be sent; beside them the registers."""

REGISTERS = 48

for _i in range(REGISTERS):
    for _kind, _type in (("int", "INT32"), ("double", "DOUBLE")):
        OUTPUTS[f"output_{_kind}_register_{_i}"] = _type
        OUTPUTS[f"input_{_kind}_register_{_i}"] = _type
        INPUTS[f"input_{_kind}_register_{_i}"] = _type
