"""The keys of a scenario file that others share: the room, what the cameras do (`cameras.pipeline`), and events."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError, model_validator
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import UsageError
from armsight_sim.pipeline import PIPELINES, Pipeline

Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Positive = Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=1e6)]
NotNegative = Annotated[float, Field(allow_inf_nan=False, ge=0.0, le=1e6)]
Vector3 = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Size2 = Annotated[list[Positive], Field(min_length=2, max_length=2)]
Preset = Literal["dark", "workshop", "office", "plain"]
Surface = Literal[
    "plaster",
    "brick",
    "concrete",
    "wood",
    "metal",
    "paint",
    "cardboard",
    "poster",
    "checkerboard",
    "screen",
]

ROOM_LEVELS: Mapping[str, float] = {"workshop": 80.0, "office": 110.0, "plain": 70.0}
"""Grey levels of white in a room's mean light. Chosen: walls at a sixth of the range of a linear picture, which the
curve of a webcam shows as middle grey, and lights of 190 levels below saturation before them."""


class Keys(BaseModel):
    """Unknown keys and wrong types are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class PoseKeys(Keys):
    """A pose: place in m, turns rx, ry, rz in degrees with R = Rz Ry Rx."""

    xyz_m: Vector3 = [0.0, 0.0, 0.0]
    turn_deg: Vector3 = [0.0, 0.0, 0.0]

    def pose(self) -> RigidTransform:
        """Return it as a RigidTransform."""
        return RigidTransform.from_components(self.xyz_m, Rotation.from_euler("xyz", self.turn_deg, degrees=True))


class PanelKeys(Keys):
    """A textured rectangle of the room; axes x right, y down, z away from who sees it. glow: 1 shines as lit white."""

    surface: Surface
    T_room_panel: PoseKeys
    size_m: Size2
    tile_m: Positive | None = None
    colour: Annotated[list[NotNegative], Field(min_length=3, max_length=3)] = [0.4, 0.4, 0.4]
    glow: NotNegative = 0.0
    gloss: NotNegative = 0.0


INDICATOR_LEVEL, REFLECTION_LEVEL = 150.0, 140.0
"""Peaks in grey levels: of a small light of the room, and of a reflection."""


class IndicatorKeys(Keys):
    """A small light of the room that is no light of the target."""

    xyz_m: Vector3
    level: Positive = INDICATOR_LEVEL
    sigma_px: Annotated[float, Field(ge=0.3, le=50.0)] = 1.5
    bgr: Annotated[list[NotNegative], Field(min_length=3, max_length=3)] = [1.0, 1.0, 1.0]


class OccluderKeys(Keys):
    """Something of a height size_m that goes from from_m to to_m, in rig axes, between at_s and at_s + for_s."""

    kind: Literal["hand", "cable", "card"]
    at_s: NotNegative
    for_s: Positive
    from_m: Vector3
    to_m: Vector3
    size_m: Positive = 0.2


class SidesKeys(Keys):
    """A picture for each camera."""

    left: str
    right: str


GEOMETRY_KEYS = ("seed", "depth_m", "floor_m", "T_world_room", "panels", "indicators")
"""Keys of a room that mean nothing without walls."""


