"""What a person may set for a serial link of real-time path control."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from armsight.defaults import TOOL_SPEED_M_S, TOOL_SPEED_RAD_S
from armsight.drivers.alter.frames import ANSWER_BYTES, STATE_BYTES
from armsight.drivers.link_settings import LinkSettings, Positive

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
    cycle_s: Positive = 0.028
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
