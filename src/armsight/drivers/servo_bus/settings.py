"""What a person may set for a bus of servos; from steps to joints, by hand or by LeRobot's calibration file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from armsight.defaults import SERVO_CYCLE_S
from armsight.drivers.link_settings import LinkSettings
from armsight.drivers.servo_bus.tables import STEP_RAD, STEPS, Family
from armsight.errors import BadFile, UsageError

KEYS = ("id", "drive_mode", "homing_offset", "range_min", "range_max")
GRIPPER = "gripper"
MAX_BYTES = 100_000
LARGEST = 1_048_576
"""Steps: 256 turns, as far as a Dynamixel counts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointOfServo:
    """One servo as a joint: q = sign (steps - zero) 2 pi / 4096. noted: (offset, lowest, highest) by its file."""

    id: int
    name: str
    sign: int = 1
    zero: float = STEPS / 2
    noted: tuple[int, int, int] | None = None

    @property
    def called(self) -> str:
        """What a person calls it."""
        return f"servo {self.id}" + (f" ({self.name})" if self.name else "")

    def q(self, steps: float) -> float:
        """Return the joint's value in rad."""
        return self.sign * (steps - self.zero) * STEP_RAD

    def steps(self, q: float) -> int:
        """Return the step nearest to a joint's value."""
        return round(self.zero + self.sign * q / STEP_RAD)


def read_lerobot(path: Path, family: Family) -> tuple[JointOfServo, ...]:
    """Return the joints of LeRobot's calibration file in the order of their ids, without the gripper.

    Zero is the middle of what was swept when it was calibrated, as LeRobot's degrees have it; those divide by 4095
    steps, which is 0.024 % more, and leave drive_mode out. Raises BadFile.
    """
    try:
        with path.open("rb") as file:
            text = file.read(MAX_BYTES + 1)
        given = json.loads(text)
    except (OSError, ValueError) as error:
        raise _bad(path, f"cannot be read: {error}") from error
    if not isinstance(given, dict) or not given:
        raise _bad(path, "holds no servos by name")
    joints = sorted((_joint(path, name, entry, family) for name, entry in given.items()), key=lambda joint: joint.id)
    for before, after in pairwise(joints):
        if before.id == after.id:
            raise _bad(path, f"gives {before.name} and {after.name} the same id, {after.id}")
    return tuple(joint for joint in joints if joint.name != GRIPPER)


def _joint(path: Path, name: str, entry: Any, family: Family) -> JointOfServo:
    if not isinstance(entry, Mapping) or any(type(entry.get(key)) is not int for key in KEYS):
        raise _bad(path, f"{name} has not the whole numbers {', '.join(KEYS)}")
    id, mode, offset, low, high = (entry[key] for key in KEYS)
    if not (0 <= id <= 252 and mode in (0, 1) and max(abs(offset), abs(low), abs(high)) <= LARGEST and low < high):
        raise _bad(path, f"{name} has numbers that no servo has: {dict(entry)}")
    sign = -1 if mode and family.reversed_by_file else 1
    return JointOfServo(id=id, name=name, sign=sign, zero=(low + high) / 2, noted=(offset, low, high))


def given_joints(ids: list[int], signs: list[int] | None, zeros: list[float] | None) -> tuple[JointOfServo, ...]:
    """Return joints as a person gives them. Raises UsageError where the numbers do not belong together."""
    n = len(ids)
    signs, zeros = signs or [1] * n, zeros or [STEPS / 2] * n
    if not (len(signs) == len(zeros) == n == len(set(ids))):
        raise UsageError(
            f"{n} ids, {len(signs)} signs and {len(zeros)} zeros of servos do not belong together",
            cure="Give each servo's id once, and as many signs and zero_steps",
        )
    return tuple(
        JointOfServo(id=id, name="", sign=sign, zero=zero) for id, sign, zero in zip(ids, signs, zeros, strict=True)
    )


def _bad(path: Path, why: str) -> BadFile:
    return BadFile(
        f"{path}: {why}",
        consequence="Directions and zeros of the joints are not known, and the robot is not opened",
        cure="Give the file that LeRobot's calibration wrote for this arm",
    )


BAUD = 1_000_000
"""As these servos are sold and as their usual programs set them."""
IDS = [1, 2, 3, 4, 5, 6]


class ServoSettings(LinkSettings):
    """Settings of a bus of servos.

    calibration: LeRobot's file, which gives ids, directions and zeros; else ids, signs (1 or -1) and zero_steps, one
    each. torque: as_found, or off: then it is switched off when the link is opened, and the arm sinks. lower_rad,
    upper_rad: narrower ranges.
    """

    link: ClassVar[str] = "the servo bus"

    baud: Annotated[int, Field(ge=9600)] = BAUD
    cycle_s: Annotated[float, Field(ge=0.005, le=0.1)] = SERVO_CYCLE_S
    calibration: Path | None = None
    ids: Annotated[list[Annotated[int, Field(ge=0, le=252)]], Field(min_length=1)] | None = None
    signs: list[Literal[1, -1]] | None = None
    zero_steps: list[float] | None = None
    torque: Literal["as_found", "off"] = "as_found"

    @model_validator(mode="before")
    @classmethod
    def _of_one(cls, values: dict[str, object]) -> dict[str, object]:
        """Take what is written without a comma for a list of one; signs are numbers."""
        made = dict(values)
        for key in ("ids", "signs", "zero_steps", "lower_rad", "upper_rad"):
            if isinstance(made.get(key), str | int | float):
                made[key] = [made[key]]
        if isinstance(signs := made.get("signs"), list):
            made["signs"] = [int(sign) if str(sign).strip() in ("1", "+1", "-1") else sign for sign in signs]
        return made

    @model_validator(mode="after")
    def _one_way(self) -> ServoSettings:
        if self.calibration is not None and (self.ids or self.signs or self.zero_steps):
            raise ValueError("ids, signs and zero_steps stand in the calibration file: give one or the other")
        return self

    def joints(self, family: Family) -> tuple[JointOfServo, ...]:
        """Return the joints. Raises BadFile, UsageError."""
        if self.calibration is not None:
            return read_lerobot(self.calibration, family)
        return given_joints(self.ids or IDS, self.signs, self.zero_steps)  # type: ignore[arg-type]