class RoomKeys(Keys):
    """A room of a preset, changed. depth_m: of the wall ahead; floor_m: below the rig; seed: default the run's own.

    picture: instead of a room, what the cameras deliver without the target.
    """

    preset: Preset = "dark"
    picture: str | SidesKeys | None = None
    seed: Annotated[int, Field(ge=0)] | None = None
    level: Positive | None = None
    depth_m: Positive | None = None
    floor_m: Positive | None = None
    T_world_room: PoseKeys | None = None
    panels: Annotated[list[PanelKeys], Field(max_length=500)] = []
    indicators: Annotated[list[IndicatorKeys], Field(max_length=500)] = []
    occluders: Annotated[list[OccluderKeys], Field(max_length=50)] = []

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        fields = type(self).model_fields
        geometry = {
            name for name in GEOMETRY_KEYS if getattr(self, name) != fields[name].default
        }  # by value: a scenario that was written out whole comes back
        if self.picture is not None and (geometry or self.preset != "dark"):
            raise ValueError("a picture stands instead of a room: give no preset and no geometry beside it")
        if self.preset == "dark" and geometry:
            raise ValueError(f"{', '.join(sorted(geometry))} need a preset: workshop, office or plain")
        return self

    @property
    def dark(self) -> bool:
        """Whether nothing is seen behind the target."""
        return self.preset == "dark" and self.picture is None

    @property
    def white_level(self) -> float:
        """Grey levels of white in its mean light."""
        return self.level if self.level is not None else ROOM_LEVELS.get(self.preset, 80.0)

    def picture_of(self, side: str) -> str:
        """Return the picture's file of a side."""
        return str(getattr(self.picture, side)) if isinstance(self.picture, SidesKeys) else str(self.picture)


def _by_name(value: Any) -> Any:
    return {"preset": value} if isinstance(value, str) else value


RoomChoice = Annotated[RoomKeys, BeforeValidator(_by_name)]
"""A room by its name, or by its keys."""


class PipelineKeys(Keys):
    """A camera's pipeline: a preset, and what differs from it."""

    preset: Literal["ideal", "machine", "webcam"] = "ideal"
    vignetting: Annotated[float, Field(ge=0.0, lt=1.0)] | None = None
    glare: Annotated[float, Field(ge=0.0, lt=1.0)] | None = None
    bayer: bool | None = None
    curve: Literal["linear", "srgb", "gamma"] | None = None
    gamma: Annotated[float, Field(ge=0.2, le=5.0)] | None = None
    sharpening: Annotated[float, Field(ge=0.0, le=5.0)] | None = None
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | Literal["none"] | None = None


PipelineChoice = Annotated[PipelineKeys, BeforeValidator(_by_name)]
"""A pipeline by its name, or by its keys."""


def pipeline_of(choice: PipelineKeys) -> Pipeline:
    """Return the pipeline of a checked key."""
    base = PIPELINES[choice.preset]
    given = {key: value for key, value in choice.model_dump(exclude={"preset"}).items() if value is not None}
    if given.get("jpeg_quality") == "none":
        given["jpeg_quality"] = None
    return Pipeline(**{**{name: getattr(base, name) for name in Pipeline.__dataclass_fields__}, **given})


def checked_room(value: Any) -> RoomKeys:
    """Return a room as given to a cell or a command; UsageError, with the key, for what is none."""
    if isinstance(value, RoomKeys):
        return value
    room: RoomKeys = _checked(TypeAdapter(RoomChoice), value, "room")
    return room


def checked_pipeline(value: Any) -> Pipeline:
    """Return a pipeline as given to a cell or a command; UsageError, with the key, for what is none."""
    return (
        value if isinstance(value, Pipeline) else pipeline_of(_checked(TypeAdapter(PipelineChoice), value, "pipeline"))
    )


def _checked(adapter: TypeAdapter[Any], value: Any, what: str) -> Any:
    try:
        return adapter.validate_python(value)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join([what, *(str(part) for part in first["loc"])])
        raise UsageError(f"{key}: {first['msg']}", cure="docs/guide/simulate.md lists the keys") from error


Vector2 = Annotated[list[Finite], Field(min_length=2, max_length=2)]


class EventKeys(Keys):
    """Something that goes wrong from at_s for for_s seconds; by: of an encoder's joint, degrees or m.

    side: a camera's name, or both or all, which mean every one.
    """

    kind: Literal["occluded", "reflection", "frozen", "dropped", "jump", "link_lost", "late_cycle", "encoder_jump"]
    at_s: NotNegative
    for_s: Positive
    side: str = "both"
    lights: list[str] = Field(default=[])
    uv_px: Vector2 | None = None
    level: Positive = REFLECTION_LEVEL
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
