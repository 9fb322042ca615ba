"""doctor."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output


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


class RigResolution(Output):
    """What a rig can tell apart."""

    baseline_m: float = Field(description="Distance of the two centres of projection, m.")
    rms_px: float | None = Field(description="RMS of the rig's calibration, px; null where its file does not say.")
    sigma_px: float = Field(description="Standard deviation taken of a spot's centre, px.")
    distances: list[ResolutionAt] = Field(description="By distance.")


class DoctorOutput(Output):
    """armsight doctor."""

    versions: dict[str, str] = Field(description="Versions by program or package.")
    machine: Machine = Field(description="The machine.")
    cameras: list[str] = Field(description="Cameras that are there.")
    drivers: dict[str, list[str]] = Field(description="Drivers, cells and scenarios by group.")
    kernels: KernelCache = Field(description="Compiled kernels.")
    problems: list[str] = Field(description="What is wrong, each with a cure.")
    rig: RigResolution | None = Field(description="What the rig of --rig can tell apart; null without one.")
