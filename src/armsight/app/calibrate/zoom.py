"""Settings of zoom lenses: added to a camera's file, given to a rig, taken out again one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from armsight.app.calibrate.results import ZoomOutput, ZoomRigOutput
from armsight.app.convert import ConvertOutput
from armsight.app.requests.calibrate_cameras import ZoomRigJob, ZoomValue
from armsight.calibrate.cameras import CameraCalibration
from armsight.errors import UsageError
from armsight.optics import INTRINSICS, SIDES, ZoomLens, ZoomSetting, at_zoom, with_zoom
from armsight.records import NamedCovariance, NoiseModel
from armsight.store import (
    ZoomCameraFile,
    read_rig,
    read_zoom_camera,
    read_zoom_rig,
    write_camera,
    write_rig,
    write_zoom_camera,
)

DOUBTFUL = 0.005
"""A relative standard deviation of the focal length between settings that is worth a word: 5 mm at 1 m."""

NO_PUPILS = (
    "the settings do not say where the pupil stands (pupil_m): at other settings than the rig's the cameras' centres "
    "are taken to stay, and any way they move is in no standard deviation"
)


def zoom_file(path: Path) -> ZoomCameraFile | None:
    """Return the settings that a file holds already; None where there is no file. BadFile where it is another camera's.

    Asked before a setting is calibrated, so that nobody waits for a result that has no place.
    """
    return read_zoom_camera(path) if path.exists() else None


def add_setting(
    path: Path,
    value: ZoomValue,
    done: CameraCalibration,
    *,
    noise: NoiseModel | None = None,
    inputs: Sequence[Path] = (),
) -> ZoomLens:
    """Add a calibrated setting to a zoom lens's file, in place of the one at its zoom; return the lens.

    The noise that the file holds stays where no new one is given. Raises Inconsistent, and leaves the file as it is,
    where the setting is not of the same camera.
    """
    setting = ZoomSetting(
        zoom=value.zoom,
        camera=done.camera,
        covariance=done.covariance,
        rms_px=done.rms_px,
        pupil_m=value.pupil_m,
        pupil_std_m=value.pupil_std_m,
    )
    old = zoom_file(path)
    if old is None:
        lens = ZoomLens(settings=(setting,))
        file = ZoomCameraFile(lens=lens, noise=noise)
    else:
        lens = old.lens.with_setting(setting)
        file = replace(old, lens=lens, noise=noise or old.noise)
    write_zoom_camera(path, file, inputs=inputs)
    return lens


def zoom_output(lens: ZoomLens, zoom: float) -> ZoomOutput:
    """Return a lens's settings, and how well each is predicted by the others, as --json gives them."""
    left_out = lens.left_out()
    focal = [float(one.camera.intrinsics[0]) for one in lens.settings]
    of_zoom = {one.zoom: one.camera.intrinsics[0] for one in lens.settings}
    relative = np.array([one.focal_error_px / of_zoom[one.zoom] for one in left_out])
    return ZoomOutput(
        zoom=zoom,
        settings=lens.zooms.tolist(),
        focal_lengths_px=focal,
        left_out=list(left_out),
        focal_error_rms=float(np.sqrt((relative**2).mean())) if len(relative) else None,
        advice=_advice(lens),
    )


def _advice(lens: ZoomLens) -> list[str]:
    """Return what is missing between the settings."""
    n = len(lens.settings)
    if n < 3:
        return [f"{n} of at least 3 settings: until then only the calibrated ones can be used"]
    worst, at = 0.0, 0.0
    for zoom in (0.5 * (lens.zooms[1:] + lens.zooms[:-1])).tolist():
        state = lens.at(zoom)
        doubt = state.covariance.std()["fx"] / state.camera.intrinsics[0]
        worst, at = (doubt, zoom) if doubt > worst else (worst, at)
    if worst < DOUBTFUL:
        return []
    return [f"at zoom {at:g} the focal length is known to {100 * worst:.1f} % only; calibrate a setting there"]


def zoom_rig(job: ZoomRigJob) -> ZoomRigOutput:
    """Give a calibrated rig the settings of its lenses; write it. Raises UsageError, DataRefused, DeviceFailed."""
    if job.left is None and job.right is None:
        raise UsageError("no zoom lens is given", cure="Give --left, --right or both: files with zoom settings")
    paths = (job.left, job.right)
    files = [None if path is None else read_zoom_camera(path) for path in paths]
    lenses = tuple(None if file is None else file.lens for file in files)
    rig = with_zoom(read_rig(job.rig), (lenses[0], lenses[1]), (job.zoom_left, job.zoom_right))
    write_rig(job.out, rig, inputs=[path for path in (job.rig, *paths) if path is not None])
    mounted = {side: one for side, one in zip(SIDES, rig.zoom, strict=True) if one is not None}
    pupils = all(one.lens.settings[0].pupil_m is not None for one in mounted.values())
    return ZoomRigOutput(
        settings={side: one.lens.zooms.tolist() for side, one in mounted.items()},
        at={side: one.at for side, one in mounted.items()},
        pupils=pupils,
        advice=[] if pupils else [NO_PUPILS],
    )


def fix_camera(source: Path, out: Path, zoom: float) -> ConvertOutput:
    """Write the camera.yaml of a zoom lens at one zoom, calibrated or between settings."""
    file = read_zoom_camera(source)
    state = file.lens.at(zoom)
    known = [i for i in range(len(INTRINSICS)) if state.covariance.matrix[i, i] > 0.0]
    names = tuple(INTRINSICS[i] for i in known)
    covariance = NamedCovariance(names=names, matrix=state.covariance.block(names))
    setting = file.lens.setting(zoom)
    write_camera(
        out,
        state.camera,
        covariance=covariance if names else None,
        rms_px=None if setting is None else setting.rms_px,
        noise=file.noise,
        timing=file.timing,
        inputs=[source],
    )
    return _converted(out, f"at zoom {zoom:g}, {_how(state.interpolated)}")


def fix_rig(source: Path, out: Path, zoom: tuple[float | None, float | None]) -> ConvertOutput:
    """Write the rig.yaml of a rig with zoom lenses at one zoom of each."""
    found = at_zoom(read_zoom_rig(source), zoom)
    write_rig(out, found.rig, inputs=[source])
    changes = [
        f"{side} at zoom {state.zoom:g}, {_how(state.interpolated)}"
        for side, state in zip(SIDES, found.states, strict=True)
        if state is not None
    ]
    return _converted(out, "; ".join(changes))


def _how(interpolated: bool) -> str:
    return "between settings" if interpolated else "as calibrated"


def _converted(out: Path, note: str) -> ConvertOutput:
    return ConvertOutput(source="armsight", target="armsight", files=[str(out)], n=None, note=note)
