"""What a rig will measure before it is bought, and what to change for a wanted accuracy."""

from __future__ import annotations

import math
from collections.abc import Sequence

from armsight.errors import UsageError
from armsight.ops.checks import speaks_python
from armsight.ops.given import ArmLike, Given, PathText, PoseLike, RigLike, TargetLike
from armsight.records import Progress, Target, require_kind
from armsight.records.checks import real_array, require_count
from armsight.records.output import extended
from armsight_lab.design.records import DesignOutput
from armsight_lab.design.request import Box, DesignJob
from armsight_lab.design.run import run_design


@speaks_python(DesignJob)
def design(
    target: TargetLike,
    volume: Sequence[Sequence[float]],
    rig: RigLike | None = None,
    *,
    size: tuple[int, int] | None = None,
    focal_px: float | None = None,
    focal_m: float | None = None,
    pixel_m: float | None = None,
    baseline_m: float | None = None,
    toe_in_rad: float | None = None,
    world: PoseLike | None = None,
    tilt_rad: float = DesignJob.tilt_rad,
    relative: bool = False,
    average: int = DesignJob.average,
    wanted_m: float | None = None,
    spot_noise_px: float | None = None,
    least_spot_px: float = DesignJob.least_spot_px,
    board: Target | str | None = None,
    views: int = DesignJob.views,
    corner_noise_px: float = DesignJob.corner_noise_px,
    arm: ArmLike | None = None,
    mount: Sequence[float] | None = None,
    poses: int = DesignJob.poses,
    link_radius_m: float = DesignJob.link_radius_m,
    one_more: bool = DesignJob.one_more,
    arm_noise_m: float = DesignJob.arm_noise_m,
    arm_turn_rad: float = DesignJob.arm_turn_rad,
    cells: int = DesignJob.cells,
    simulate: int = DesignJob.simulate,
    seed: int = DesignJob.seed,
    workers: int | None = None,
    out: PathText | None = None,
    progress: Progress | None = None,
) -> DesignOutput:
    """Return what a rig will measure of a target over a volume, what the deviations come from, and what to change.

    volume: ((x from, to), (y from, to), (z from, to)) in m, in the rig's axes or world's. rig: one that is there, or
    none and size, focal length (focal_px, or focal_m and pixel_m), baseline_m. board, views: what the rig is calibrated
    with. arm, with world: deviations of its tool tip in its base; link_radius_m: of its links, which hide lights.
    wanted_m: of the position, in 95 % of the volume. one_more: another camera is tried. simulate: so many simulated
    calibrations. out: a folder for the report and the map. Raises UsageError, DataRefused.

    Examples
    --------
    >>> lights = armsight.LightTarget({"A": (-0.04, 0, 0), "B": (0.03, 0.032, 0), "C": (0.03, -0.032, 0)})
    >>> planned = armsight.design(
    ...     lights,
    ...     ((-0.1, 0.2), (-0.1, 0.1), (0.5, 0.8)),
    ...     size=(1280, 720),
    ...     focal_px=950.0,
    ...     baseline_m=0.12,
    ...     board="checkerboard:9x6:0.025",
    ... )
    >>> planned.parts[0].name
    'calibration of the rig'
    """
    values = dict(locals()) | {"volume": _box(volume), "size": _size(size), "mount": _mount(mount)}
    values.pop("progress")
    with Given(values.pop("out"), name="design") as given:
        done = run_design(given.job(DesignJob, values), progress)
        return extended(done, DesignOutput, **({} if out is not None else {"report": ""}))


def _size(size: Sequence[int] | None) -> tuple[int, int] | None:
    if size is None:
        return None
    require_kind("size", size, Sequence, cure="Give (width, height) in px")
    if len(size) != 2:
        raise UsageError(
            f"the size {size!r} is not two numbers", consequence="There is no image", cure="Give (width, height) in px"
        )
    for name, value in zip(("width", "height"), size, strict=True):
        require_count(name, value, 1)
    return size[0], size[1]


def _mount(mount: Sequence[float] | None) -> tuple[float, ...] | None:
    if mount is None:
        return None
    values = real_array("mount", mount)
    if values.shape not in ((3,), (6,)) or not all(map(math.isfinite, values.tolist())):
        raise UsageError(
            f"the mount {mount!r} is not three or six finite numbers",
            consequence="It is not known where the target is on the flange",
            cure="Give (x, y, z) in m, or (x, y, z, rx, ry, rz) with degrees",
        )
    return tuple(values.tolist())


def _box(volume: Sequence[Sequence[float]]) -> Box:
    try:
        (x0, x1), (y0, y1), (z0, z1) = volume
        return (float(x0), float(x1)), (float(y0), float(y1)), (float(z0), float(z1))
    except (TypeError, ValueError):
        raise UsageError(
            f"the volume {volume!r} is not three ranges",
            consequence="It is not known where the target will be",
            cure="Give ((x from, to), (y from, to), (z from, to)) in m",
        ) from None
