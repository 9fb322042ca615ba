"""calibrate timing."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output


class BothSeconds(Output):
    """A time of each camera."""

    left: float = Field(description="Of the left camera, s.", json_schema_extra={"unit": "s"})
    right: float = Field(description="Of the right camera, s.", json_schema_extra={"unit": "s"})


class BothCounts(Output):
    """A number of frames of each camera."""

    left: int = Field(description="Of the left camera.")
    right: int = Field(description="Of the right camera.")


class BothPixels(Output):
    """A distance in the image of each camera."""

    left: float = Field(description="Of the left camera, px.", json_schema_extra={"unit": "px"})
    right: float = Field(description="Of the right camera, px.", json_schema_extra={"unit": "px"})


class TimingOutput(Output):
    """armsight calibrate timing."""

    delay_s: float = Field(
        description="t_left = t_right + delay_s + 1e-6 drift_ppm t_right turns the right stamps into left ones, s."
    )
    drift_ppm: float = Field(description="How much faster the left camera's clock runs, parts in a million.")
    readout_s: BothSeconds = Field(description="From the first line's exposure to the last one's; 0: global shutter.")
    jitter_s: BothSeconds = Field(description="Standard deviation of a single stamp about the camera's steady clock.")
    std: dict[str, float] = Field(
        description="Standard deviations by name: delay_s, drift_ppm, left.readout_s, right.readout_s, left.jitter_s, "
        "right.jitter_s."
    )
    middle_s: float = Field(description="Right stamp in the middle of the recording, where the delay is known best, s.")
    std_middle_s: float = Field(description="Standard deviation of t_left there, s.")
    period_s: BothSeconds = Field(description="From frame to frame, by the camera's own stamps.")
    n_frames: int = Field(description="Frames of both cameras together.")
    lost: BothCounts = Field(description="Frames missing, recognised from the spacing of the stamps.")
    common_s: float = Field(description="How long both cameras saw the lights, s.")
    lights: list[str] = Field(description="Lights used.")
    residual_px: BothPixels = Field(description="RMS residual of a spot's coordinate.")
    verdict: str = Field(description="Whether the result can be trusted, in words.")
    advice: list[str] = Field(description="What would make the result surer.")
