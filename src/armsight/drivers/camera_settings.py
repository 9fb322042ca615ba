"""What a person asks of a live camera, in one way for all drivers; how OpenCV is told; what a camera answers."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Protocol, TypeAlias

import cv2

from armsight.clock import Clock
from armsight.drivers.sources import Capture
from armsight.errors import DeviceFailed, UsageError
from armsight.records.checks import require_numbers

READ_BACK = 0.05
"""Share by which a value may be read back otherwise than asked: cameras count exposures in lines or 0.1 ms, gains in
steps. An automatic that goes on is off by far more, or is seen by its own switch."""

FLAGS = {
    "exposure_s": "--exposure",
    "gain": "--gain",
    "focus": "--focus",
    "white_balance_k": "--white-balance",
    "trigger": "--trigger",
    "pixel_format": "--pixel-format",
    "zoom": "--set-zoom",
}
"""Flag of the command line by the name of the setting."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraSettings:
    """Settings to lock; None leaves one as the camera has it, automatic or not.

    exposure_s: in s. gain: in dB with GenICam, else in the driver's own unit. focus: the driver's own unit.
    white_balance_k: colour temperature in K. trigger: the input whose edge starts each exposure, such as Line1.
    pixel_format: GenICam's name, such as Mono8. zoom: in the driver's own unit, the one that a calibration of the lens
    counts in. Raises UsageError for a value that no camera can have.
    """

    exposure_s: float | None = None
    gain: float | None = None
    focus: float | None = None
    white_balance_k: float | None = None
    trigger: str | None = None
    pixel_format: str | None = None
    zoom: float | None = None

    def __post_init__(self) -> None:
        require_numbers(self, "exposure_s", "gain", "focus", "white_balance_k", "zoom")
        for name in ("exposure_s", "gain", "focus", "white_balance_k", "zoom"):
            value = getattr(self, name)
            if value is not None and not (value > 0.0 or name in ("gain", "focus", "zoom")):
                raise UsageError(f"{FLAGS[name]} {value:g} cannot be", cure="Give a value that a camera can have")

    @property
    def given(self) -> tuple[str, ...]:
        """The names of the settings that are not None."""
        return tuple(field.name for field in fields(self) if getattr(self, field.name) is not None)

    def require_only(self, allowed: tuple[str, ...], name: str) -> None:
        """Raise UsageError where something is asked for that the camera called name has no way to set."""
        flags = [FLAGS[setting] for setting in self.given if setting not in allowed]
        if flags:
            can = ", ".join(FLAGS[setting] for setting in allowed)
            raise UsageError(
                f"{name} cannot be given {', '.join(flags)}",
                cure=f"Cameras of this driver take {can}; leave the rest away, and set it at the camera itself"
                if can
                else "Leave it away: cameras of this driver take none",
            )

    def require_none(self, source: str) -> None:
        """Raise UsageError where something is asked for of a source that is no camera."""
        if self.given:
            flags = ", ".join(FLAGS[setting] for setting in self.given)
            raise UsageError(
                f"{flags} is for live cameras, and {source} is none", cure=f"Leave {flags} away for recordings"
            )


AUTOMATIC = CameraSettings()
"""Nothing is asked for: the camera stays as it is."""

PairSettings: TypeAlias = CameraSettings | tuple[CameraSettings, CameraSettings]
"""Settings of both cameras of a pair, or of the left and the right one."""


def by_side(settings: PairSettings) -> tuple[CameraSettings, CameraSettings]:
    """Return the settings of the left and the right camera."""
    return settings if isinstance(settings, tuple) else (settings, settings)


def require_read_back(
    name: str, setting: str, asked: float, got: float, *, step: float = 0.0, share: float = READ_BACK
) -> None:
    """Raise DeviceFailed where a camera holds another value than it was told.

    step: how far apart the camera's values are, in the unit of the setting; half of it is always allowed. share: of
    what was asked for by which it may be off.
    """
    if not abs(got - asked) <= max(share * abs(asked), 0.5 * step, 1e-9):
        raise not_locked(name, setting, f"reads back {got:g} where {asked:g} was asked for")


def not_locked(name: str, setting: str, why: str) -> DeviceFailed:
    """Return the error for a setting that a camera does not keep."""
    return DeviceFailed(
        f"{name}: {FLAGS[setting]} {why}",
        consequence="The picture would be another than asked for, or change while it is measured, so nothing is read",
        cure=f"Give a value that the camera has; or leave {FLAGS[setting]} away, and set it by hand or with the "
        "maker's own tool, or accept what the camera does by itself",
    )


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

    def getBackendName(self) -> str:
        """Return which of OpenCV's ways to cameras this is."""


def lock_settings(capture: CameraCapture, settings: CameraSettings, name: str, clock: Clock) -> None:
    """Switch automatics off, set what is asked for, wait until the zoom stands. Raises DeviceFailed."""
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
