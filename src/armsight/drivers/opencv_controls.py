"""Set a camera of OpenCV's and see that it holds: exposure, gain, focus and white balance without automatics, zoom."""

from __future__ import annotations

from typing import Protocol

import cv2

from armsight.clock import Clock
from armsight.drivers.camera_settings import CameraSettings, not_locked, require_read_back
from armsight.drivers.sources import Capture

SETTINGS = ("exposure_s", "gain", "focus", "white_balance_k", "zoom")
"""What can be asked of such a camera."""

EXPOSURE_STEP_S = 1e-4
"""Video4Linux counts exposures in 0.1 ms (V4L2_CID_EXPOSURE_ABSOLUTE)."""

EXPOSURE_MANUAL = 1.0
"""V4L2_EXPOSURE_MANUAL; 3 is the usual automatic one, which holds the aperture."""

SECONDS_BACKENDS = ("V4L2",)
"""Of OpenCV's ways to a camera, those whose exposure has a known unit."""


ZOOM_S = 2.0
"""How long a motor may take from one end of its way to the other; frames on the way belong to no setting."""

STEP = 1.0
"""Drivers count gain, focus, white balance and zoom in whole steps."""


class CameraCapture(Capture, Protocol):
    """The part of cv2.VideoCapture that a camera needs."""

    def set(self, key: int, value: float, /) -> bool:
        """Set a property; False where the driver says that it cannot."""
        ...

    def getBackendName(self) -> str:
        """Return which of OpenCV's ways to cameras this is."""
        ...


def lock_settings(capture: CameraCapture, settings: CameraSettings, name: str, clock: Clock) -> None:
    """Switch the automatics off, set what is asked for and wait until the zoom stands.

    Raises DeviceFailed as check_settings does, and for a zoom that the driver does not take.
    """
    if settings.zoom is not None:  # first: another focal length may want another focus
        if not capture.set(cv2.CAP_PROP_ZOOM, settings.zoom):
            raise not_locked(name, "zoom", f"{settings.zoom:g} is not taken")
        clock.sleep_until(clock.now_s() + ZOOM_S)
    if settings.exposure_s is not None:
        if capture.getBackendName() not in SECONDS_BACKENDS:
            raise not_locked(name, "exposure_s", f"has no known unit with OpenCV's {capture.getBackendName()}")
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, EXPOSURE_MANUAL)
        capture.set(cv2.CAP_PROP_EXPOSURE, float(round(settings.exposure_s / EXPOSURE_STEP_S)))
    if settings.gain is not None:
        capture.set(cv2.CAP_PROP_GAIN, settings.gain)
    if settings.focus is not None:
        capture.set(cv2.CAP_PROP_AUTOFOCUS, 0.0)
        capture.set(cv2.CAP_PROP_FOCUS, settings.focus)
    if settings.white_balance_k is not None:
        capture.set(cv2.CAP_PROP_AUTO_WB, 0.0)
        capture.set(cv2.CAP_PROP_WB_TEMPERATURE, settings.white_balance_k)
    check_settings(capture, settings, name)


def check_settings(capture: CameraCapture, settings: CameraSettings, name: str) -> None:
    """Raise DeviceFailed where an automatic is on that was to be off, or a value is another than asked for."""
    if settings.exposure_s is not None:
        if capture.get(cv2.CAP_PROP_AUTO_EXPOSURE) not in (EXPOSURE_MANUAL, -1.0):  # -1: it has no automatic
            raise not_locked(name, "exposure_s", "stays automatic")
        got_s = capture.get(cv2.CAP_PROP_EXPOSURE) * EXPOSURE_STEP_S
        require_read_back(name, "exposure_s", settings.exposure_s, got_s, step=EXPOSURE_STEP_S)
    if settings.gain is not None:
        require_read_back(name, "gain", settings.gain, capture.get(cv2.CAP_PROP_GAIN), step=STEP)
    for setting, asked, automatic, key in (
        ("focus", settings.focus, cv2.CAP_PROP_AUTOFOCUS, cv2.CAP_PROP_FOCUS),
        ("white_balance_k", settings.white_balance_k, cv2.CAP_PROP_AUTO_WB, cv2.CAP_PROP_WB_TEMPERATURE),
    ):
        if asked is None:
            continue
        if capture.get(automatic) > 0.0:
            raise not_locked(name, setting, "stays automatic")
        require_read_back(name, setting, asked, capture.get(key), step=STEP)
    if settings.zoom is not None:  # share 0: 5 % of a zoom would be 5 % of the focal length
        require_read_back(name, "zoom", settings.zoom, capture.get(cv2.CAP_PROP_ZOOM), step=STEP, share=0.0)
