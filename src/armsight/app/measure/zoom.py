"""A run with zoom lenses: the rig at their settings, and what is told of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from armsight.file_names import MEASURE
from armsight.measure.results import MeasureOutput, ZoomAt
from armsight.optics import SIDES, Rig, ZoomState, at_zoom
from armsight.store import read_zoom_rig
from armsight.store.atomic import write_json

Zoomed = dict[str, ZoomState]
"""The state of each camera that zooms, by left and right."""


def zoomed_rig(path: Path, zoom: tuple[float | None, float | None]) -> tuple[Rig, Zoomed]:
    """Return the rig in a file at these zooms. Raises as store.read_rig."""
    found = at_zoom(read_zoom_rig(path), zoom)
    states = zip(SIDES, found.states, strict=True)
    return found.rig, {side: state for side, state in states if state is not None}


def zoom_facts(zoomed: Zoomed) -> list[tuple[str, str]]:
    """Return the lines that a report says of the lenses."""
    return [
        (
            f"zoom, {side}",
            f"{state.zoom:g}, {'between settings' if state.interpolated else 'as calibrated'}: focal length "
            f"{state.camera.intrinsics[0]:.2f} +- {state.covariance.std()['fx']:.2g} px",
        )
        for side, state in zoomed.items()
    ]


def with_zoom(summary: MeasureOutput, zoomed: Zoomed, out: Path) -> MeasureOutput:
    """Return the figures of a run with those of its zoom lenses, and write them; as they are where there are none."""
    if not zoomed:
        return summary
    cameras = {
        side: ZoomAt(
            zoom=state.zoom,
            interpolated=state.interpolated,
            fx_px=float(state.camera.intrinsics[0]),
            fx_std_px=state.covariance.std()["fx"],
            fx_interpolation_px=state.interpolation["fx"],
            pupil_m=state.pupil_m,
        )
        for side, state in zoomed.items()
    }
    extended = replace(summary, zoom=cameras)
    write_json(out / MEASURE, extended.to_dict())
    return extended
