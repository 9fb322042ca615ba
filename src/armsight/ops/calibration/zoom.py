"""Settings of zoom lenses taken out of the files of cameras and rigs, one by one."""

from __future__ import annotations

from pathlib import Path

from armsight.ops.conversion import ConvertOutput
from armsight.optics import INTRINSICS, at_zoom
from armsight.records import NamedCovariance
from armsight.store import read_zoom_camera, read_zoom_rig, write_camera, write_rig


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
        for side, state in zip(found.rig.names, found.states, strict=True)
        if state is not None
    ]
    return _converted(out, "; ".join(changes))


def _how(interpolated: bool) -> str:
    return "between settings" if interpolated else "as calibrated"


def _converted(out: Path, note: str) -> ConvertOutput:
    return ConvertOutput(source="armsight", target="armsight", files=[str(out)], n=None, note=note)
