"""What a calibration from images comes to: whether its images agree, fill the view, and speak of one lens."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from numpy import float64
from numpy.typing import NDArray

from armsight.calibrate.cameras.preconditions import COVERED, image_share
from armsight.optics import Camera
from armsight.records.result_parts import Verdict

OVERFITTED = 1.5
"""Left-out error over fitted error: above it the fit follows its own images more than the camera."""
MIN_USED = 0.7
"""Share of the images used, below which the set itself is in doubt."""
GOOD_RMS_PX = 0.6
"""Residual on images left out of the fit, beyond which boards, lenses or light are not as they should be."""


def images_doubted(
    n_used: int,
    n_images: int,
    rms_px: float,
    left_out_px: float | None,
    seen: Mapping[str, tuple[Camera, NDArray[float64]]],
    *,
    noun: str = "images",
    thing: str = "board",
) -> list[str]:
    """Return what speaks against relying on a calibration. seen: each camera with all points (n, 2) found in it, px."""
    out = []
    if n_used < MIN_USED * n_images:
        out.append(f"only {n_used} of {n_images} {noun} could be used")
    if left_out_px is not None and left_out_px > OVERFITTED * rms_px:
        out.append(f"{noun} left out of the fit are met {left_out_px / rms_px:.1f} times worse than those in it")
    if left_out_px is not None and left_out_px > GOOD_RMS_PX:
        out.append(f"{noun} left out of the fit are met to {left_out_px:.3g} px, beyond {GOOD_RMS_PX} px")
    for name, (camera, uv_px) in seen.items():
        share = image_share(uv_px, camera.width, camera.height) if len(uv_px) else 1.0
        if share < COVERED:
            out.append(f"the {thing} covered only {100 * share:.0f} % of the {name} image")
    return out


def images_verdict(
    found: str,
    doubts: Sequence[str],
    advice: Sequence[str],
    *,
    squares: bool,
    noun: str = "images",
    thing: str = "board",
) -> Verdict:
    """Return the verdict of a calibration. found: what fits how well; squares: whether the board's are in doubt."""
    if doubts:
        todo = f"Take more {noun}, with the {thing} tilted and up to the images' corners, and calibrate again."
        if squares:
            todo = (
                f"Measure the {thing} along both sides with a calliper; calibrate again with one whose squares are "
                "square, from images as the camera takes them."
            )
        said = f"{found}. But {'; '.join(doubts)}."
        return Verdict(level="care", headline="Usable with care", reasons=[said], next=[todo])
    todo = "Use it; calibrate again when focus, zoom or a mount has moved."
    if advice:
        todo = f"Use it; what would make it better: {'; '.join(advice)}."
    return Verdict(level="good", headline="Good", reasons=[f"{found}."], next=[todo])
