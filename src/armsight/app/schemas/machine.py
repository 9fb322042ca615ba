"""doctor."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output, absent


class Machine(Output):
    """The machine."""

    system: str = Field(description="The operating system.")
    cores: int = Field(description="Processor cores that armsight uses.")
    cores_there: int = Field(description="Processor cores of the machine.")


class KernelCache(Output):
    """Compiled kernels kept on disk."""

    folder: str = Field(description="Where.")
    compiled: int = Field(description="How many.")
    writable: bool = Field(description="Whether more can be added.")


class ResolutionAt(Output):
    """What a rig can tell apart at a distance."""

    depth_m: float = Field(description="The distance along the mean optical axis, m.")
    sigma_depth_m: float = Field(description="Standard deviation of a point along that axis, m.")
    sigma_lateral_m: tuple[float, float] = Field(description="Across it: along the baseline, and square to it, m.")
    depth_per_px_m: float = Field(description="Change of depth for one pixel of disparity, m.")
    lateral_per_px_m: float = Field(description="Change across for one pixel, m.")
    in_view: bool = Field(description="Whether both cameras have the point in their image.")


class ReachedAccuracy(Output):
    """How well the worst point of the common view is placed, in its worst direction, as standard deviations."""

    spots_m: float | None = Field(description="What the spots' noise brings, m; null where both views share nothing.")
    rig_m: float | None = Field(description="What the rig's calibration brings, m; 0 where its file does not tell.")
    total_m: float | None = Field(description="Both, m.")
    common: float = Field(description="Share of the left picture, 0 to 1, that the right camera sees as well.")
    width_m: float = Field(description="Width of the left picture at the nearest depth, m.")


class SettingPlan(Output):
    """One setting of the lenses."""

    zoom_left: float | None = Field(description="Of the left lens; null without zoom.")
    zoom_right: float | None = Field(description="Of the right lens; null without zoom.")
    focal_px: float = Field(description="Focal length of the left camera, px.")
    now: ReachedAccuracy = Field(description="With the rig's own baseline.")
    reached: bool = Field(description="Whether that reaches the wanted accuracy.")
    baseline_m: float | None = Field(description="The shortest baseline that reaches it, m; null where none does.")
    at_baseline: ReachedAccuracy | None = Field(description="What that baseline gives; null where none does.")


class AccuracyPlan(Output):
    """Which settings and which baseline reach a wanted accuracy."""

    accuracy_m: float = Field(description="The wanted standard deviation of a point in its worst direction, m.")
    depths_m: list[float] = Field(description="The depths at which it is wanted, m.", json_schema_extra={"unit": "m"})
    sigma_px: float = Field(description="Standard deviation taken of a spot's centre, px.")
    baseline_m: float = Field(description="The rig's own baseline, m.")
    settings: list[SettingPlan] = Field(description="By setting; one without zoom.")
    advice: list[str] = Field(description="What to do.")


class RigResolution(Output):
    """What a rig can tell apart."""

    baseline_m: float = Field(description="Distance of the two centres of projection, m.")
    rms_px: float | None = Field(description="RMS of the rig's calibration, px; null where its file does not say.")
    sigma_px: float = Field(description="Standard deviation taken of a spot's centre, px.")
    distances: list[ResolutionAt] = Field(description="By distance.")
    accuracy: AccuracyPlan | None = Field(
        None, exclude_if=absent, description="What reaches the accuracy of --accuracy."
    )


class DoctorOutput(Output):
    """armsight doctor."""

    versions: dict[str, str] = Field(description="Versions by program or package.")
    machine: Machine = Field(description="The machine.")
    cameras: list[str] = Field(description="Cameras that are there.")
    drivers: dict[str, list[str]] = Field(description="Drivers, cells and scenarios by group.")
    kernels: KernelCache = Field(description="Compiled kernels.")
    problems: list[str] = Field(description="What is wrong, each with a cure.")
    rig: RigResolution | None = Field(description="What the rig of --rig can tell apart; null without one.")
