"""What belongs to a rig beyond its cameras: zoom lenses, the mirrors' place."""

from __future__ import annotations

from armsight.app.calibrate.mirrors_check import run_check
from armsight.app.calibrate.results import MirrorCheckOutput, ZoomRigOutput
from armsight.app.calibrate.zoom import zoom_rig
from armsight.app.requests.calibrate_cameras import MirrorsJob, ZoomRigJob
from armsight.drivers import CameraSettings
from armsight.ops.checks import speaks_python
from armsight.ops.given import Given, PathText, RigLike, Source
from armsight.optics import Camera, Rig
from armsight.records import Progress, Target
from armsight.records.output import extended, output
from armsight.store import read_rig


@output
class ZoomRigResult(ZoomRigOutput):
    """What `calibrate_zoom_rig` found: its figures, and `rig`."""

    rig: Rig


@speaks_python(ZoomRigJob)
def calibrate_zoom_rig(
    rig: RigLike,
    left: Camera | PathText | None = None,
    right: Camera | PathText | None = None,
    *,
    zoom_left: float | None = None,
    zoom_right: float | None = None,
    out: PathText | None = None,
) -> ZoomRigResult:
    """Return a rig with the settings of its zoom lenses: `measure(..., zoom_left=...)` then takes any of them.

    rig: calibrated at one setting of each lens. left, right: camera.yaml with the lens's settings, as
    CameraResult.save(path, zoom=...) gathers them. zoom_left, zoom_right: where the lenses stood for the rig. out:
    rig.yaml to write. Raises UsageError, Inconsistent.
    """
    with Given(out, name="rig.yaml") as given:
        values = {"rig": rig, "zoom_left": zoom_left, "zoom_right": zoom_right}
        done = zoom_rig(given.job(ZoomRigJob, values, left=left, right=right, out=given.out))
        return extended(done, ZoomRigResult, rig=read_rig(given.out))


@speaks_python(MirrorsJob)
def check_mirrors(
    image: Source,
    board: str | Target,
    *,
    rig: RigLike | None = None,
    parallel: bool = False,
    thickness_m: float | None = None,
    baseline_m: float | None = None,
    near_m: float = MirrorsJob.near_m,
    gap_m: float = MirrorsJob.gap_m,
    camera: Camera | PathText | None = None,
    frames: int | None = None,
    camera_settings: CameraSettings | None = None,
    progress: Progress | None = None,
) -> MirrorCheckOutput:
    """Return whether a rig's mirrors stand as they did, from complex images of a printed board.

    rig: as it was calibrated; else camera and baseline_m, as designed. parallel: against parallel axes all the same.
    thickness_m: of the plate. near_m, gap_m: as designed. Raises UsageError, DataRefused.
    """
    with Given() as given:
        return run_check(given.job(MirrorsJob, locals(), limit=frames), progress)
