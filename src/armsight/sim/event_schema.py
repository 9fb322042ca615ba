"""What goes wrong in a scenario, as its file has it."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from armsight.sim.room_schema import Finite, Keys, NotNegative, Positive, Vector3

Vector2 = Annotated[list[Finite], Field(min_length=2, max_length=2)]


class EventKeys(Keys):
    """Something that goes wrong from at_s for for_s seconds; by: of an encoder's joint, degrees or m."""

    kind: Literal["occluded", "reflection", "frozen", "dropped", "jump", "link_lost", "late_cycle", "encoder_jump"]
    at_s: NotNegative
    for_s: Positive
    side: Literal["left", "right", "both"] = "both"
    lights: list[str] = Field(default=[])
    uv_px: Vector2 | None = None
    level: Positive = 140.0
    by_m: Vector3 | None = None
    joint: Annotated[int, Field(ge=1, le=12)] | None = None
    by: Finite | None = None

    @model_validator(mode="after")
    def _complete(self) -> Self:
        given = self.joint and self.by
        needed = {"occluded": self.lights, "reflection": self.uv_px, "jump": self.by_m, "encoder_jump": given}
        named = {"occluded": "lights", "reflection": "uv_px", "jump": "by_m", "encoder_jump": "joint and by"}
        key = named.get(self.kind)
        if key is not None and not needed[self.kind]:
            raise ValueError(f"an event of kind {self.kind} needs {key}")
        return self
