"""The zoom of live cameras: set before the first frame, and read back."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import cv2

from armsight.clock import Clock
from armsight.errors import DeviceFailed, UsageError

SETTLE_S = 2.0
"""How long a motor may take from one end of its way to the other; frames on the way belong to no setting."""

READ_BACK = 0.5
"""Drivers count a zoom in whole steps: what is read back may differ by half of one."""


def set_zoom(capture: Any, name: str, zoom: float, clock: Clock) -> None:
    """Set a cv2.VideoCapture's zoom, wait for the motor and read it back. Raises DeviceFailed where it is not taken."""
    if not capture.set(cv2.CAP_PROP_ZOOM, zoom):
        raise _not_taken(name, zoom, "does not take it")
    clock.sleep_until(clock.now_s() + SETTLE_S)
    there = float(capture.get(cv2.CAP_PROP_ZOOM))
    if not abs(there - zoom) <= READ_BACK:
        raise _not_taken(name, zoom, f"stands at {there:g} after {SETTLE_S:g} s")


def zoom_option(driver: str, make: Callable[..., Any], zoom: float | None) -> dict[str, float]:
    """Return the keyword for a driver's maker; UsageError where a zoom is wanted and the driver sets none."""
    if zoom is None:
        return {}
    if "zoom" not in inspect.signature(make).parameters:
        raise UsageError(
            f"the camera driver {driver} sets no zoom",
            consequence="The lens would stay where it is",
            cure="Set the lens by hand and leave --set-zoom away",
        )
    return {"zoom": zoom}


def require_live(text: str, zoom: float | None) -> None:
    """Raise UsageError where the zoom of a source that is not live is to be set."""
    if zoom is not None:
        raise UsageError(
            f"{text} is no live camera, so its zoom cannot be set",
            cure="Leave --set-zoom away; --zoom, --zoom-left and --zoom-right say at which zoom the images were taken",
        )


def _not_taken(name: str, zoom: float, what: str) -> DeviceFailed:
    return DeviceFailed(
        f"{name} was to zoom to {zoom:g} and {what}",
        consequence="Its focal length would be unknown, so no frame is read",
        cure="Check which values the camera takes; without a motor set the lens by hand and leave --set-zoom away",
    )
