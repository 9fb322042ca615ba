"""calibrate handeye, calibrate tooltip, calibrate pivot, calibrate target."""

from __future__ import annotations

from typing import Annotated

from armsight.records.fields import Doc
from armsight.records.output import Output, output
from armsight.records.result_parts import PointStd, RejectedRow

Vector = tuple[float, float, float]


@output
class TipOutput(Output):
    """armsight calibrate tooltip."""

    tip_m: Annotated[Vector, Doc("The tool's tip in the axes of the turned frame, target or flange, m.")]
    point_m: Annotated[Vector, Doc("The point on which it rested, in the poses' parent frame, m.")]
    std: Annotated[PointStd, Doc("Standard deviations of the tip.")]
    residual_rms_m: Annotated[float, Doc("Distance of the tip from the point, RMS over the used poses, m.")]
    loo_rms_m: Annotated[
        float | None, Doc("The same by the tip of the other poses, RMS, m; with times: of those further away in time.")
    ] = None
    n_used: Annotated[int, Doc("Poses that the result rests on.")]
    n_effective: Annotated[float | None, Doc("Independent poses that they are worth; of poses with times only.")] = None
    correlation_time_s: Annotated[
        float | None, Doc("After which a drift of the errors is forgotten, s; with times only.")
    ] = None
    rejected: Annotated[list[RejectedRow], Doc("Poses left out.")]
    turning_rms_rad: Annotated[Vector, Doc("Turns of the tool about its principal axes, falling, RMS, rad.")]
    mean_tip_m: Annotated[Vector | None, Doc("The mean of Pachidis eq. (13), m; where the point was measured.")] = None
    notes: Annotated[list[str], Doc("What to know of the result, and to do.")]


@output
class PivotOutput(TipOutput):
    """armsight calibrate pivot."""

    goal_m: Annotated[float, Doc("Standard deviation of the tip that was good enough, m.")]
    reached: Annotated[bool, Doc("Whether the tip is known so well.")]


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
