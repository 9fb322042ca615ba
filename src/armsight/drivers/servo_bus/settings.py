"""What a person may set for a bus of servos."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from armsight.defaults import SERVO_CYCLE_S
from armsight.drivers.link_settings import LinkSettings
from armsight.drivers.servo_bus.calibration import JointOfServo, given_joints, read_lerobot
from armsight.drivers.servo_bus.tables import Family

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
