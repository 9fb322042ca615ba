"""What the commands of `armsight calibrate` are told."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from armsight.app.requests.shared import Every, Limit, automatic

if TYPE_CHECKING:
    from armsight.drivers import CameraSettings, ImageReading


def image_reading(bits: int | None, *, strict: bool) -> ImageReading:
    """Return how image files are read."""
    from armsight.drivers import ImageReading

    return ImageReading(bits=bits, strict=strict)


@dataclass(frozen=True, kw_only=True)
class NoiseJob:
    """Still frames (a source as on the command line), or a camera.yaml or rig.yaml that holds the noise; where it goes.

    out: the camera.yaml or rig.yaml. side: which camera of a rig. every, limit: of the frames.
    """

    frames: str
    out: Path
    side: str | None = None
    every: Every = 1
    limit: Limit = None
    camera_settings: CameraSettings = field(default_factory=automatic)
