"""calibrate handeye, calibrate tooltip, calibrate pivot, calibrate target."""

from __future__ import annotations

from typing import Annotated

from armsight.records.fields import Doc
from armsight.records.output import Output, output

Vector = tuple[float, float, float]


@output
class RejectedFrame(Output):
    """A frame that was left out."""

    frame: Annotated[str, Doc("The frame's file or source.")]
    why: Annotated[str, Doc("Why it was left out, in words.")]


@output
class LightDistance(Output):
    """The distance of two lights."""

    value_m: Annotated[float, Doc("The distance, m.")]
    std_m: Annotated[float, Doc("Its standard deviation, m.")]


@output
class LightTargetOutput(Output):
    """armsight calibrate target."""

    spots_m: Annotated[dict[str, Vector], Doc("Place of each light by name, in the target's frame, m.")]
    std: Annotated[dict[str, Vector], Doc("Standard deviations of these positions, m.", unit="m")]
    distances_m: Annotated[dict[str, LightDistance], Doc("Distances of the lights by pair of names.")]
    n_frames: Annotated[int, Doc("Pairs of frames read.")]
    n_used: Annotated[int, Doc("Pairs that the result rests on.")]
    rejected: Annotated[list[RejectedFrame], Doc("Frames left out.")]
    residual_rms_px: Annotated[float, Doc("Reprojection residual of the fit, RMS, px.")]
    loo_rms_px: Annotated[float, Doc("Reprojection residual of each frame by the shape of the others, RMS, px.")]
    advice: Annotated[list[str], Doc("What would make the result surer.")]
