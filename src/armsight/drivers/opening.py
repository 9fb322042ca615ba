"""Drivers by their name, and from what a person writes to a source of frames or of moments."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from inspect import Parameter, signature
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

from armsight.clock import Clock, SystemClock
from armsight.drivers.camera_settings import AUTOMATIC, CameraSettings
from armsight.drivers.images import AS_THEY_ARE, ImageReading
from armsight.drivers.moments import FileMoments, Moments
from armsight.drivers.protocols import FrameSource
from armsight.drivers.sources import FPS, VIDEO_SUFFIXES, ImageFolder, VideoFile
from armsight.drivers.timed_moments import MAX_SKEW_S, TimedMoments
from armsight.errors import UsageError
from armsight.registry import CAMERAS, load

CAMERA = "camera:"
DEFAULT_CAMERA = "opencv"


def is_live(text: str) -> bool:
    """Tell whether the text names a live camera."""
    return text.startswith(CAMERA)


def is_video(text: str) -> bool:
    """Tell whether the text names a video file."""
    return Path(text).suffix.lower() in VIDEO_SUFFIXES and not Path(text).is_dir()


def open_source(
    text: str,
    *,
    colour: bool = False,
    fps: float | None = None,
    times_s: Sequence[float] | None = None,
    clock: Clock | None = None,
    origin_s: float | None = None,
    settings: CameraSettings = AUTOMATIC,
    reading: ImageReading = AS_THEY_ARE,
) -> FrameSource:
    """Return the source that a person's text names; nothing is opened yet.

    camera:0 or camera:/dev/video0 is a camera of OpenCV's, camera:DRIVER or camera:DRIVER:DEVICE one of a registered
    driver; settings: what is asked of it. reading: of image files. Raises UsageError, or DeviceNotFound for an
    unknown driver.
    """
    if is_live(text):
        reading.require_none(text)
        if times_s is not None:
            raise UsageError("a live camera brings its own time stamps", cure="Leave --times away")
        driver, device = _driver(text.removeprefix(CAMERA))
        make = load(CAMERAS, driver)
        asked = _asked(make, settings, text)
        return cast(FrameSource, make(device, colour=colour, clock=clock, origin_s=origin_s, **asked))
    settings.require_none(text)
    suffix = Path(text).suffix.lower()
    if suffix == ".mcap":
        raise UsageError(
            f"{text} is a recording, and only frames of cameras, images and videos are taken here",
            cure="Turn it into images first: armsight convert recording",
        )
    if is_video(text):
        reading.require_none(text)
        return VideoFile(text, colour=colour, fps=fps, times_s=times_s)
    return ImageFolder(text, colour=colour, fps=fps or FPS, times_s=times_s, reading=reading)


def open_moments(
    cameras: Mapping[str, str],
    *,
    colour: bool = False,
    fps: float | None = None,
    times_s: Sequence[float] | None = None,
    max_skew_s: float = MAX_SKEW_S,
    settings: Mapping[str, CameraSettings] = MappingProxyType({}),
    reading: ImageReading = AS_THEY_ARE,
    tell: Callable[[str], None] = warnings.warn,
) -> Moments:
    """Return the moments of cameras' sources by their names, all live or none; nothing is opened yet.

    settings: what is asked of live ones, by name. Raises UsageError as open_source does.
    """
    live = any(map(is_live, cameras.values()))
    more: dict[str, Any] = {"fps": fps, "times_s": times_s}
    if live:
        clock = SystemClock()
        more = {"clock": clock, "origin_s": clock.now_s()}
    sources = [
        open_source(text, colour=colour, settings=settings.get(name, AUTOMATIC), reading=reading, **more)
        for name, text in cameras.items()
    ]
    names = tuple(cameras)
    if live:
        return TimedMoments(*sources, names=names, max_skew_s=max_skew_s, tell=tell)
    return FileMoments(*sources, names=names, tell=tell)


def _driver(text: str) -> tuple[str, str]:
    if text.isdecimal() or text.startswith("/"):
        return DEFAULT_CAMERA, text
    driver, _, device = text.partition(":")
    return driver, device


def _asked(make: Any, settings: CameraSettings, text: str) -> dict[str, CameraSettings]:
    """Return the driver's argument for the settings; none where nothing is asked, so that simple drivers need none."""
    if settings == AUTOMATIC:
        return {}
    parameters = signature(make).parameters
    if "settings" not in parameters and all(one.kind is not Parameter.VAR_KEYWORD for one in parameters.values()):
        settings.require_only((), text)
    return {"settings": settings}
