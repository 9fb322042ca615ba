"""Zoom lenses: what the settings of one come to, and a rig that has them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated

import numpy as np

from armsight.errors import UsageError
from armsight.fields import Doc
from armsight.optics import SIDES, Rig, ZoomLens, with_zoom
from armsight.optics.zoom import LeftOut
from armsight.records.by_value import Saveable
from armsight.records.output import Output, output
from armsight.shown import WRITTEN, Shown, Table, digits

DOUBTFUL = 0.005
"""A relative standard deviation of the focal length between settings that is worth a word: 5 mm at 1 m."""

NO_PUPILS = (
    "the settings do not say where the pupil stands (pupil_m): at other settings than the rig's the cameras' centres "
    "are taken to stay, and any way they move is in no standard deviation"
)


@output
class ZoomOutput(Output):
    """The zoom lens whose setting was calibrated."""

    zoom: Annotated[float, Doc("The setting that was calibrated.")]
    settings: Annotated[list[float], Doc("All settings in the file, increasing.")]
    focal_lengths_px: Annotated[list[float], Doc("Focal length along x at these, px.")]
    left_out: Annotated[
        list[LeftOut],
        Doc("Each setting but the first and last, predicted from the others; empty with fewer than three."),
    ]
    focal_error_rms: Annotated[float | None, Doc("RMS of the relative errors of these focal lengths.")]
    advice: Annotated[list[str], Doc("What to know about the curve between the settings.")]

    def summary(self) -> Iterator[Shown]:
        """Yield the settings of the lens, and how well each is predicted by the others."""
        left_out = {one.zoom: one for one in self.left_out}
        rows = []
        for value, focal in zip(self.settings, self.focal_lengths_px, strict=True):
            one, told = left_out.get(value), ["-"] * 3
            if one is not None:
                told = [f"{one.focal_error_px:+.2f}", digits(one.focal_std_px), digits(one.image_rms_px)]
            rows.append([f"{value:g}", digits(focal, 6), *told])
        header = ["zoom", "fx, px", "left out: error of fx, px", "claimed +-", "image, px RMS"]
        yield Table("Settings of the lens", header, rows)
        if self.focal_error_rms is not None:
            yield (
                f"Left out and predicted from the others, focal lengths are {digits(100.0 * self.focal_error_rms, 2)} "
                "% off (RMS); with all settings it is less between them, and what is measured there says how much"
            )
        yield from (f"  {text}" for text in self.advice)


@output
class ZoomRigResult(Output, Saveable):
    """armsight calibrate zoom-rig: what the lenses can be set to, and `rig`, which has their settings."""

    settings: Annotated[dict[str, list[float]], Doc("Settings of each camera that zooms, by left and right.")]
    at: Annotated[dict[str, float], Doc("The zoom at which the rig was calibrated, by left and right.")]
    pupils: Annotated[bool, Doc("Whether all settings say where the pupil stands.")]
    advice: Annotated[list[str], Doc("What to know about the rig at other settings.")]
    rig: Rig

    def summary(self) -> Iterator[Shown]:
        """Yield what the lenses can be set to."""
        for side, values in self.settings.items():
            known = ", ".join(f"{value:g}" for value in values)
            yield f"{side}: settings {known}; rig calibrated at {self.at[side]:g}"
        yield from (f"Note: {text}" for text in self.advice)
        yield WRITTEN


def settings_of(lens: ZoomLens, zoom: float) -> ZoomOutput:
    """Return a lens's settings, and how well each is predicted by the others; zoom: the one that was calibrated."""
    left_out = lens.left_out()
    of_zoom = {one.zoom: one.camera.intrinsics[0] for one in lens.settings}
    relative = np.array([one.focal_error_px / of_zoom[one.zoom] for one in left_out])
    return ZoomOutput(
        zoom=zoom,
        settings=lens.zooms.tolist(),
        focal_lengths_px=[float(focal) for focal in of_zoom.values()],
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


def rig_with_lenses(rig: Rig, lenses: Sequence[ZoomLens | None], at: Sequence[float | None]) -> ZoomRigResult:
    """Return a calibrated rig with the settings of its left and right lens; at: where they stood. Raises UsageError."""
    if all(lens is None for lens in lenses):
        raise UsageError("no zoom lens is given", cure="Give --left, --right or both: files with zoom settings")
    zoomed = with_zoom(rig, (lenses[0], lenses[1]), (at[0], at[1]))
    mounted = {side: one for side, one in zip(SIDES, zoomed.zoom, strict=True) if one is not None}
    pupils = all(one.lens.settings[0].pupil_m is not None for one in mounted.values())
    return ZoomRigResult(
        settings={side: one.lens.zooms.tolist() for side, one in mounted.items()},
        at={side: one.at for side, one in mounted.items()},
        pupils=pupils,
        advice=[] if pupils else [NO_PUPILS],
        rig=zoomed,
    )
