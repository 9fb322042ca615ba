"""What a person who sets up a camera wants to know: are the lights clipped, faint, blurred, or drowned by the room?"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from armsight.measure.settings import SpotSettings
from armsight.records import Frame, Spots

FAINT_LEVELS = 30.0
"""Grey levels above the background under which a light's centre is lost in the noise of a webcam: 0.1 px and more."""
BLURRED_PX = 6.0
"""Gaussian sigma in px beyond which lights are so blurred that near ones run into each other."""
POINT_LIKE_PX = 0.6
"""Gaussian sigma in px under which a light is hardly more than a pixel, whose centre cannot be told finely."""
BRIGHT_ROOM = 0.05
"""Share of clipped pixels in an image beyond which the room outshines the lights."""


class Aiming(StrEnum):
    """What to do about a camera, the most urgent first."""

    NOTHING_SEEN = "nothing_seen"
    ROOM_TOO_BRIGHT = "room_too_bright"
    CLIPPED = "clipped"
    FAINT = "faint"
    BLURRED = "blurred"
    TOO_SHARP = "too_sharp"
    GOOD = "good"


@dataclass(frozen=True, slots=True, kw_only=True)
class AimingHint:
    """advice: what to do. background: median grey level. brightest: of the lights' fitted heights above it; clipped:
    how many lights hold clipped pixels. sigma_px: their median width. None where no light is seen."""

    advice: Aiming
    background: float
    clipped_share: float
    n_clipped: int = 0
    brightest: float | None = None
    sigma_px: float | None = None


def aiming_hint(frame: Frame, spots: Spots, settings: SpotSettings) -> AimingHint:
    """Return what to change on a camera, from one frame and the lights found in it."""
    image = frame.image if frame.image.ndim == 2 else frame.image.max(axis=2)
    sample = image[::4, ::4]
    background, clipped = float(np.median(sample)), float((sample >= settings.saturation).mean())
    if len(spots) == 0:
        advice = Aiming.ROOM_TOO_BRIGHT if clipped > BRIGHT_ROOM else Aiming.NOTHING_SEEN
        return AimingHint(advice=advice, background=background, clipped_share=clipped)
    n_clipped = sum(
        _holds_clipped(image, u, v, s, settings) for (u, v), s in zip(spots.uv_px, spots.size_px, strict=True)
    )
    sigma_px, brightest = float(np.median(spots.size_px)), float(spots.peak.max())
    return AimingHint(
        advice=_advice(clipped, n_clipped, float(np.median(spots.peak)), sigma_px),
        background=background,
        clipped_share=clipped,
        n_clipped=n_clipped,
        brightest=brightest,
        sigma_px=sigma_px,
    )


def _holds_clipped(image: np.ndarray, u_px: float, v_px: float, sigma_px: float, settings: SpotSettings) -> bool:
    reach = max(1, round(sigma_px))
    row, column = round(v_px), round(u_px)
    window = image[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
    return bool(window.size and window.max() >= settings.saturation)


def _advice(clipped_share: float, n_clipped: int, peak: float, sigma_px: float) -> Aiming:
    if clipped_share > BRIGHT_ROOM:
        return Aiming.ROOM_TOO_BRIGHT
    if n_clipped:
        return Aiming.CLIPPED
    if 0.0 < peak < FAINT_LEVELS:
        return Aiming.FAINT
    if sigma_px > BLURRED_PX:
        return Aiming.BLURRED
    return Aiming.TOO_SHARP if sigma_px < POINT_LIKE_PX else Aiming.GOOD
