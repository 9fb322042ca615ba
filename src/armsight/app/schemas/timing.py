"""calibrate timing."""

from __future__ import annotations

from typing import Annotated

from armsight.records.fields import Doc
from armsight.records.output import Output, output
from armsight.records.result_parts import BothCounts, BothPixels, BothSeconds


@output
class TimingOutput(Output):
    """armsight calibrate timing."""

    delay_s: Annotated[
        float, Doc("t_left = t_right + delay_s + 1e-6 drift_ppm t_right turns the right stamps into left ones, s.")
    ]
    drift_ppm: Annotated[float, Doc("How much faster the left camera's clock runs, parts in a million.")]
    readout_s: Annotated[BothSeconds, Doc("From the first line's exposure to the last one's; 0: global shutter.")]
    jitter_s: Annotated[BothSeconds, Doc("Standard deviation of a single stamp about the camera's steady clock.")]
    std: Annotated[
        dict[str, float],
        Doc(
            "Standard deviations by name: delay_s, drift_ppm, left.readout_s, right.readout_s, left.jitter_s, "
            "right.jitter_s."
        ),
    ]
    middle_s: Annotated[float, Doc("Right stamp in the middle of the recording, where the delay is known best, s.")]
    std_middle_s: Annotated[float, Doc("Standard deviation of t_left there, s.")]
    period_s: Annotated[BothSeconds, Doc("From frame to frame, by the camera's own stamps.")]
    n_frames: Annotated[int, Doc("Frames of both cameras together.")]
    lost: Annotated[BothCounts, Doc("Frames missing, recognised from the spacing of the stamps.")]
    common_s: Annotated[float, Doc("How long both cameras saw the lights, s.")]
    lights: Annotated[list[str], Doc("Lights used.")]
    residual_px: Annotated[BothPixels, Doc("RMS residual of a spot's coordinate.")]
    verdict: Annotated[str, Doc("Whether the result can be trusted, in words.")]
    advice: Annotated[list[str], Doc("What would make the result surer.")]
