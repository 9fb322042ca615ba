"""doctor."""

from __future__ import annotations

from typing import Annotated

from armsight.records.fields import Doc
from armsight.records.output import Output, output


@output
class Machine(Output):
    """The machine."""

    system: Annotated[str, Doc("The operating system.")]
    cores: Annotated[int, Doc("Processor cores that armsight uses.")]
    cores_there: Annotated[int, Doc("Processor cores of the machine.")]


@output
class KernelCache(Output):
    """Compiled kernels kept on disk."""

    folder: Annotated[str, Doc("Where.")]
    compiled: Annotated[int, Doc("How many.")]
    writable: Annotated[bool, Doc("Whether more can be added.")]


@output
class ResolutionAt(Output):
    """What a rig can tell apart at a distance."""

    depth_m: Annotated[float, Doc("The distance along the mean optical axis, m.")]
    sigma_depth_m: Annotated[float, Doc("Standard deviation of a point along that axis, m.")]
    sigma_lateral_m: Annotated[tuple[float, float], Doc("Across it: along the baseline, and square to it, m.")]
    depth_per_px_m: Annotated[float, Doc("Change of depth for one pixel of disparity, m.")]
    lateral_per_px_m: Annotated[float, Doc("Change across for one pixel, m.")]
    in_view: Annotated[bool, Doc("Whether both cameras have the point in their image.")]


@output
class ReachedAccuracy(Output):
    """How well the worst point of the common view is placed, in its worst direction, as standard deviations."""

    spots_m: Annotated[float | None, Doc("What the spots' noise brings, m; null where both views share nothing.")]
    rig_m: Annotated[float | None, Doc("What the rig's calibration brings, m; 0 where its file does not tell.")]
    total_m: Annotated[float | None, Doc("Both, m.")]
    common: Annotated[float, Doc("Share of the left picture, 0 to 1, that the right camera sees as well.")]
    width_m: Annotated[float, Doc("Width of the left picture at the nearest depth, m.")]


@output
class SettingPlan(Output):
    """One setting of the lenses."""

    zoom_left: Annotated[float | None, Doc("Of the left lens; null without zoom.")]
    zoom_right: Annotated[float | None, Doc("Of the right lens; null without zoom.")]
    focal_px: Annotated[float, Doc("Focal length of the left camera, px.")]
    now: Annotated[ReachedAccuracy, Doc("With the rig's own baseline.")]
    reached: Annotated[bool, Doc("Whether that reaches the wanted accuracy.")]
    baseline_m: Annotated[float | None, Doc("The shortest baseline that reaches it, m; null where none does.")]
    at_baseline: Annotated[ReachedAccuracy | None, Doc("What that baseline gives; null where none does.")]


@output
class AccuracyPlan(Output):
    """Which settings and which baseline reach a wanted accuracy."""

    accuracy_m: Annotated[float, Doc("The wanted standard deviation of a point in its worst direction, m.")]
    depths_m: Annotated[list[float], Doc("The depths at which it is wanted, m.", unit="m")]
    sigma_px: Annotated[float, Doc("Standard deviation taken of a spot's centre, px.")]
    baseline_m: Annotated[float, Doc("The rig's own baseline, m.")]
    settings: Annotated[list[SettingPlan], Doc("By setting; one without zoom.")]
    advice: Annotated[list[str], Doc("What to do.")]


@output
class RigResolution(Output):
    """What a rig can tell apart."""

    baseline_m: Annotated[float, Doc("Distance of the two centres of projection, m.")]
    rms_px: Annotated[float | None, Doc("RMS of the rig's calibration, px; null where its file does not say.")]
    sigma_px: Annotated[float, Doc("Standard deviation taken of a spot's centre, px.")]
    distances: Annotated[list[ResolutionAt], Doc("By distance.")]
    accuracy: Annotated[AccuracyPlan | None, Doc("What reaches the accuracy of --accuracy.")] = None


@output
class DoctorOutput(Output):
    """armsight doctor."""

    versions: Annotated[dict[str, str], Doc("Versions by program or package.")]
    machine: Annotated[Machine, Doc("The machine.")]
    cameras: Annotated[list[str], Doc("Cameras that are there.")]
    drivers: Annotated[dict[str, list[str]], Doc("Drivers, cells and scenarios by group.")]
    kernels: Annotated[KernelCache, Doc("Compiled kernels.")]
    problems: Annotated[list[str], Doc("What is wrong, each with a cure.")]
    rig: Annotated[RigResolution | None, Doc("What the rig of --rig can tell apart; null without one.")]
