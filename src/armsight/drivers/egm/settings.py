"""What a person may set for an EGM link."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from armsight.errors import UsageError

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class EgmSettings(BaseModel):
    """Settings of an EGM link.

    cycle_s: how often the controller sends (EGMActJoint's and EGMActPose's SampleRate). joints: how many the arm has.
    guidance: what the controller's program runs, EGMRunJoint or EGMRunPose. controller: the only address that is
    listened to; empty: the first that speaks. bind: the own address to listen at. open_s: how long to wait
    for the first packet. stale_s: age of a reading that is stale: two packets in a row may be late, and an ordinary
    system too. silent_s: silence after which the link is lost, CommTimeout of EGMSetupUC. max_speed_rad_s, lower_rad,
    upper_rad: of each joint; speed_m_s, speed_rad_s: of the flange in pose guidance.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    cycle_s: Positive = 0.004
    joints: Annotated[int, Field(ge=1, le=12)] = 6
    guidance: Literal["joint", "pose"] = "joint"
    controller: str = ""
    bind: str = "0.0.0.0"
    open_s: Positive = 5.0
    stale_s: Positive = 0.02
    silent_s: Positive = 1.0
    max_speed_rad_s: Positive = math.pi / 3
    lower_rad: list[float] | None = None
    upper_rad: list[float] | None = None
    speed_m_s: Positive = 0.1
    speed_rad_s: Positive = math.pi / 3


def egm_settings(values: Mapping[str, Any]) -> EgmSettings:
    """Return checked settings. Raises UsageError that names the wrong key."""
    try:
        return EgmSettings.model_validate(dict(values))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise UsageError(
            f"the setting {key!r} of the EGM link cannot be: {first['msg']}",
            consequence="The robot is not opened",
            cure=f"Known are: {', '.join(EgmSettings.model_fields)}",
        ) from error
